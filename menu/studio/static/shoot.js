import {h} from "./studio.js";
import {words} from "./screen.js";

let root;
export default {
  start(element) { root = element; },
  show(state) { root.replaceChildren(h("div", {class: "card"}, words(state))); },
};
