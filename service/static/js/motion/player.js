// A motion that runs: the masses, the spring and the plate, beside where they are at every phase.

import { h } from "../lib/dom.js";
import { TURN } from "../lib/physics.js";
import { Plot } from "../plot/plot.js";
import { drawStage } from "./animation.js";
import { traceOf } from "./height-plot.js";

const SECONDS = 1.6; // a plate period at full speed
const SPEEDS = [1, 0.5, 0.25, 0.1];

export const PERIODS = 4;
export const SAMPLES = 240; // a plate period

export class Player {
  phase = 0;
  speed = 1;
  playing = !matchMedia("(prefers-reduced-motion: reduce)").matches;

  constructor(root) {
    this.stage = h("canvas", { className: "stage", role: "img", "aria-label": "The masses, the spring and the plate in motion" });
    const figure = h("figure", { className: "trace" });
    this.button = h("button", { type: "button", disabled: true, onclick: () => this.play(!this.playing) }, "Play"); // nothing yet
    this.scrub = h("input", {
      type: "range", min: 0, max: PERIODS, step: 0.005, value: 0, "aria-label": "Plate periods since the first sample",
      oninput: () => {
        this.play(false);
        this.phase = this.scrub.valueAsNumber * TURN;
        this.#draw();
      },
    });
    this.element = h("div", { className: "player" },
      h("div", { className: "moving" }, this.stage, figure),
      h("div", { className: "controls" }, this.button, this.#speeds(), this.scrub));
    root.append(this.element);
    this.plot = new Plot(figure, {
      label: `Where the masses and the plate are, over ${PERIODS} plate periods`,
      content: () => this.trace?.content(() => this.phase) ?? null, ratio: 0.62, least: 280,
    });
    this.plot.element.addEventListener("drawn", () => this.#draw());
  }

  /** Go on with another motion, at the phase this one has come to. */
  show(path) {
    this.trace = traceOf(path);
    this.button.disabled = false;
    this.plot.draw();
    this.play(this.playing);
  }

  close() {
    this.plot.close();
    cancelAnimationFrame(this.frame);
  }

  play(on) {
    this.playing = on;
    this.button.textContent = on ? "Pause" : "Play";
    cancelAnimationFrame(this.frame);
    if (!on) return;
    let before = performance.now();
    const step = (now) => {
      this.phase = (this.phase + (Math.max(0, now - before) / 1000 / SECONDS) * TURN * this.speed) % (PERIODS * TURN);
      before = now;
      this.#draw();
      this.frame = requestAnimationFrame(step);
    };
    this.frame = requestAnimationFrame(step);
  }

  #draw() {
    if (!this.plot.box || !this.trace) return;
    drawStage(this.stage, this.trace, this.phase, this.plot.sheet.clientHeight);
    this.plot.drawCursor();
    this.scrub.value = String(this.phase / TURN);
    this.element.dataset.phase = this.phase.toFixed(3);
  }

  #speeds() {
    return h("label", { className: "pick" }, "Speed ",
      h("select", { onchange: (event) => { this.speed = Number(event.target.value); } },
        SPEEDS.map((speed) => h("option", { value: speed }, `× ${speed}`))));
  }
}

/** Nothing moves before it is computed, and the first time the equations are compiled: the words for how long it takes. */
export class Waiting {
  constructor() {
    this.element = h("p", { className: "note waiting", role: "status", hidden: true });
  }

  start() {
    this.stop();
    this.element.textContent = "Computing the motion …";
    this.element.hidden = false;
    this.timer = setTimeout(() => {
      this.element.textContent = "Computing the motion … The first one after a start of the service may wait for its kernels to be compiled.";
    }, 2500);
  }

  stop() {
    clearTimeout(this.timer);
    this.element.hidden = true;
  }
}
