// The panel beside a view of a sweep: the trajectory of the selected cell.

import { query } from "../lib/api.js";
import { cycleText } from "../lib/cycles.js";
import { h } from "../lib/dom.js";
import { csv, downloads, fileName, originOf } from "../lib/downloads.js";
import { number } from "../lib/format.js";
import { SYMBOL } from "../lib/physics.js";
import { startOf } from "../lib/starts.js";
import { pngOf, svgOf } from "../plot/export.js";
import { Portraits } from "./portraits.js";
import { Player } from "./player.js";
import { ComputingNote, MAP_PERIODS, MAP_SAMPLES, PERIODS, SAMPLES, START_PERIODS, describe, requestTrajectory } from "./trajectory.js";

const COLUMNS = ["plate", "z1", "z2", "force"];

export class TrajectoryPanel {
  player = null;
  computing = new ComputingNote();

  constructor(root, { onClose }) {
    this.root = root;
    this.onClose = onClose;
  }

  /** Request and show the trajectory of a cell, or of a start: {gamma, omega, xi, direction or startName}. */
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
      if (startOf(cell.direction)) this.portraits.show({ flights: trajectory.flights.flight_time });
      else this.#showReturnMap(job, cell, signal);
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

  /** The motion of a cell as the sweep left it, or of a start; of a cycle, on an ideal plate. */
  #request(job, { direction, ...cell }, signal) {
    const start = startOf(direction);
    if (start?.kind === "attractor") {
      const parameters = query({ ...cell, attractor: start.number, periods: START_PERIODS, samples: SAMPLES });
      return requestTrajectory(`/v1/jobs/${job.id}/trajectory?${parameters}`, { signal });
    }
    const model = start?.kind === "cycle" ? { kind: "rigid" } : job.spec.model;
    const periods = start?.kind === "cycle" ? PERIODS : START_PERIODS;
    if (start) return requestTrajectory("/v1/trajectories", { method: "POST", signal, body: { ...cell, start, model, periods, samples: SAMPLES } });
    const parameters = query({ ...cell, direction, periods: PERIODS, samples: SAMPLES });
    return requestTrajectory(`/v1/jobs/${job.id}/trajectory?${parameters}`, { signal });
  }

  /** The motion of a cell for so long that its flights make a return map; the panel is complete without it. */
  async #showReturnMap(job, cell, signal) {
    const { portraits } = this;
    try {
      const parameters = query({ ...cell, periods: MAP_PERIODS, samples: MAP_SAMPLES });
      const { flights } = await requestTrajectory(`/v1/jobs/${job.id}/trajectory?${parameters}`, { signal });
      portraits.show({ flights: flights.flight_time });
    } catch (error) {
      if (error.name !== "AbortError") portraits.fail(error);
    }
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
    this.portraits?.close();
    this.player = null;
  }

  #play(job, trajectory) {
    if (!this.player) {
      const container = h("div", {});
      this.readout = h("p", { className: "readout" });
      this.root.replaceChildren(this.#header(trajectory), this.computing.element, container, this.readout, this.#downloads(job));
      this.player = new Player(container);
      this.portraits = new Portraits(this.root);
    }
    this.trajectory = trajectory;
    this.#describeCell(trajectory);
    this.readout.textContent = trajectory.cycle ? `On the ${cycleText(trajectory.cycle)}. ${describe(trajectory)}` : describe(trajectory);
    this.player.show(trajectory);
    this.portraits.show({ trajectory, flights: null });
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
    this.title.textContent = `Trajectory of ${{ cycle: "a cycle", drop: "a drop", contact: "a start", attractor: "an attractor" }[startOf(direction)?.kind] ?? "a cell"}`;
    this.about.textContent = `${values.join(", ")}, ${startText(direction)}`;
  }

  #downloads(job) {
    const name = (extension) => () => fileName(job, `trajectory-${number(this.trajectory.gamma)}-${number(this.trajectory.omega)}`, extension);
    const rows = () => this.trajectory.phase.map((phase, i) => [phase, ...COLUMNS.map((column) => this.trajectory[column][i])]);
    return downloads([
      ["PNG", name("png"), async () => pngOf(this.player.plot, { origin: await originOf(job) })],
      ["SVG", name("svg"), async () => svgOf(this.player.plot, { origin: await originOf(job) })],
      ["CSV", name("csv"), () => csv(["phase_rad", ...COLUMNS], rows())],
    ]);
  }
}

function startText(direction) {
  const start = startOf(direction);
  if (start?.kind === "cycle") return "on a cycle in closed form";
  if (start?.kind === "drop") return `let go ${number(start.height)} above the plate at phase ${number(start.phase)}`;
  if (start?.kind === "attractor") return `on attractor ${start.number} of the cell`;
  if (start) return `in contact, elongation ${number(start.elongation)}, velocity × Ω ${number(start.velocity)}`;
  return direction === "rest" ? "from rest" : `ramp ${direction}`;
}
