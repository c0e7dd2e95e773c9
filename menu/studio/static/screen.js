/* What a screen of the menu says, in words and buttons: for sections without a view of their own. */
import {choose, h} from "./studio.js";

export const WORDS = {set: "Choose ...", shoot: "Shoot", menu: "Menu", timer: "Self-timer",
  retry: "Try again", again: "Once more", back: "Back", other: "Other camera",
  captures: "Captures", quit: "Quit"};

/* The buttons of a page; the one that the enter key presses is marked. */
export function buttons(state, words = {}) {
  if (!state.actions.length) { return null; }
  return h("div", {class: "buttons"}, state.actions.map((action, place) => h("button", {
    class: place === state.action ? "main" : "", "data-action": action,
    onclick: () => choose({action}),
  }, words[action] || WORDS[action] || action)));
}

export function entries(state) {
  return h("ul", {class: "plain"}, state.lines.map((text, place) => h("li", {},
    h("button", {"aria-pressed": place === state.selected, "data-entry": place,
      onclick: () => choose({index: place, take: true})}, text))));
}

export function words(state) {
  return [
    ...(state.kind === "list" ? [entries(state)] : state.lines.map(text => h("p", {}, text))),
    ...state.paragraphs.map(text => h("p", {}, text)),
    state.detail ? h("p", {class: "pale"}, state.detail) : null,
    state.share === null ? null : h("progress", {max: 1, value: state.share}),
    buttons(state),
    state.state === "saver" ? h("button", {onclick: () => choose({key: "enter"})}, "Wake up")
      : state.kind === "wait" && state.state !== "quit"
        ? h("button", {onclick: () => choose({key: "exit"})}, "Stop") : null,
  ].filter(each => each);
}
