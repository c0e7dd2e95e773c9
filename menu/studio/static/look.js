/* Response and range: each choice with the picture that it would give. */
import {choose, command, h, price, renew} from "./studio.js";

let root, shown = "";
export default {
  start(element) { root = element; },
  show(state) {
    const steps = [["response", "1 Response"], ["range", "2 Range"]].map(([name, title]) =>
      h("button", {"aria-pressed": String(state.state === name || (name === "range"
        && state.state === "custom")), onclick: () => command({state: name})}, title));
    const cards = state.lines.map((text, place) => {
      const cost = state.costs[place], leads = state.entries[place];
      const selected = place === state.selected;
      const picture = leads ? null : cost && cost.has_picture
        ? h("img", {alt: `preview: ${text}`, src: `look/picture/${place}?of=${state.request}`})
        : h("span", {class: "none"}, cost ? "no preview" : "");
      return h("button", {class: "choice", "aria-pressed": String(selected), "data-entry": place,
        onclick: () => choose({index: place, take: Boolean(leads)})},
      picture, h("strong", {}, text), h("span", {class: "pale"}, leads ? "" : price(cost)));
    });
    const here = JSON.stringify([state.state, state.selected, state.costs, state.note]);
    if (here === shown && root.isConnected) { return; }
    shown = here;
    renew(root,
      h("div", {class: "buttons"}, steps,
        h("button", {class: "main next", onclick: () => choose({key: "enter"})},
          state.state === "response" ? "Next: range" : "Next: time")),
      h("div", {class: "choices"}, cards),
      h("p", {class: "pale"}, state.detail));
  },
};
