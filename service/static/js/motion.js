// One cell in motion: the masses, the spring and the plate, beside where they were at every phase.

import { askJson, query } from "./api.js";
import { h } from "./dom.js";
import { csv, downloads, fileName } from "./downloads.js";
import { number, plural } from "./format.js";
import { SYMBOL, TURN } from "./physics.js";
import { Plot } from "./plot.js";
import { drawStage } from "./stage.js";
import { traceOf } from "./trace.js";

const PERIODS = 4;
const SAMPLES = 240; // a plate period
const SECONDS = 1.6; // a plate period at full speed

export class Motion {
  constructor(root, { closed }) {
    this.root = root;
    this.closed = closed;
    this.speed = 1;
    this.phase = 0;
  }

  /** Compute and show a cell: {gamma, omega, xi, direction}. */
  async show(job, cell) {
    this.asking?.abort();
    this.asking = new AbortController();
    const asked = { ...cell, periods: PERIODS, samples: SAMPLES };
    this.root.hidden = false;
    this.root.setAttribute("aria-busy", "true");
    if (!this.plot) this.root.replaceChildren(this.#head(cell), h("p", { className: "note" }, "Computing …"));
    try {
      const path = await askJson(`/v1/jobs/${job.id}/trajectory?${query(asked)}`, { signal: this.asking.signal });
      this.#begin(job, { ...cell, ...path });
    } catch (error) {
      if (error.name === "AbortError") return;
      this.stop();
      this.root.replaceChildren(this.#head(cell), h("p", { className: "problem", role: "alert" }, error.message));
    } finally {
      this.root.removeAttribute("aria-busy");
    }
  }

  hide() {
    this.asking?.abort();
    this.stop();
    this.root.hidden = true;
    this.root.replaceChildren();
  }

  stop() {
    this.plot?.close();
    this.plot = null;
    cancelAnimationFrame(this.frame);
    this.playing = false;
  }

  #begin(job, path) {
    const again = this.plot ? this.playing : !matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.stop();
    this.path = path;
    this.trace = traceOf(path);
    this.stage = h("canvas", { className: "stage", role: "img", "aria-label": "The masses, the spring and the plate in motion" });
    const figure = h("figure", { className: "trace" });
    this.play = h("button", { type: "button", onclick: () => this.#play(!this.playing) }, "Play");
    this.root.replaceChildren(
      this.#head(path),
      h("div", { className: "moving" }, this.stage, figure),
      h("div", { className: "controls" }, this.play, this.#speeds(), this.#scrubber()),
      h("p", { className: "readout" }, describe(path)),
      this.#downloads(job),
    );
    this.plot = new Plot(figure, {
      label: "Where the masses and the plate are, over four plate periods",
      content: () => this.trace.content(() => this.phase),
      ratio: 0.62,
      least: 300,
    });
    this.plot.element.addEventListener("drawn", () => this.#draw());
    this.phase = 0;
    this.#play(again);
  }

  #head({ gamma, omega, xi, direction }) {
    const values = Object.entries({ gamma, omega, xi }).map(([axis, value]) => `${SYMBOL[axis]} = ${number(value)}`);
    const how = direction === "rest" ? "from rest" : `ramp ${direction}`;
    return h("header", {},
      h("h2", { tabindex: "-1" }, "A cell in motion"),
      h("p", { className: "note" }, `${values.join(", ")}, ${how}`),
      h("button", { type: "button", className: "quiet close", onclick: () => this.closed() }, "Close"));
  }

  #speeds() {
    return h("label", { className: "pick" }, "Speed ",
      h("select", { onchange: (event) => { this.speed = Number(event.target.value); } },
        [1, 0.5, 0.25, 0.1].map((speed) => h("option", { value: speed, selected: speed === this.speed }, `× ${speed}`))));
  }

  #scrubber() {
    this.scrub = h("input", {
      type: "range", min: 0, max: PERIODS, step: 0.005, value: 0, "aria-label": "Plate periods since the first sample",
      oninput: () => {
        this.#play(false);
        this.phase = this.scrub.valueAsNumber * TURN;
        this.#draw();
      },
    });
    return this.scrub;
  }

  #play(on) {
    this.playing = on;
    this.play.textContent = on ? "Pause" : "Play";
    cancelAnimationFrame(this.frame);
    if (!on) return;
    let before = performance.now();
    const step = (now) => {
      this.phase = (this.phase + ((now - before) / 1000 / SECONDS) * TURN * this.speed) % (PERIODS * TURN);
      before = now;
      this.#draw();
      this.frame = requestAnimationFrame(step);
    };
    this.frame = requestAnimationFrame(step);
  }

  #draw() {
    if (!this.plot?.box) return;
    drawStage(this.stage, this.trace, this.phase, this.plot.sheet.clientHeight);
    this.plot.drawCursor();
    this.scrub.value = String(this.phase / TURN);
    this.root.dataset.phase = this.phase.toFixed(3);
  }

  #downloads(job) {
    const name = (kind) => () => fileName(job, `motion-${number(this.path.gamma)}-${number(this.path.omega)}`, kind);
    const { phase, plate, z1, z2, force } = this.path;
    return downloads([
      ["PNG", name("png"), () => this.plot.png()],
      ["SVG", name("svg"), () => this.plot.svg()],
      ["CSV", name("csv"), () => csv(["phase_rad", "plate", "z1", "z2", "force"], phase.map((one, i) => [one, plate[i], z1[i], z2[i], force[i]]))],
    ]);
  }
}

function describe({ flights, complete }) {
  const times = flights.flight_time.filter((time) => time > 1e-3);
  const what = times.length
    ? `${plural(times.length, "whole flight")} in these ${PERIODS} plate periods: ${times.slice(0, 8).map((time) => number(time, 4)).join(", ")}${times.length > 8 ? " …" : ""} rad.`
    : "It stays on the plate.";
  return complete ? what : `${what} It could not be followed to the end.`;
}
