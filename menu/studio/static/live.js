/* What the camera sees: picture, histogram with the range of the plan, zoom, focus, peaking. */
import {details, get, h, percent, svg, time} from "./studio.js";
import {buttons, words} from "./screen.js";

let root, frame, image, side, facts = null, best = 0, running = false, url = "";
const look = {zoom: false, x: 0.5, y: 0.5, clip: true, peak: false};
let abort = new AbortController();

function toggle(name) {
  look[name] = !look[name];
  if (name === "zoom") { best = 0; }
  showTools();
  abort.abort();
}
let tools;
function showTools() {
  tools.replaceChildren(...[["zoom", "100 %"], ["clip", "Clipping"], ["peak", "Peaking"]].map(
    ([name, title]) => h("button", {"aria-pressed": String(look[name]), "data-tool": name,
      onclick: () => toggle(name)}, title)));
}

function histogram(state) {
  const width = 320, bottom = 90, parts = [];
  const place = stop => width * (stop - facts.first_stop) / (facts.last_stop - facts.first_stop);
  const most = Math.max(...facts.histogram, 1e-9), step = width / facts.histogram.length;
  const stops = facts.range_stops || (state.plan ? [-Math.log2(state.plan.dynamic_range), 0]
    : null);
  if (stops) {
    parts.push(svg("rect", {x: place(stops[0]), y: 0, width: place(stops[1]) - place(stops[0]),
      height: bottom, fill: "#2c4a6b"}));
  }
  facts.histogram.forEach((share, at) => {
    const height = 86 * Math.sqrt(share / most);
    parts.push(svg("rect", {x: at * step, y: bottom - height, width: step - 0.5, height,
      fill: "#d8dde3"}));
  });
  for (let stop = Math.ceil(facts.first_stop) + 2; stop <= facts.last_stop; stop += 4) {
    parts.push(svg("text", {x: place(stop), y: bottom + 14, fill: "#b9c2cc", "font-size": 12,
      "text-anchor": "middle"}, stop));
  }
  return svg("svg", {viewBox: `0 0 ${width} ${bottom + 20}`, role: "img",
    "aria-label": "histogram of the light in stops; blue: the range of the picture"}, parts);
}

function showSide(state) {
  const numbers = [];
  if (facts) {
    best = Math.max(best, facts.focus);
    numbers.push(["shortest exposure", time(facts.time_s)], ["clipped", percent(facts.clipped)]);
    if (facts.dark !== undefined) { numbers.push(["too dark", percent(facts.dark)]); }
    numbers.push(["focus", `${Math.round(100 * facts.focus / (best || 1))} % of the best seen`]);
  }
  if (state.reading && state.reading.rate) {
    numbers.push(["live", state.reading.rate.toFixed(1) + " pictures a second"]);
  }
  numbers.push(["response", state.chosen.response], ["range", state.chosen.range],
    ["exposures", state.chosen.count]);
  side.replaceChildren(...[
    buttons(state, {set: "Choose response and range", shoot: "Shoot", menu: "More"}),
    facts ? histogram(state) : null,
    details(numbers),
    ...state.paragraphs.map(text => h("p", {class: "bad"}, text)),
    state.reading && state.reading.remark ? h("p", {class: "bad"}, state.reading.remark) : null,
    state.reading && state.reading.is_late
      ? h("p", {class: "pale"}, "The camera meters when it shoots: it has no preview.") : null,
  ].filter(each => each));
}

async function follow(studio) {
  let number = 0, shown = "";
  while (running) {
    const box = frame.getBoundingClientRect(), scale = window.devicePixelRatio || 1;
    const query = new URLSearchParams({width: Math.round(box.width * scale),
      height: Math.round(box.height * scale), clip: look.clip ? 1 : 0, peak: look.peak ? 1 : 0});
    if (look.zoom) { query.set("at", `${look.x},${look.y}`); }
    if (String(query) === shown) { query.set("after", number); } else { shown = String(query); }
    try {
      const answer = await get("live/picture?" + query, {signal: abort.signal});
      facts = JSON.parse(answer.headers.get("X-Camctl-Facts"));
      if (facts.number !== number || url === "" || !query.has("after")) {
        const old = url;
        url = URL.createObjectURL(await answer.blob());
        image.src = url;
        await image.decode().catch(() => {});
        if (old) { URL.revokeObjectURL(old); }
      }
      number = facts.number;
      showSide(studio.state);
    } catch (error) {
      if (error.name === "AbortError") { abort = new AbortController(); continue; }
      await new Promise(resolve => setTimeout(resolve, 1000));
    }
  }
}

function zoomAt(event) {
  const box = image.getBoundingClientRect();
  const x = (event.clientX - box.left) / box.width, y = (event.clientY - box.top) / box.height;
  if (look.zoom) { toggle("zoom"); return; }
  look.x = Math.min(Math.max(x, 0), 1);
  look.y = Math.min(Math.max(y, 0), 1);
  toggle("zoom");
}

export default {
  start(element, studio) {
    root = element;
    image = h("img", {alt: "what the camera sees", onclick: zoomAt});
    frame = h("div", {class: "sight"}, image);
    tools = h("div", {class: "buttons tools", role: "group", "aria-label": "picture"});
    side = h("div", {class: "side"});
    showTools();
    document.addEventListener("keydown", event => {
      const key = {z: "zoom", c: "clip", p: "peak"}[event.key];
      if (running && key && !event.ctrlKey && !event.metaKey) { toggle(key); }
    });
  },
  open(studio) { if (!running) { running = true; follow(studio); } },
  close() { running = false; abort.abort(); abort = new AbortController(); },
  show(state) {
    if (state.state !== "idle") {
      root.replaceChildren(h("div", {class: "card"}, words(state)));
      return;
    }
    if (!frame.isConnected || frame.parentNode !== root) {
      root.replaceChildren(frame, h("div", {class: "controls"}, tools, side));
      abort.abort();
    }
    showSide(state);
  },
};
