/* The page of the studio: follows the state of the menu and shows its sections.

A section NAME is the module static/NAME.js.  Its default export is an object with
  start(root, studio)   fill the element `root` once, when the section is opened first
  show(state, studio)   show a state of the menu; called at each change while the section is open
  open(studio)          optional: the section was opened
  close(studio)         optional: another one was
`studio` has the state of the menu and the name of the open section.  Sections and their states:
menu/studio/sections.py. */

const find = id => document.getElementById(id);
const loaded = {};
let wanted = location.hash.slice(1), isLeft = false;

/* Elements: h("p", {class: "pale", onclick: f}, "text", child, ...) */
export function h(name, attributes, ...children) {
  return fill(document.createElement(name), attributes, children);
}
export function svg(name, attributes, ...children) {
  return fill(document.createElementNS("http://www.w3.org/2000/svg", name), attributes, children);
}
function fill(made, attributes, children) {
  for (const [name, value] of Object.entries(attributes || {})) {
    if (name.startsWith("on")) { made.addEventListener(name.slice(2), value); }
    else if (value === true) { made.setAttribute(name, ""); }
    else if (value !== false && value !== null && value !== undefined) {
      made.setAttribute(name, value);
    }
  }
  made.append(...children.flat().filter(each => each !== null && each !== undefined));
  return made;
}

export function note(text) { find("note").textContent = text; }

async function ask(path, options) {
  let answer;
  try {
    answer = await fetch(path, options);
  } catch (error) {
    if (error.name === "AbortError") { throw error; }
    throw new Error("camctl does not answer; trying again.");
  }
  if (!answer.ok) { throw new Error(await answer.text()); }
  return answer;
}
export const get = (path, options) => ask(path, options);
export const post = (path, body) => ask(path, {method: "POST", headers: {"X-Camctl": "1"},
  body: body instanceof Blob ? body : JSON.stringify(body)});

/* A choice: the fields of camctl.menu.studio.commands.Command. */
export async function command(fields) {
  try {
    await post("command", fields);
    note("");
  } catch (error) { note(error.message); }
}
/* A choice on the page that is shown. */
export const choose = fields => command({seen: studio.state.state, ...fields});

export const time = seconds => seconds >= 0.9995 ? +seconds.toPrecision(3) + " s"
  : seconds >= 0.0009995 ? +(1e3 * seconds).toPrecision(3) + " ms"
  : +(1e6 * seconds).toPrecision(3) + " µs";
export const bytes = size => size >= 9.995e8 ? (size / 1e9).toPrecision(3) + " GB"
  : size >= 999500 ? (size / 1e6).toPrecision(3) + " MB" : Math.round(size / 1e3) + " kB";
export const percent = share => share > 0 && share < 1e-4 ? "< 0.01 %"
  : +(100 * share).toPrecision(3) + " %";
export const levels = count => count < 9.95 ? count.toFixed(1) : Math.round(count).toString();
export const range = ratio => "1:" + Math.round(ratio).toLocaleString("en");

/* What the entry of a list costs; without metered light times are relative. */
export const price = cost => !cost ? "computing ..." : cost.problem
  || `${levels(cost.effective_levels)} levels in ${cost.is_relative
    ? cost.shutter_s.toPrecision(3) + " × the shortest exposure"
    : time(cost.wall_s ?? cost.shutter_s)}, ${cost.count} exposures`;

/* A list of names and values. */
export const details = pairs => h("dl", {}, pairs.flatMap(([name, text]) =>
  [h("dt", {}, name), h("dd", {}, text)]));
/* Replace what a section shows; the entry that had the focus keeps it. */
export function renew(root, ...children) {
  const focused = document.activeElement?.dataset?.entry;
  root.replaceChildren(...children.flat().filter(each => each));
  if (focused !== undefined) { root.querySelector(`[data-entry="${focused}"]`)?.focus(); }
}

export const studio = {state: null, section: ""};

const sectionOf = state => state.sections.find(each => each.states.includes(state.state));

async function module(name) {
  if (!(name in loaded)) {
    const root = h("section", {"aria-label": name, class: "section-" + name});
    loaded[name] = import(`./${name}.js`).then(found => {
      found.default.start(root, studio);
      return {root, ...found.default};
    });
  }
  return loaded[name];
}

async function display(name) {
  const state = studio.state;
  const before = studio.section;
  studio.section = name;
  const made = await module(name);
  if (studio.section !== name) { return; }
  if (before !== name || !made.root.isConnected) {
    if (before && before !== name) { (await module(before)).close?.(studio); }
    find("main").replaceChildren(made.root);
    find("main").scrollTop = 0;
    history.replaceState(null, "", "#" + name);
    made.open?.(studio);
  }
  for (const button of find("bar").children) {
    if (button.dataset.section === name) { button.setAttribute("aria-current", "page"); }
    else { button.removeAttribute("aria-current"); }
  }
  made.show(state, studio);
}

function openSection(name) {
  const section = studio.state.sections.find(each => each.name === name);
  if (!section) { return; }
  const first = section.states[0], isThere = section.states.includes(studio.state.state);
  const returns = section.returns && studio.section === name && studio.state.state !== first;
  if (section.states.length && (!isThere || returns)) {
    leave();
    command({state: first});
  } else {
    find("title").textContent = section.states.length ? studio.state.title : section.title;
    display(name);
  }
}

/* Leave a section without states for one that the menu leads to. */
export function leave() { isLeft = true; }

function showBar(state) {
  if (find("bar").childElementCount) { return; }
  find("bar").append(...state.sections.map((each, place) => h("button", {
    "data-section": each.name, title: `${each.title} (${place + 1})`, onclick: () => openSection(each.name),
  }, each.title)));
}

async function show(state) {
  studio.state = state;
  showBar(state);
  find("camera").textContent = state.camera ? state.camera.name : "";
  const {free_bytes: free = 0, battery_percent: battery, free_images: images, lens, mode} =
    state.reading || {};
  find("facts").textContent = [
    lens || "",
    mode ? `mode dial at ${mode}` : "",
    typeof battery === "number" ? `battery ${battery} %` : "",
    typeof images === "number" ? `${images} pictures on the card` : "",
    free ? bytes(free) + " free" : "",
  ].filter(each => each).join(", ");
  const own = sectionOf(state);
  const open = state.sections.find(each => each.name === (studio.section || wanted));
  wanted = "";
  // A section without states stays open while the menu goes on.
  const stays = open && !open.states.length && !isLeft;
  isLeft = false;
  find("title").textContent = stays ? open.title : state.title;
  await display(stays ? open.name : own ? own.name : "live");
}

document.addEventListener("keydown", event => {
  // The dial and the picture leave the keys that lead away to the menu.
  const typing = event.target.closest("input[type=range], [data-keys]")
    ? !/^(Escape|[1-9])$/.test(event.key) : event.target.closest("input, select, textarea");
  if (event.ctrlKey || event.altKey || event.metaKey || typing || !studio.state) { return; }
  const names = {ArrowUp: "up", ArrowDown: "down", ArrowLeft: "left", ArrowRight: "right",
    Escape: "exit"};
  const place = "123456789".indexOf(event.key);
  if (place >= 0 && place < studio.state.sections.length) {
    openSection(studio.state.sections[place].name);
  } else if (event.key === "Enter" && event.target.closest("button, a")) {
    return;
  } else if (event.key === "Enter" || names[event.key]) {
    choose({key: names[event.key] || "enter"});
  } else { return; }
  event.preventDefault();
});

async function follow() {
  let version = 0;
  for (;;) {
    try {
      const state = await (await get("state?after=" + version)).json();
      if (find("note").dataset.lost) { note(""); delete find("note").dataset.lost; }
      if (state.version !== version && state.state) {
        version = state.version;
        await show(state);
      }
    } catch (error) {
      note(error.message);
      find("note").dataset.lost = "1";
      version = 0;
      await new Promise(resolve => setTimeout(resolve, 1000));
    }
  }
}
follow();
