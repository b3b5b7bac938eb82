// A specification as JSON, pasted or dropped: any kind of study, the form's or not.

import { requestJson } from "../lib/api.js";
import { debounced, h, problemLine } from "../lib/dom.js";
import { costText } from "../lib/format.js";

const DELAY_MS = 300;

/** A text area for a specification of any study; `submitted(job)` is called once the service has taken it. */
export class PastedSpecification {
  constructor(submitted) {
    this.text = h("textarea", {
      rows: 12, spellcheck: "false", "aria-label": "Specification as JSON", placeholder: '{"protocol": {"kind": "basin"}, "gamma": 1.2, …}',
      oninput: () => this.estimate(), ondragover: (event) => event.preventDefault(), ondrop: (event) => this.#drop(event),
    });
    this.problem = problemLine();
    this.cost = h("p", { className: "note", role: "status" });
    this.button = h("button", { type: "button", className: "button", disabled: true, onclick: () => this.#submit(submitted) }, "Compute this specification");
    this.estimate = debounced(DELAY_MS, () => this.#estimate());
    this.element = h("details", {}, h("summary", {}, "Paste or drop a specification of any study"),
      h("p", { className: "note" }, "JSON, as “Copy as JSON” and the details of a job give it: sweeps, basins, multistability, cycles."),
      this.text, this.problem.element, h("div", { className: "submit" }, this.button, this.cost));
  }

  /** Show a specification to be changed. */
  write(spec) {
    this.element.open = true;
    this.text.value = JSON.stringify(spec, null, 2);
    this.estimate();
  }

  close() {
    this.estimate.cancel();
  }

  async #drop(event) {
    const [file] = event.dataTransfer.files;
    if (!file) return; // text drops itself
    event.preventDefault();
    this.text.value = await file.text();
    this.estimate();
  }

  #read() {
    try {
      return JSON.parse(this.text.value);
    } catch {
      throw new Error("This is not JSON. `bounce submit` takes TOML files.");
    }
  }

  async #estimate() {
    this.button.disabled = true;
    this.cost.textContent = "";
    this.problem.show(null);
    if (!this.text.value.trim()) return;
    try {
      this.cost.textContent = costText(await requestJson("/v1/jobs?validate_only=true", { method: "POST", body: this.#read() }));
      this.button.disabled = false;
    } catch (error) {
      this.problem.show(error);
    }
  }

  async #submit(submitted) {
    this.button.disabled = true;
    try {
      submitted(await requestJson("/v1/jobs", { method: "POST", body: this.#read() }));
    } catch (error) {
      this.problem.show(error);
      this.button.disabled = false;
    }
  }
}
