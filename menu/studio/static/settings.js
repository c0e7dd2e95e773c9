/* Camera, self-timer, lamps, and what the menu has beside them. */
import {h, wish} from "./studio.js";
import {words} from "./screen.js";

let root;
export default {
  start(element) { root = element; },
  show(state) {
    root.replaceChildren(
      h("div", {class: "buttons", role: "group", "aria-label": "settings"},
        [["settings", "Settings"], ["searching", "Camera"], ["about", "About"]].map(
          ([name, title]) => h("button", {"aria-pressed": String(state.state === name),
            onclick: () => wish({state: name})}, title))),
      h("div", {class: "card"}, words(state).filter(each => each)));
  },
};
