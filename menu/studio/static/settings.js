/* Camera, self-timer, lamps, what the menu has beside them, and what was measured of cameras. */
import {command, details, get, h, renew} from "./studio.js";
import {words} from "./screen.js";

let root, isProfiles = false, drawn = "";

function bar(state, show) {
  const tabs = [["settings", "Settings"], ["series", "Series"], ["searching", "Camera"],
    ["calibration", "Calibration"], ["about", "About"]];
  return h("div", {class: "buttons", role: "group", "aria-label": "settings"},
    tabs.map(([name, title]) => h("button", {
      "aria-pressed": String(!isProfiles && state.state.startsWith(name.slice(0, 8))),
      onclick: () => { isProfiles = false; command({state: name}); show(); }}, title)),
    h("button", {"aria-pressed": String(isProfiles), "data-profiles": true,
      onclick: () => { isProfiles = true; show(); }}, "Profiles"));
}

function profile(each) {
  const measured = ["response", "noise", "exposures", "control delay"]
    .filter(part => each[part].length).map(part => [part, each[part].join(", ")]);
  const problem = h("p", {class: "pale"});
  const image = h("img", {class: "plot", loading: "lazy", src: "settings/plot/" + each.name,
    alt: "responses and photon transfer curves of " + each.camera});
  image.addEventListener("error", async () => {
    image.remove();
    await get("settings/plot/" + each.name).catch(error => { problem.textContent = error.message; });
  });
  return h("div", {class: "card"}, h("h2", {}, each.camera), details(measured),
    measured.length ? null : h("p", {class: "pale"}, "nothing was measured"),
    each.response.length || each.noise.length ? h("a", {href: image.src, target: "_blank"}, image)
      : null, problem);
}

async function profiles() {
  const found = await (await get("settings/profiles")).json();
  return found.length ? found.map(profile)
    : [h("p", {}, "Nothing was measured yet: camctl calibrate all measures the camera.")];
}

async function show(state) {
  if (!isProfiles) {
    drawn = "";
    const detail = ["settings", "series", "several"].includes(state.state) ? "Press an entry to change it." : state.detail;
    renew(root, bar(state, () => show(state)), h("div", {class: "card"}, words({...state, detail})));
    return;
  }
  if (drawn === "profiles") { return; }
  drawn = "profiles";
  const list = h("div", {class: "profiles"}, h("p", {class: "pale"}, "reading ..."));
  root.replaceChildren(bar(state, () => show(state)), list);
  try { list.replaceChildren(...await profiles()); }
  catch (error) { list.replaceChildren(h("p", {}, error.message)); }
}

export default {
  start(element) { root = element; },
  show,
  close() { isProfiles = false; },
};
