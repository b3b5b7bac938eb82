// The panel beside a view of a sweep: the trajectory of the selected cell, and all its values.

import { query, requestDataset } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { downloads, fileName, resultFiles } from "../lib/downloads.js";
import { number } from "../lib/format.js";
import { SYMBOL, hasOwnCycles, startOf } from "../lib/physics.js";
import { table } from "../lib/table.js";
import { MAPPED, Motion, PLAYED, STARTED } from "./motion.js";

const MAX_LISTED = 8; // numbers of a variable

export class TrajectoryPanel {
  motion = null;

  constructor(root, { onClose }) {
    Object.assign(this, { root, onClose });
  }

  /** Request and show the trajectory of a cell, or of a start: {gamma, omega, xi, direction or startName}. */
  async show(job, cell) {
    const key = JSON.stringify(cell);
    if (this.shown === key) return;
    this.shown = key;
    this.request?.abort();
    this.request = new AbortController();
    const { signal } = this.request;
    if (!this.motion) this.#build();
    const start = startOf(cell.direction);
    const values = Object.entries(SYMBOL).map(([axis, symbol]) => `${symbol} = ${number(cell[axis])}`);
    this.title.textContent = `Trajectory of ${{ cycle: "a cycle", drop: "a drop", contact: "a start", attractor: "an attractor" }[start?.kind] ?? "a cell"}`;
    this.about.textContent = `${values.join(", ")}, ${startText(cell.direction, job)}`;
    this.values.hidden = this.proof.hidden = true;
    const [path, options] = addressOf(job, cell);
    const isShown = await this.motion.load(path, { ...options, signal });
    if (signal.aborted) return;
    if (!isShown) {
      this.shown = null; // it is requested again
      return;
    }
    const name = () => `trajectory-${number(cell.gamma)}-${number(cell.omega)}`;
    this.files.replaceChildren(downloads([
      ["PNG", () => fileName(job, name(), "png"), () => this.motion.player.plot.png()],
      ...resultFiles(job, name, [["CSV", "csv"], ["NetCDF", "nc"]], () => path, options),
    ]));
    if (!options.body) this.#offerProof(path, signal);
    if (start) {
      this.motion.portraits.show({ flights: this.motion.trajectory.flights });
      return;
    }
    this.motion.portraits.show({ flights: null });
    this.motion.loadMap(`/v1/jobs/${job.id}/trajectory?${query({ ...cell, ...MAPPED })}`, { signal });
    this.#showValues(job, cell, signal).catch(() => {}); // the panel is complete without them
  }

  #build() {
    this.root.hidden = false;
    this.about = h("p", { className: "note" });
    this.title = h("h2", { tabindex: "-1" });
    this.values = h("details", { hidden: true });
    this.files = h("div", {});
    this.proof = h("div", { hidden: true, role: "status" });
    this.motion = new Motion();
    this.root.replaceChildren(
      h("div", { className: "facts" },
        h("header", {}, this.title, this.about),
        this.proof, this.files, this.values),
      this.motion.element, this.motion.portraits.element,
      h("button", { type: "button", className: "quiet close", onclick: () => this.onClose() }, "Close"));
  }

  /** A button that has the cell's cycle proven, and the answer in its place. */
  #offerProof(path, signal) {
    const prove = async () => {
      this.proof.textContent = "Proving …";
      try {
        const { proof, proof_says: says, proven_flight_times: times } = await requestDataset(`${path}&prove=true`, { signal, waits: true });
        const flights = times.data.map(([low, high]) => h("li", {}, `${low} to ${high} rad`));
        const about = flights.length > MAX_LISTED ? ` The first ${MAX_LISTED} of ${flights.length} flights:` : flights.length ? " Flights:" : "";
        this.proof.replaceChildren(h("strong", {}, proof.data), `: ${says.data}.${about}`, h("ul", {}, flights.slice(0, MAX_LISTED)));
      } catch (error) {
        if (!signal.aborted) this.proof.textContent = error.message;
      }
    };
    this.proof.hidden = false;
    this.proof.replaceChildren(h("button", { type: "button", className: "quiet", onclick: prove }, "Prove this cycle"));
  }

  hide() {
    this.request?.abort();
    this.motion?.close();
    Object.assign(this, { shown: null, motion: null });
    this.root.hidden = true;
    this.root.replaceChildren();
  }

  /** All variables that the diagram has of the cell. */
  async #showValues(job, { gamma, ...cell }, signal) {
    const result = await requestDataset(`/v1/jobs/${job.id}/diagram?${query({ ...cell, start: gamma, stop: gamma })}`, { signal });
    const rows = Object.values(result).filter(({ attrs }) => attrs?.long_name);
    this.values.hidden = false;
    this.values.replaceChildren(h("summary", {}, "All values of the cell"), table("Values of the cell", null, rows.map((variable) => [variable.attrs.long_name, valueText(variable)])));
  }
}

/** The path and options of a request for the motion of a cell as the sweep left it, or of a start; of a cycle, on the contact that has it. */
function addressOf(job, { direction, ...cell }) {
  const start = startOf(direction);
  if (start && start.kind !== "attractor") {
    const spring = start.kind === "cycle" ? { model: hasOwnCycles(job) ? job.spec.model : { kind: "rigid" }, ...PLAYED } : { model: job.spec.model, ...STARTED };
    return ["/v1/trajectories?", { method: "POST", body: { ...cell, start, ...spring } }];
  }
  const parameters = start ? { attractor: start.number, ...STARTED } : { direction, ...PLAYED };
  return [`/v1/jobs/${job.id}/trajectory?${query({ ...cell, ...parameters })}`, {}];
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

function startText(direction, job) {
  const start = startOf(direction);
  if (start?.kind === "cycle") return hasOwnCycles(job) ? "on a cycle of this contact" : "on a cycle in closed form";
  if (start?.kind === "drop") return `let go ${number(start.height)} above the plate at phase ${number(start.phase)}`;
  if (start?.kind === "attractor") return `on attractor ${start.number} of the cell`;
  if (start) return `in contact, elongation ${number(start.elongation)}, velocity × Ω ${number(start.velocity)}`;
  return direction === "rest" ? "from rest" : `ramp ${direction}`;
}
