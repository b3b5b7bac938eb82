// A specification as JSON, pasted or dropped: any kind of study.

import { requestJson } from "../lib/api.js";
import { debounced, h, problemLine } from "../lib/dom.js";

const DELAY_MS = 300;

/** The text of a file that was dropped on another page, for the form to take. */
export const dropped = { text: null };

/** A text area for a specification of any study; `taken(spec)` is called with one that the service accepts. */
export class PastedSpecification {
  constructor(taken) {
    this.text = h("textarea", {
      rows: 12, spellcheck: "false", "aria-label": "Specification as JSON", placeholder: '{"protocol": {"kind": "basin"}, "gamma": 1.2, …}', oninput: () => this.take(),
    });
    this.problem = problemLine();
    this.take = debounced(DELAY_MS, () => this.#take(taken));
    this.element = h("details", {}, h("summary", {}, "Paste or drop a specification of any study"),
      h("p", { className: "note" }, "JSON, as “Copy as JSON” and the details of a job give it. A file can be dropped anywhere on the page."),
      this.text, this.problem.element);
  }

  /** Show a text, and take it. */
  write(text) {
    this.element.open = true;
    this.text.value = text;
    this.take();
  }

  close() {
    this.take.cancel();
  }

  async #take(taken) {
    this.problem.show(null);
    if (!this.text.value.trim()) return;
    try {
      const spec = parsed(this.text.value);
      await requestJson("/v1/jobs?validate_only=true", { method: "POST", body: spec });
      taken(spec);
    } catch (error) {
      this.problem.show(error);
    }
  }
}

function parsed(text) {
  try {
    return JSON.parse(text);
  } catch {
    throw new Error("This is not JSON. `bounce submit` takes TOML files.");
  }
}
