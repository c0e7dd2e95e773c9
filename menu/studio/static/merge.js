/* Photographs of one scene that are dropped here are merged, and the result is opened. */
import {get, h, note, post} from "./studio.js";
import {openCapture} from "./captures.js";

let root, area, input, response, times, status, bar, isBusy = false;

function say(text, share) {
  status.textContent = text;
  bar.hidden = share === undefined;
  if (share === null) { bar.removeAttribute("value"); } else { bar.value = share || 0; }
}

async function take(list) {
  const byName = new Intl.Collator("en", {numeric: true}).compare;
  const files = [...list].sort((a, b) => byName(a.name, b.name));
  if (isBusy || !files.length) { return; }
  isBusy = true;
  area.classList.add("busy");
  note("");
  try {
    const {set} = await (await post("merge/begin", {})).json();
    for (const [place, file] of files.entries()) {
      say(`Taking in ${file.name} (${place + 1} of ${files.length})`, place / files.length);
      await post(`merge/file/${set}/${encodeURIComponent(file.name)}`, file);
    }
    say(`Merging ${files.length} photographs ...`, null);
    const made = await post("merge/merge/" + set, {files: files.map(file => file.name),
      response: response.value, times: times.value});
    const {capture} = await made.json();
    say("");
    openCapture(capture);
  } catch (error) {
    say(error.message);
  } finally {
    isBusy = false;
    input.value = "";
    area.classList.remove("busy");
  }
}

export default {
  start(element) {
    root = element;
    status = h("p", {role: "status", "aria-live": "polite"});
    bar = h("progress", {max: 1, hidden: true, "aria-label": "progress"});
    input = h("input", {type: "file", multiple: true, id: "photographs",
      onchange: () => take(input.files)});
    response = h("select", {id: "response"});
    get("merge/responses").then(answer => answer.json()).then(found =>
      response.append(...found.map(([value, title]) => h("option", {value}, title))))
      .catch(error => note(error.message));
    times = h("input", {type: "text", id: "times", placeholder: "1/60, 1/15, 1/4"});
    area = h("div", {class: "card drop",
      ondragover: event => { event.preventDefault(); area.classList.add("over"); },
      ondragleave: () => area.classList.remove("over"),
      ondrop: event => {
        event.preventDefault();
        area.classList.remove("over");
        take(event.dataTransfer.files);
      }},
    h("h2", {}, "Merge photographs"),
    h("p", {}, "Drop photographs of one scene here: JPEG, TIFF, PNG or camera raw, "
      + "each with another exposure."),
    h("p", {}, h("label", {for: "photographs"}, "Or choose them: "), input),
    h("p", {}, h("label", {for: "response"}, "Response: "), response),
    h("p", {}, h("label", {for: "times"}, "Exposure times in seconds, in the order of the names, "
      + "where the files have none: "), times),
    status, bar);
    root.append(area);
  },
  show() {},
};
