// One cell of a sweep in motion.

import { query } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { csv, downloads, fileName } from "../lib/downloads.js";
import { number, plural } from "../lib/format.js";
import { SYMBOL } from "../lib/physics.js";
import { PERIODS, Player, SAMPLES, Waiting } from "./player.js";
import { pngOf, svgOf } from "../plot/export.js";
import { trajectory } from "./trajectory.js";

export class Motion {
  player = null;
  waiting = new Waiting();

  constructor(root, { closed }) {
    this.root = root;
    this.closed = closed;
  }

  /** Compute and show a cell: {gamma, omega, xi, direction}. */
  async show(job, cell) {
    const name = JSON.stringify(cell);
    if (this.shown === name) return;
    this.shown = name;
    this.asking?.abort();
    this.asking = new AbortController();
    const { signal } = this.asking;
    this.root.hidden = false;
    this.root.setAttribute("aria-busy", "true");
    if (this.player) this.#say(cell);
    else this.root.replaceChildren(this.#head(cell), this.waiting.element);
    this.waiting.start();
    try {
      const asked = query({ ...cell, periods: PERIODS, samples: SAMPLES });
      const path = await trajectory(`/v1/jobs/${job.id}/trajectory?${asked}`, { signal });
      this.#show(job, { ...cell, ...path });
    } catch (error) {
      if (error.name === "AbortError") return;
      this.#stop();
      this.shown = null;
      this.root.replaceChildren(this.#head(cell), h("p", { className: "problem", role: "alert" }, error.message));
    } finally {
      if (!signal.aborted) {
        this.waiting.stop();
        this.root.removeAttribute("aria-busy");
      }
    }
  }

  hide() {
    this.asking?.abort();
    this.shown = null;
    this.waiting.stop();
    this.#stop();
    this.root.hidden = true;
    this.root.replaceChildren();
  }

  #stop() {
    this.player?.close();
    this.player = null;
  }

  #show(job, path) {
    if (!this.player) {
      const place = h("div", {});
      this.readout = h("p", { className: "readout" });
      this.root.replaceChildren(this.#head(path), this.waiting.element, place, this.readout, this.#downloads(job));
      this.player = new Player(place);
    }
    this.path = path;
    this.#say(path);
    this.readout.textContent = describe(path);
    this.player.show(path);
  }

  #head(cell) {
    this.about = h("p", { className: "note" });
    this.#say(cell);
    return h("header", {},
      h("h2", { tabindex: "-1" }, "A cell in motion"), this.about,
      h("button", { type: "button", className: "quiet close", onclick: () => this.closed() }, "Close"));
  }

  #say({ gamma, omega, xi, direction }) {
    const values = Object.entries({ gamma, omega, xi }).map(([axis, value]) => `${SYMBOL[axis]} = ${number(value)}`);
    this.about.textContent = `${values.join(", ")}, ${direction === "rest" ? "from rest" : `ramp ${direction}`}`;
  }

  #downloads(job) {
    const name = (kind) => () => fileName(job, `motion-${number(this.path.gamma)}-${number(this.path.omega)}`, kind);
    const rows = () => this.path.phase.map((one, i) => [one, ...["plate", "z1", "z2", "force"].map((what) => this.path[what][i])]);
    return downloads([
      ["PNG", name("png"), () => pngOf(this.player.plot)],
      ["SVG", name("svg"), () => svgOf(this.player.plot)],
      ["CSV", name("csv"), () => csv(["phase_rad", "plate", "z1", "z2", "force"], rows())],
    ]);
  }
}

/** What a motion is, in words. */
export function describe({ flights, complete }) {
  const times = flights.flight_time.filter((time) => time > 1e-3);
  const what = times.length
    ? `${plural(times.length, "whole flight")} in these ${PERIODS} plate periods: ${times.slice(0, 8).map((time) => number(time, 4)).join(", ")}${times.length > 8 ? " …" : ""} rad.`
    : "It stays on the plate.";
  return complete ? what : `${what} It could not be followed to the end.`;
}
