/* The library, and one capture: picture, layers, light under the pointer, files, findings. */
import {bytes, choose, command, details, get, h, leave, levels, note, percent, post, renew} from "./studio.js";
import {buttons, words} from "./screen.js";

let root, shown = "", armed = "", wanted = "";
const encode = name => name.split("/").map(encodeURIComponent).join("/");

/* Open a capture once the library lists it. */
export function openCapture(name) {
  wanted = name;
  leave();
  command({state: "browsing"});
}

function library(state) {
  return [
    h("div", {class: "choices"}, state.captures.map((past, place) => h("button", {class: "choice",
      "data-entry": place, "aria-pressed": String(place === state.selected),
      onclick: () => choose({index: place, take: true})},
    past.is_complete ? h("img", {alt: "", loading: "lazy",
      src: "captures/small/" + encode(past.name)}) : h("span", {class: "none"}, "unfinished"),
    h("strong", {}, past.name),
    h("span", {class: "pale"}, past.is_complete ? "complete" : "take what is missing")))),
    state.captures.length ? null : h("p", {}, "No captures yet."),
  ];
}

function number(value, deviation) {
  if (value === null) { return "not known"; }
  return deviation === null ? value.toPrecision(4) + " (deviation not known)"
    : `${value.toPrecision(4)} ± ${deviation.toPrecision(2)} (${percent(deviation / value)})`;
}

function result(state, name) {
  const summary = state.summary;
  const image = h("img", {src: `captures/file/${encode(name)}/preview.png`, tabindex: 0,
    alt: "the picture; arrow keys move the place whose light is shown", class: "picture",
    "data-keys": true});
  const layers = h("div", {class: "layers"}), cross = h("span", {class: "cross", hidden: true});
  const reading = h("p", {class: "reading", role: "status"},
    "Point at the picture: its light and standard deviation.");
  const place = {x: 0.5, y: 0.5};
  let asking = false, again = false;
  async function ask() {
    if (asking) { again = true; return; }
    asking = true;
    try {
      const found = await (await get(`captures/light/${encode(name)}?x=${place.x}&y=${place.y}`))
        .json();
      const channels = found.light.length === 1 ? [""] : ["R ", "G ", "B "];
      reading.textContent = `row ${found.row}, column ${found.column}: light `
        + channels.map((letter, at) => letter + number(found.light[at], found.deviation[at]))
          .join(", ") + (found.layers.length ? `; ${found.layers.join(", ")}` : "");
    } catch (error) { reading.textContent = error.message; }
    asking = false;
    if (again) { again = false; ask(); }
  }
  function at(x, y) {
    place.x = Math.min(Math.max(x, 0), 1);
    place.y = Math.min(Math.max(y, 0), 1);
    cross.hidden = false;
    cross.style.left = 100 * place.x + "%";
    cross.style.top = 100 * place.y + "%";
    ask();
  }
  const pointed = event => {
    const box = image.getBoundingClientRect();
    at((event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height);
  };
  image.addEventListener("pointermove", pointed);
  image.addEventListener("pointerdown", pointed);
  image.addEventListener("keydown", event => {
    const step = {ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1]};
    if (!step[event.key]) { return; }
    const size = event.shiftKey ? 0.1 : 0.01;
    at(place.x + size * step[event.key][0], place.y + size * step[event.key][1]);
    event.preventDefault();
  });
  const switches = h("div", {class: "buttons", role: "group", "aria-label": "layers"});
  get("captures/layers").then(answer => answer.json()).then(kinds => switches.append(
    ...kinds.map(({name: kind, title, colour}) => {
      const sample = h("span", {class: "sample"});
      sample.style.background = colour;
      const button = h("button", {"aria-pressed": "false", "data-layer": kind}, sample, title);
      button.addEventListener("click", () => {
        const old = layers.querySelector(`[data-kind="${kind}"]`);
        button.setAttribute("aria-pressed", String(!old));
        if (old) { old.remove(); return; }
        layers.append(h("img", {"data-kind": kind, alt: `mask: ${title}`,
          src: `captures/layer/${encode(name)}/${kind}`}));
      });
      return button;
    }))).catch(error => note(error.message));
  const files = h("ul", {class: "plain files"});
  get("captures/files/" + encode(name)).then(answer => answer.json()).then(found => {
    files.replaceChildren(...found.map(each => h("li", {}, h("a", {
      href: `captures/file/${encode(name)}/${encode(each.name)}?keep=1`, download: ""},
    each.name), h("span", {class: "pale"}, " " + bytes(each.bytes)))));
  }).catch(error => note(error.message));
  const remove = h("button", {class: "danger", "data-delete": true}, "Delete ...");
  remove.addEventListener("click", async () => {
    if (armed !== name) {
      armed = name;
      remove.textContent = "Delete it for good?";
      return;
    }
    try {
      await post("captures/delete/" + encode(name), {});
      await command({state: "browsing"});
    } catch (error) { note(error.message); }
  });
  const distrust = summary.untrustworthy_because;
  const reached = levels(summary.effective_levels);
  const planned = summary.planned_levels === null ? "" : levels(summary.planned_levels);
  return [
    h("div", {class: "shown"}, h("div", {class: "overlay"}, image, layers, cross)),
    h("div", {},
      buttons(state, {back: state.state === "result" ? "Camera" : "All captures"}),
      reading, switches,
      distrust ? h("p", {class: "bad"}, "Not trustworthy: " + distrust) : null,
      details([["accuracy", `${reached} effective levels` + (reached === planned ? ", as planned"
        : planned && `, ${planned} planned`)],
      ["clipped", percent(summary.saturated) + " in all frames"], ["name", name]]),
      h("h2", {}, "Findings"),
      summary.notes.length ? h("ul", {}, summary.notes.map(text => h("li", {}, text)))
        : h("p", {class: "pale"}, "none"),
      h("h2", {}, "Frames"),
      h("a", {href: `captures/file/${encode(name)}/contact.png`, target: "_blank"},
        h("img", {src: `captures/file/${encode(name)}/contact.png`, class: "contact",
          loading: "lazy", alt: "contact sheet: the frames and their light"})),
      h("h2", {}, "Files"), files,
      h("div", {class: "buttons"}, remove)),
  ];
}

export default {
  start(element) { root = element; },
  show(state) {
    const name = state.summary ? state.summary.name : "";
    const isResult = ["result", "past"].includes(state.state) && state.summary;
    const here = isResult ? JSON.stringify([state.state, name, state.action])
      : JSON.stringify([state.state, state.captures, state.selected, state.lines]);
    if (here === shown && root.isConnected) { return; }
    shown = here;
    armed = "";
    const place = state.state === "captures"
      ? state.captures.findIndex(each => each.name === wanted) : -1;
    if (place >= 0) {
      wanted = "";
      choose({index: place, take: true});
    }
    root.classList.toggle("one", Boolean(isResult));
    renew(root, isResult ? result(state, name)
      : state.state === "captures" ? library(state) : h("div", {class: "card"}, words(state)));
  },
};
