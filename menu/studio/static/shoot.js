/* The plan, the self-timer, and the progress of a capture. */
import {bytes, choose, details, h, levels, range, time} from "./studio.js";
import {buttons} from "./screen.js";

let root;

function planned(plan) {
  return [
    details([
      ["accuracy", `${levels(plan.effective_levels)} effective levels`
        + (plan.noise_known ? "" : ", the noise is unknown")],
      ["time", plan.wall_s === null ? "unknown"
        : (plan.is_wall_known ? "" : "at least ") + time(plan.wall_s)],
      ["exposed", time(plan.shutter_s)],
      ["range", range(plan.dynamic_range)],
      ["space", `${bytes(plan.needed_bytes)} of ${bytes(plan.free_bytes)}`],
    ]),
    h("table", {}, h("thead", {}, h("tr", {}, h("th", {}, "frame"), h("th", {}, "setting"),
      h("th", {}, "exposure"))),
    h("tbody", {}, plan.frames.map(([text, ratio], at) => h("tr", {}, h("td", {}, at + 1),
      h("td", {}, text), h("td", {}, "× " + +ratio.toPrecision(4)))))),
    ...plan.warnings.map(text => h("p", {class: "warn"}, text)),
  ];
}

function progress(state) {
  const at = state.progress, plan = state.plan;
  const isCounted = at && ["shooting", "taken"].includes(at.stage); // frames, or sets of a series
  const count = isCounted ? at.total : plan ? plan.frames.length : 0;
  const done = !at ? 0 : isCounted ? at.done : at.stage === "metering" ? 0 : count;
  const frames = Array.from({length: count}, (_, place) => h("li", {
    class: place < done ? "done" : place === done ? "now" : ""}, String(place + 1)));
  return [
    h("p", {class: "large"}, state.lines[0] || ""),
    h("progress", {max: 1, value: state.share === null ? 0 : state.share,
      "aria-label": "progress"}),
    h("ol", {class: "frames", "aria-label": "frames"}, frames),
  ];
}

export default {
  start(element) { root = element; },
  show(state) {
    const running = ["shooting", "resuming", "cancelling", "timer", "series_shooting"].includes(state.state);
    const parts = state.state === "review" && state.plan ? planned(state.plan)
      : running ? progress(state)
        : [...state.lines.map(text => h("p", {}, text)),
          ...state.paragraphs.map(text => h("p", {class: state.mood === "error" ? "bad" : ""},
            text))];
    root.replaceChildren(h("div", {class: "card"}, [
      buttons(state, {timer: state.chosen.timer, back: "Change"}),
      running || state.state === "planning" ? h("div", {class: "buttons"}, h("button", {
        class: "danger", "data-stop": true, disabled: state.state === "cancelling",
        onclick: () => choose({key: "exit"})}, "Cancel")) : null,
      parts].flat()));
  },
};
