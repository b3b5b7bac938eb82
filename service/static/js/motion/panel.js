// The panel beside a view of a sweep: the trajectory of the selected cell.

import { query } from "../lib/api.js";
import { cycleStart, cycleText } from "../lib/cycles.js";
import { h } from "../lib/dom.js";
import { csv, downloads, fileName } from "../lib/downloads.js";
import { number } from "../lib/format.js";
import { SYMBOL } from "../lib/physics.js";
import { pngOf, svgOf } from "../plot/export.js";
import { Player } from "./player.js";
import { ComputingNote, PERIODS, SAMPLES, describe, requestTrajectory } from "./trajectory.js";

const COLUMNS = ["plate", "z1", "z2", "force"];

export class TrajectoryPanel {
  player = null;
  computing = new ComputingNote();

  constructor(root, { onClose }) {
    this.root = root;
    this.onClose = onClose;
  }

  /** Request and show the trajectory of a cell, or of a cycle: {gamma, omega, xi, direction or cycleName}. */
  async show(job, cell) {
    const key = JSON.stringify(cell);
    if (this.shown === key) return;
    this.shown = key;
    this.request?.abort();
    this.request = new AbortController();
    const { signal } = this.request;
    this.root.hidden = false;
    this.root.setAttribute("aria-busy", "true");
    if (this.player) this.#describeCell(cell);
    else this.root.replaceChildren(this.#header(cell), this.computing.element);
    this.computing.show();
    try {
      const trajectory = await this.#request(job, cell, signal);
      this.#play(job, { ...cell, ...trajectory });
    } catch (error) {
      if (error.name === "AbortError") return;
      this.#stop();
      this.shown = null;
      this.root.replaceChildren(this.#header(cell), h("p", { className: "problem", role: "alert" }, error.message));
    } finally {
      if (!signal.aborted) {
        this.computing.hide();
        this.root.removeAttribute("aria-busy");
      }
    }
  }

  /** The motion of a cell as the sweep left it; of a cycle, on an ideal plate from a start on it. */
  #request(job, { direction, ...cell }, signal) {
    const start = cycleStart(direction);
    if (start) return requestTrajectory("/v1/trajectories", { method: "POST", signal, body: { ...cell, start, model: { kind: "rigid" }, periods: PERIODS, samples: SAMPLES } });
    const parameters = query({ ...cell, direction, periods: PERIODS, samples: SAMPLES });
    return requestTrajectory(`/v1/jobs/${job.id}/trajectory?${parameters}`, { signal });
  }

  hide() {
    this.request?.abort();
    this.shown = null;
    this.computing.hide();
    this.#stop();
    this.root.hidden = true;
    this.root.replaceChildren();
  }

  #stop() {
    this.player?.close();
    this.player = null;
  }

  #play(job, trajectory) {
    if (!this.player) {
      const container = h("div", {});
      this.readout = h("p", { className: "readout" });
      this.root.replaceChildren(this.#header(trajectory), this.computing.element, container, this.readout, this.#downloads(job));
      this.player = new Player(container);
    }
    this.trajectory = trajectory;
    this.#describeCell(trajectory);
    this.readout.textContent = trajectory.cycle ? `On the ${cycleText(trajectory.cycle)}. ${describe(trajectory)}` : describe(trajectory);
    this.player.show(trajectory);
  }

  #header(cell) {
    this.about = h("p", { className: "note" });
    this.title = h("h2", { tabindex: "-1" });
    this.#describeCell(cell);
    return h("header", {},
      this.title, this.about,
      h("button", { type: "button", className: "quiet close", onclick: () => this.onClose() }, "Close"));
  }

  #describeCell({ gamma, omega, xi, direction }) {
    const values = Object.entries({ gamma, omega, xi }).map(([axis, value]) => `${SYMBOL[axis]} = ${number(value)}`);
    this.title.textContent = `Trajectory of a ${cycleStart(direction) ? "cycle" : "cell"}`;
    this.about.textContent = `${values.join(", ")}, ${startText(direction)}`;
  }

  #downloads(job) {
    const name = (extension) => () => fileName(job, `trajectory-${number(this.trajectory.gamma)}-${number(this.trajectory.omega)}`, extension);
    const rows = () => this.trajectory.phase.map((phase, i) => [phase, ...COLUMNS.map((column) => this.trajectory[column][i])]);
    return downloads([
      ["PNG", name("png"), () => pngOf(this.player.plot)],
      ["SVG", name("svg"), () => svgOf(this.player.plot)],
      ["CSV", name("csv"), () => csv(["phase_rad", ...COLUMNS], rows())],
    ]);
  }
}

function startText(direction) {
  if (cycleStart(direction)) return "on a cycle in closed form";
  return direction === "rest" ? "from rest" : `ramp ${direction}`;
}
