// The start page: a preview, the presets, and the list of sweeps.

import { link } from "../lib/address.js";
import { h, latest } from "../lib/dom.js";
import { number } from "../lib/format.js";
import { loadPresets } from "../form/catalogue.js";
import { Motion, PLAYED } from "../motion/motion.js";
import { SweepList } from "./sweep-list.js";

const CELL = { omega: 0.5, xi: 0.26, model: { kind: "rigid" }, ...PLAYED };
const INSETS = { a: 1.5, b: 2.3, c: 3.6, d: 5 }; // Γ of the insets of Fig. 2
const RANGE = { min: 0.5, max: 6, step: 0.05 };

export class Sweeps {
  constructor(root) {
    document.title = "Bouncing spring";
    this.presets = h("ul", {});
    this.sweeps = new SweepList();
    this.preview = new Preview();
    root.replaceChildren(
      h("div", { className: "start" }, h("section", { className: "intro" },
        h("h1", { tabindex: "-1" }, "A spring bouncing on a vibrating plate"),
        h("p", {}, "Two masses joined by a spring and a dashpot bounce on a plate that vibrates. Their flight times and modes depend on the plate’s acceleration ", h("i", {}, "Γ"), ", its frequency ", h("i", {}, "Ω"), " and the damping ", h("i", {}, "ξ"), ". Compute sweeps of these parameters and explore the results."),
        h("p", {}, h("a", { className: "button", href: link(["new"]) }, "New sweep"))),
      this.preview.element),
      h("section", { className: "presets", "aria-labelledby": "presets" },
        h("h2", { id: "presets" }, "Presets"),
        this.presets),
      this.sweeps.element);
    this.refresh();
  }

  close() {
    this.preview.close();
    this.sweeps.close();
  }

  refresh() {
    this.preview.refresh();
    if (!this.presets.hasChildNodes()) this.#showPresets();
    this.sweeps.refresh();
  }

  async #showPresets() {
    try {
      this.presets.replaceChildren(...(await loadPresets()).map(({ label, title, sweeps: [first] }) =>
        h("li", {}, h("a", { href: link(["new"], { figure: first.key }) }, h("b", {}, label), h("span", {}, title)))));
    } catch (error) {
      this.sweeps.showError(error);
    }
  }
}

/** A moving spring, which needs no sweep: that of the paper's Fig. 2 at a Γ of the reader's choice. */
class Preview {
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
