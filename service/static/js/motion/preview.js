// A first look, before any sweep: the spring of the paper's Fig. 2, at a Γ of one's choice.

import { toldElsewhere } from "../lib/api.js";
import { h, newest } from "../lib/dom.js";
import { number } from "../lib/format.js";
import { describe } from "./panel.js";
import { PERIODS, Player, SAMPLES, Waiting } from "./player.js";
import { trajectory } from "./trajectory.js";

const CELL = { omega: 0.5, xi: 0.26, model: { kind: "rigid" }, periods: PERIODS, samples: SAMPLES };
const INSETS = { a: 1.5, b: 2.3, c: 3.6, d: 5 }; // of Fig. 2
const RANGE = { min: 0.5, max: 6, step: 0.05 };

export class Glimpse {
  constructor() {
    const id = "glimpse-gamma";
    this.slider = h("input", { id, type: "range", ...RANGE, value: INSETS.b, oninput: () => this.load() });
    this.output = h("output", { for: id });
    this.words = h("p", { className: "readout", role: "status" });
    this.problem = h("p", { className: "problem", hidden: true });
    this.waiting = new Waiting();
    this.element = h("section", { className: "glimpse", "aria-label": "A spring in motion" });
    this.player = new Player(this.element);
    this.element.append(
      h("div", { className: "controls" },
        h("div", { className: "slider" }, h("label", { for: id }, h("i", {}, "Γ"), " ="), this.output, this.slider),
        h("div", { className: "insets", role: "group", "aria-label": "Γ of the paper's Fig. 2" }, h("span", { className: "note" }, "Fig. 2 "), this.#insets())),
      this.waiting.element, this.problem, this.words);
    this.load = newest(() => this.#load()); // to its end: a motion that is given up is computed all the same
  }

  /** Ask for the motion, if it is not there and not on its way. */
  refresh() {
    if (!this.player.trace && !this.asking) this.load();
  }

  close() {
    this.closed = true;
    this.waiting.stop();
    this.player.close();
  }

  #insets() {
    return Object.entries(INSETS).map(([letter, gamma]) => h("button", {
      type: "button", className: "quiet", "aria-label": `Fig. 2${letter}: Γ = ${gamma}`,
      onclick: () => {
        this.slider.value = gamma;
        this.load();
      },
    }, letter));
  }

  async #load() {
    const gamma = this.slider.valueAsNumber;
    this.output.textContent = number(gamma);
    this.slider.setAttribute("aria-valuetext", `Γ = ${number(gamma)}`);
    this.asking = true;
    if (!this.player.trace) this.waiting.start();
    try {
      const path = await trajectory("/v1/trajectories", { method: "POST", body: { ...CELL, gamma } });
      if (this.closed) return;
      this.problem.hidden = true;
      this.player.show(path);
      this.words.textContent = describe(path);
    } catch (error) {
      if (toldElsewhere(error)) return;
      this.problem.textContent = error.message;
      this.problem.hidden = false;
    } finally {
      this.asking = false;
      this.waiting.stop();
    }
  }
}
