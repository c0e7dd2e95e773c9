/* Camera, self-timer, lamps, and what the menu has beside them. */
import {command, h} from "./studio.js";
import {words} from "./screen.js";

let root;
export default {
  start(element) { root = element; },
  show(state) {
    const detail = state.state === "settings" ? "Press an entry to change it." : state.detail;
    root.replaceChildren(
      h("div", {class: "buttons", role: "group", "aria-label": "settings"},
        [["settings", "Settings"], ["searching", "Camera"], ["about", "About"]].map(
          ([name, title]) => h("button", {"aria-pressed": String(state.state === name),
            onclick: () => command({state: name})}, title))),
      h("div", {class: "card"}, words({...state, detail})));
  },
};
