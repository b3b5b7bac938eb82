// The panel beside a view of a sweep: the trajectory of the selected cell, and all its values.

import { query, requestBlob, requestDataset } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { downloads, fileName } from "../lib/downloads.js";
import { number } from "../lib/format.js";
import { SYMBOL, cycleText, startOf } from "../lib/physics.js";
import { Portraits } from "./portraits.js";
import { Player } from "./player.js";
import { ComputingNote, MAP_PERIODS, MAP_SAMPLES, PERIODS, SAMPLES, START_PERIODS, describe, requestTrajectory } from "./trajectory.js";

const MAX_LISTED = 8; // numbers of a variable

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
      const [path, options] = addressOf(job, cell);
      const trajectory = await requestTrajectory(path, { ...options, signal });
      this.#play(job, { ...cell, ...trajectory });
      this.files.replaceChildren(this.#downloads(job, cell, path, options));
      if (startOf(cell.direction)) this.portraits.show({ flights: trajectory.flights });
      else {
        this.#showReturnMap(job, cell, signal);
        this.#showValues(job, cell, signal).catch(() => {}); // the panel is complete without them
      }
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

  /** The motion of a cell for so long that its flights make a return map; the panel is complete without it. */
  async #showReturnMap(job, cell, signal) {
    const { portraits } = this;
    try {
      const parameters = query({ ...cell, periods: MAP_PERIODS, samples: MAP_SAMPLES });
      const { flights } = await requestTrajectory(`/v1/jobs/${job.id}/trajectory?${parameters}`, { signal });
      portraits.show({ flights });
    } catch (error) {
      if (error.name !== "AbortError") portraits.fail(error);
    }
  }

  /** All variables that the diagram has of the cell. */
  async #showValues(job, { gamma, ...cell }, signal) {
    const result = await requestDataset(`/v1/jobs/${job.id}/diagram?${query({ ...cell, start: gamma, stop: gamma })}`, { signal });
    const rows = Object.values(result).filter(({ attrs }) => attrs?.long_name);
    this.values.hidden = false;
    this.values.replaceChildren(h("summary", {}, "All values of the cell"), h("table", {}, h("tbody", {}, rows.map((variable) =>
      h("tr", {}, h("th", { scope: "row" }, variable.attrs.long_name), h("td", {}, valueText(variable)))))));
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
      this.values = h("details", {});
      this.files = h("div", {});
      this.root.replaceChildren(this.#header(trajectory), this.computing.element, container, this.readout, this.values, this.files);
      this.player = new Player(container);
      this.portraits = new Portraits(this.root);
    }
    this.values.hidden = true;
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

  #downloads(job, { gamma, omega }, path, options) {
    const name = (extension) => () => fileName(job, `trajectory-${number(gamma)}-${number(omega)}`, extension);
    const file = (format) => () => requestBlob(`${path}${path.includes("?") ? "&" : "?"}format=${format}`, options);
    return downloads([
      ["PNG", name("png"), () => this.player.plot.png()],
      ...(options.body ? [] : [["CSV", name("csv"), file("csv")]]),
      ["NetCDF", name("nc"), file("nc")],
    ]);
  }
}

/** The path and options of a request for the motion of a cell as the sweep left it, or of a start; of a cycle, on an ideal plate. */
function addressOf(job, { direction, ...cell }) {
  const start = startOf(direction);
  if (start && start.kind !== "attractor") {
    const [model, periods] = start.kind === "cycle" ? [{ kind: "rigid" }, PERIODS] : [job.spec.model, START_PERIODS];
    return ["/v1/trajectories", { method: "POST", body: { ...cell, start, model, periods, samples: SAMPLES } }];
  }
  const parameters = start ? { attractor: start.number, periods: START_PERIODS } : { direction, periods: PERIODS };
  return [`/v1/jobs/${job.id}/trajectory?${query({ ...cell, ...parameters, samples: SAMPLES })}`, {}];
}

/** The value of a variable of one cell, or its numbers, with units; of codes their meaning. */
function valueText({ data, attrs: { units = "1", flag_values: codes, flag_meanings: meanings } }) {
  const values = typeof data === "object" ? Array.from(data) : [data];
  const texts = values.filter((value) => !Number.isNaN(value)).map((value) => {
    if (codes) return meanings.split(" ")[codes.indexOf(value)].replaceAll("_", " ");
    return typeof value === "number" ? number(value, 6) : String(value);
  });
  return `${texts.slice(0, MAX_LISTED).join(", ")}${texts.length > MAX_LISTED ? " …" : ""}${units === "1" || !texts.length ? "" : ` ${units}`}` || "–";
}

function startText(direction) {
  const start = startOf(direction);
  if (start?.kind === "cycle") return "on a cycle in closed form";
  if (start?.kind === "drop") return `let go ${number(start.height)} above the plate at phase ${number(start.phase)}`;
  if (start?.kind === "attractor") return `on attractor ${start.number} of the cell`;
  if (start) return `in contact, elongation ${number(start.elongation)}, velocity × Ω ${number(start.velocity)}`;
  return direction === "rest" ? "from rest" : `ramp ${direction}`;
}
