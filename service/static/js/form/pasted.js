// A specification as JSON, pasted or dropped: any kind of study.

import { navigate } from "../lib/address.js";
import { requestJson } from "../lib/api.js";
import { debounced, fileInput, h, problemLine } from "../lib/dom.js";

const DELAY_MS = 300;

/** The file that was dropped, for the form to take. */
export const dropped = { file: null };

/** A text area for a specification of any study; `taken(spec)` is called with one that the service accepts. */
export class PastedSpecification {
  constructor(taken) {
    this.take = debounced(DELAY_MS, async () => {
      this.problem.show(null);
      const text = this.text.value.trim();
      const isCurrent = () => text === this.text.value.trim();
      if (!text) return;
      try { // the service reads it first: each browser refuses in words of its own
        await requestJson("/v1/jobs?validate_only=true", { method: "POST", body: text });
        if (isCurrent()) taken(JSON.parse(text));
      } catch (error) {
        if (isCurrent()) this.problem.showInView(error);
      }
    });
    this.text = h("textarea", { rows: 12, spellcheck: false, "aria-label": "Specification as JSON", placeholder: '{"protocol": {"kind": "basin"}, "gamma": 1.2, …}', oninput: this.take });
    this.problem = problemLine();
    this.element = h("details", {}, h("summary", {}, "Paste or drop a specification of any study"),
      h("p", { className: "note" }, "JSON, as in “Copy as JSON” and in the details of a job; “bounce submit” takes TOML files too. A file can be dropped anywhere on the page, even a shared sweep."),
      h("label", { className: "note" }, "Or choose it: ", fileInput(".json,.html,.htm", (file) => this.takeFile(file))),
      this.text, this.problem.element);
  }

  /** Take the specification in a file, which was dropped or is chosen, or make a shared sweep a job and open it. */
  async takeFile(file = dropped.file) {
    dropped.file = null;
    if (!file) return;
    this.element.open = true;
    try {
      if (/\.html?$/i.test(file.name)) return navigate(["job", (await requestJson("/v1/imports", { method: "POST", body: file })).id]);
      this.text.value = await file.text();
      this.take();
    } catch (error) {
      this.problem.showInView(error);
    }
  }
}
