// Playback of a trajectory: the animated spring, the plot of its heights, and the controls.

import { h } from "../lib/dom.js";
import { TWO_PI } from "../lib/physics.js";
import { Plot } from "../plot/plot.js";
import { drawInstant } from "./animation.js";
import { heightsOf } from "./height-plot.js";
import { PERIODS, periodsOf } from "./trajectory.js";

const SECONDS_PER_PERIOD = 1.6; // at full speed
const SPEEDS = [1, 0.5, 0.25, 0.1];

export class Player {
  phase = 0; // rad since the first sample
  speed = 1;
  periods = PERIODS; // of the trajectory
  playing = !matchMedia("(prefers-reduced-motion: reduce)").matches;

  constructor(root) {
    this.canvas = h("canvas", { className: "animation", role: "img", "aria-label": "Animation of the masses, the spring and the plate" });
    const figure = h("figure", { className: "heights" });
    this.button = h("button", { type: "button", disabled: true, onclick: () => this.play(!this.playing) }, "Play"); // enabled by show()
    this.position = h("input", {
      type: "range", min: 0, max: PERIODS, step: 0.005, value: 0, "aria-label": "Plate periods since the first sample",
      oninput: () => {
        this.play(false);
        this.phase = this.position.valueAsNumber * TWO_PI;
        this.#draw();
      },
    });
    this.element = h("div", { className: "player" },
      h("div", { className: "instant" }, this.canvas, figure),
      h("div", { className: "controls" }, this.button, this.#speeds(), this.position));
    root.append(this.element);
    this.plot = new Plot(figure, {
      label: "Heights of the masses and the plate over plate periods",
      content: () => this.heights?.content(() => this.phase) ?? null, ratio: 0.62, minHeight: 280,
    });
    this.plot.element.addEventListener("drawn", () => this.#draw());
  }

  /** Show another trajectory from the current phase on. */
  show(trajectory) {
    this.heights = heightsOf(trajectory);
    this.periods = periodsOf(trajectory);
    this.position.max = String(this.periods);
    this.phase %= this.periods * TWO_PI;
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
    let previous = performance.now();
    const step = (now) => {
      this.phase = (this.phase + (Math.max(0, now - previous) / 1000 / SECONDS_PER_PERIOD) * TWO_PI * this.speed) % (this.periods * TWO_PI);
      previous = now;
      this.#draw();
      this.frame = requestAnimationFrame(step);
    };
    this.frame = requestAnimationFrame(step);
  }

  #draw() {
    if (!this.plot.box || !this.heights) return;
    drawInstant(this.canvas, this.heights, this.phase, this.plot.canvas.clientHeight);
    this.plot.drawCursor();
    this.position.value = String(this.phase / TWO_PI);
    this.element.dataset.phase = this.phase.toFixed(3);
  }

  #speeds() {
    return h("label", { className: "option" }, "Speed ",
      h("select", { onchange: (event) => { this.speed = Number(event.target.value); } },
        SPEEDS.map((speed) => h("option", { value: speed }, `× ${speed}`))));
  }
}
