// The preview on the start page, which needs no sweep: the spring of the paper's Fig. 2 at a Γ of the reader's choice.

import { link } from "../lib/address.js";
import { h, latest } from "../lib/dom.js";
import { number } from "../lib/format.js";
import { Motion, PLAYED } from "./motion.js";

const CELL = { omega: 0.5, xi: 0.26, model: { kind: "rigid" }, ...PLAYED };
const INSETS = { a: 1.5, b: 2.3, c: 3.6, d: 5 }; // Γ of the insets of Fig. 2
const RANGE = { min: 0.5, max: 6, step: 0.05 };

export class Preview {
  constructor() {
    const id = "preview-gamma";
    this.slider = h("input", { id, type: "range", ...RANGE, value: INSETS.b, oninput: () => this.load() });
    this.output = h("output", { for: id });
    this.motion = new Motion();
    this.element = h("section", { className: "preview", "aria-label": "Trajectory of a spring" },
      this.motion.element,
      h("div", { className: "controls" },
        h("div", { className: "slider" }, h("label", { for: id }, h("i", {}, "Γ"), " ="), this.output, this.slider),
        h("div", { className: "insets", role: "group", "aria-label": "Γ of the paper's Fig. 2" }, h("span", { className: "note" }, "Fig. 2 "), Object.entries(INSETS).map(([letter, gamma]) =>
          h("button", { type: "button", className: "quiet", "aria-label": `Fig. 2${letter}: Γ = ${gamma}`, onclick: () => { this.slider.value = gamma; this.load(); } }, letter)))),
      h("p", {}, h("a", { href: link(["explore"]) }, "Explore Γ, Ω and ξ, with thresholds and cycles in closed form")));
    // Not aborted for a newer request: the service would compute the trajectory nevertheless.
    this.load = latest(() => this.#load());
  }

  /** Request the trajectory unless it is shown or requested already. */
  refresh() {
    if (!this.motion.trajectory && !this.isLoading) this.load();
  }

  close() {
    this.motion.close();
  }

  async #load() {
    const gamma = this.slider.valueAsNumber;
    this.output.textContent = number(gamma);
    this.slider.setAttribute("aria-valuetext", `Γ = ${number(gamma)}`);
    this.isLoading = true;
    await this.motion.load("/v1/trajectories", { method: "POST", body: { ...CELL, gamma } });
    this.isLoading = false;
  }
}
