/* The time dial: accuracy against time as a curve that is dragged; or a list of the same. */
import {choose, command, details, h, levels, price, renew, svg, time} from "./studio.js";

const WIDTH = 640, HEIGHT = 300, LEFT = 60, RIGHT = 20, TOP = 14, BOTTOM = 58;
let root, dial, picture, facts, set, slider, drawn = null, sent = -1;

/* The functions from a point or a rival to its place; the curve and the rivals fit in. */
function scale(front, rivals) {
  const all = [...front, ...rivals];
  const times = all.map(each => Math.log(each.wall_s));
  const counts = all.map(each => Math.log(each.effective_levels));
  const span = (values, low, high) => {
    const first = Math.min(...values), last = Math.max(...values);
    return value => low + (high - low) * (last > first ? (value - first) / (last - first) : 0.5);
  };
  const x = span(times, LEFT, WIDTH - RIGHT), y = span(counts, HEIGHT - BOTTOM, TOP + 12);
  return each => [x(Math.log(each.wall_s)), y(Math.log(each.effective_levels))];
}

/* The time that the curve needs for the levels of a rival; null: it does not reach them. */
function timeOf(front, wanted) {
  const above = front.findIndex(each => each.effective_levels >= wanted);
  if (above <= 0) { return above < 0 ? null : front[0].wall_s; }
  const [low, high] = [front[above - 1], front[above]];
  const share = Math.log(wanted / low.effective_levels) /
    Math.log(high.effective_levels / low.effective_levels);
  return low.wall_s * (high.wall_s / low.wall_s) ** share;
}

const nameOf = rival => `${rival.count} frames, ${rival.stops} stop${rival.stops > 1 ? "s" : ""}`;

function rivalTable(front, rivals) {
  const rows = rivals.map(each => {
    const own = timeOf(front, each.effective_levels);
    return [nameOf(each), time(each.wall_s), levels(each.effective_levels),
      own === null ? "-" : time(own)];
  });
  const line = (kind, cells) => h("tr", {}, cells.map(text => h(kind, {}, text)));
  return h("details", {class: "rivals"},
    h("summary", {}, "Crosses: brackets that cameras offer"),
    h("table", {}, line("th", ["bracket", "time", "levels", "here as accurate in"]),
      rows.map(cells => line("td", cells))));
}

function draw(front, rivals, selected) {
  const size = dial.getBoundingClientRect().width < 450 ? 24 : 15;
  const place = scale(front, rivals), places = front.map(place);
  const [x, y] = places[selected], point = front[selected];
  const times = [...front, ...rivals].map(each => each.wall_s);
  const counts = [...front, ...rivals].map(each => each.effective_levels);
  const label = (text, at, anchor) => svg("text", {x: at[0], y: at[1], fill: "#b9c2cc",
    "font-size": size, "text-anchor": anchor}, text);
  const parts = [
    svg("line", {x1: LEFT, y1: HEIGHT - BOTTOM, x2: WIDTH - RIGHT, y2: HEIGHT - BOTTOM,
      stroke: "#4a5563"}),
    label(time(Math.min(...times)), [LEFT, HEIGHT - 34], "start"),
    label(time(Math.max(...times)), [WIDTH - RIGHT, HEIGHT - 34], "end"),
    label("time of the capture", [(LEFT + WIDTH) / 2, HEIGHT - 4], "middle"),
    label(levels(Math.min(...counts)), [LEFT - 8, HEIGHT - BOTTOM], "end"),
    label(levels(Math.max(...counts)), [LEFT - 8, TOP + 16], "end"),
    svg("polyline", {points: places.map(each => each.join(",")).join(" "), fill: "none",
      stroke: "#9ec5ff", "stroke-width": 2}),
    ...rivals.map(each => {
      const [cx, cy] = place(each);
      return svg("path", {d: `M${cx - 5},${cy - 5}l10,10m0,-10l-10,10`, stroke: "#e3a857",
        "stroke-width": 2}, svg("title", {}, nameOf(each)));
    }),
    svg("line", {x1: x, y1: y, x2: x, y2: HEIGHT - BOTTOM, stroke: "#9ec5ff",
      "stroke-dasharray": "4 4"}),
    ...places.map(([px, py], at) => svg("circle", {cx: px, cy: py, r: at === selected ? 12
      : front[at].is_recommended ? 7 : 5, fill: front[at].is_recommended
      ? "#7fd99a" : at === selected ? "#2563a8" : "#9ec5ff", stroke: "#f2f3f1",
    "stroke-width": at === selected ? 3 : 0})),
  ];
  dial.replaceChildren(...parts);
  facts.replaceChildren(details([
    ["accuracy", levels(point.effective_levels) + " effective levels"],
    ["time", time(point.wall_s)], ["exposed", time(point.shutter_s)],
    ["exposures", String(point.count) + (point.is_recommended ? ", recommended" : "")],
  ]));
  set.replaceChildren(details([["set", point.frames.join(", ")]]));
}

function move(state, at) {
  const {front, rivals, request} = state;
  draw(front, rivals, at);
  slider.value = at;
  slider.setAttribute("aria-valuetext", `${time(front[at].wall_s)}, ` +
    `${levels(front[at].effective_levels)} effective levels`);
  picture.hidden = !front[at].has_picture;
  const source = `time/picture/${at}?of=${request}`;
  if (front[at].has_picture && picture.getAttribute("src") !== source) { picture.src = source; }
  if (at !== sent) {
    sent = at;
    choose({index: at});
  }
}

function showDial(state) {
  const {front, rivals, request: key} = state;
  if (drawn !== key || !dial?.isConnected) {
    drawn = key;
    const take = () => choose({index: Number(slider.value), take: true});
    dial = svg("svg", {viewBox: `0 0 ${WIDTH} ${HEIGHT}`, class: "dial", "aria-hidden": "true"});
    picture = h("img", {alt: "the scene with the noise of this set, single pixels",
      class: "noise"});
    [facts, set] = [h("div", {}), h("div", {})];
    slider = h("input", {type: "range", min: 0, max: front.length - 1, step: 1,
      value: state.selected, "aria-label": "time of the capture",
      onkeydown: event => { if (event.key === "Enter") { take(); } },
      oninput: () => move(state, Number(slider.value))});
    const drag = event => {
      if (event.buttons === 0 && event.type === "pointermove") { return; }
      const box = dial.getBoundingClientRect();
      const x = (event.clientX - box.left) / box.width * WIDTH;
      const places = front.map(scale(front, rivals));
      let nearest = 0;
      places.forEach(([px], at) => {
        if (Math.abs(px - x) < Math.abs(places[nearest][0] - x)) { nearest = at; }
      });
      if (nearest !== Number(slider.value)) { move(state, nearest); }
    };
    dial.addEventListener("pointerdown", event => {
      dial.setPointerCapture(event.pointerId);
      drag(event);
    });
    dial.addEventListener("pointermove", drag);
    sent = state.selected;
    root.replaceChildren(tabs(state, take), h("div", {class: "dials"},
      h("div", {class: "card"}, dial, slider, h("p", {class: "pale"},
        "Drag, or use the arrow keys and Enter. Green: recommended. Noise is counted."),
      rivals.length ? rivalTable(front, rivals) : null),
      h("div", {class: "card"}, facts, picture, set)));
  }
  // What this page has just chosen is already shown.
  const own = document.activeElement === slider || dial.matches(":active");
  move(state, own ? Number(slider.value) : (sent = state.selected));
}

/* The ways to decide, and the button that plans what is selected. */
function tabs(state, take) {
  return h("div", {class: "buttons", role: "group", "aria-label": "what decides"},
    [["front", "Time / accuracy"], ["exposures", "Number"], ["budget", "Time budget"]].map(
      ([name, title]) => h("button", {"aria-pressed": String(state.state === name),
        onclick: () => command({state: name})}, title)),
    take ? h("button", {class: "main next", "data-take": true, onclick: take}, "Next: plan") : null);
}

export default {
  start(element) { root = element; },
  show(state) {
    if (state.state === "front" && state.front.length) { showDial(state); return; }
    drawn = null;
    const list = state.lines.map((text, place) => {
      const cost = state.costs[place], leads = state.entries[place];
      return h("button", {class: "row", "aria-pressed": String(place === state.selected),
        "data-entry": place, onclick: () => choose({index: place, take: Boolean(leads)})},
      h("strong", {}, text), h("span", {class: "pale"}, leads ? "" : price(cost)));
    });
    renew(root, tabs(state, state.lines.length ? () => choose({key: "enter"}) : null),
      h("div", {class: "rows"}, list),
      h("p", {class: "pale"}, state.detail),
      state.paragraphs.map(text => h("p", {}, text)));
  },
};
