// The motion of a cell, a cycle or a start: played, in words, with its return map, phase portrait and values.

import { cellQuery, link } from "../lib/address.js";
import { isHandledElsewhere, query, requestDataset } from "../lib/api.js";
import { button, downloads, fileName, h, problemLine, resultFiles, workButton } from "../lib/dom.js";
import { number, plural } from "../lib/format.js";
import { AXES, EXPLORED, axisText, axisValues, clamp, contactQuery, cycleText, hasOwnCycles, isIdeal, startOf } from "../lib/physics.js";
import { table } from "../lib/table.js";
import { Player, periodsOf } from "./player.js";
import { MIN_FLIGHT, Portraits } from "./portraits.js";

/** Of a motion that is played, in plate periods and samples per period; of a start, which takes longer to show where it leads. */
const PLAYED = { periods: 4, samples: 240 };
const STARTED = { periods: 16, samples: 240 };
const LONGEST = 24; // plate periods of a cycle that is played whole
/** Of a return map, which needs many flights and nothing else of the motion. */
const MAPPED = { periods: 120, samples: 2 };
const SLOW_MS = 300; // after which a note takes the place of the motion before: it would seem to be of this cell
const MAX_LISTED = 8; // flights, or numbers of a variable
const SAME_CYCLE = 1e-4; // rad between flight times; no start finds most cycles of several bounces that cells settled to
const TIMEOUT_MS = 180_000; // the first trajectory may wait for the kernels to be compiled
/** Of each kind of start: whose motion it is, and in words where it begins. */
const STARTS = {
  cycle: ["a cycle", (start, job) => (hasOwnCycles(job) ? `on a cycle of ${job.spec.model.kind === "stepped" ? "the soft contact that its steps approximate" : "this contact"}` : "on a cycle in closed form")],
  drop: ["a drop", ({ height, phase }) => `let go ${number(height)} above the plate at phase ${number(phase)}`],
  contact: ["a start", ({ elongation, velocity }) => `in contact, elongation ${number(elongation)}, velocity × Ω ${number(velocity)}`],
  attractor: ["an attractor", (start) => `on attractor ${start.number} by share of drops`],
};

export class TrajectoryPanel {
  trajectory = null; // while one is shown

  /** Shown in `root`, until `signal` aborts; without `onClose` it cannot be closed. */
  constructor(root, signal, onClose = null) {
    Object.assign(this, { root, signal });
    this.about = h("p", { className: "note" });
    this.title = h("h2", { tabindex: "-1" });
    this.explore = h("a", {}, "Explore this spring");
    this.values = h("details");
    this.files = h("div", {});
    this.proof = h("div", { role: "status" });
    this.note = h("p", { className: "note", role: "status", hidden: true }, "Computing the trajectory … The first one of a contact model compiles its kernel.");
    this.problem = problemLine();
    this.readout = h("p", { className: "readout", role: "status" });
    [this.player, this.portraits] = [new Player(signal), new Portraits(signal)];
    root.replaceChildren(
      h("div", { className: "facts", role: "group", "aria-label": "The motion in words" }, h("header", {}, this.title, this.about, this.explore), this.note, this.problem.element, this.readout, this.proof, this.files, this.values),
      this.player.element, this.portraits.element,
      ...(onClose ? [button("×", onClose, { className: "quiet close", "aria-label": "Close", title: "Close" })] : []));
    root.classList.add("empty");
    signal.addEventListener("abort", () => this.hide());
  }

  /** Request and show the motion of a cell {gamma, omega, xi, direction or startName} of a job, or of one spring: a job
   * without id. Ends when the motion is shown; the rest follows. */
  async show(job, cell) {
    const key = JSON.stringify([cell, job.spec.model]);
    if (this.shown === key || this.signal.aborted) return;
    this.shown = key;
    this.request?.abort();
    const { signal } = this.request = new AbortController();
    this.root.hidden = false;
    clearTimeout(this.timer);
    this.timer = setTimeout(() => {
      this.note.hidden = false;
      this.root.classList.add("empty");
    }, this.trajectory ? SLOW_MS : 0);
    const start = startOf(cell.direction);
    const [gamma, omega, xi] = AXES.map((axis) => axisText(cell[axis], axisValues(job.spec[axis] ?? [])));
    const [moving, textOf] = STARTS[start?.kind] ?? ["a cell", () => (cell.direction === "rest" ? "from rest" : `ramp ${cell.direction}`)];
    this.title.textContent = `Trajectory of ${moving}`;
    this.about.textContent = `Γ = ${gamma}, Ω = ${omega}, ξ = ${xi}, ${textOf(start, job)}`;
    const { model = { kind: "rigid" } } = job.spec; // of cycles in closed form
    const { model: contact, adhesive = true, ...parameters } = contactQuery(model);
    const isThere = job.id && adhesive && (contact || isIdeal(model)) && AXES.every((axis) => clamp(cell[axis], ...EXPLORED[axis]) === cell[axis]);
    const place = { ...cellQuery(cell), ...(start && start.kind !== "attractor" ? {} : { cell: null }) };
    Object.assign(this.explore, { hidden: !isThere, href: link(["explore"], { ...place, contact, ...parameters }) });
    for (const element of [this.values, this.proof]) element.replaceChildren();
    const length = !start || start.kind === "cycle" ? PLAYED : STARTED;
    let path, options, cycle = start?.periods ?? 0; // cycle: its plate periods
    const load = (periods) => {
      [path, options] = requestOf(job, cell, { ...length, periods });
      return this.#load(path, { ...options, signal }, start, model);
    };
    try {
      if (!start && job.id) cycle = await this.#showValues(job, cell, signal).catch(() => 0); // complete without values
      await load(Math.max(length.periods, Math.min(cycle, LONGEST)));
      const { flights, in_flight: flies } = this.trajectory;
      if (!flights.length && flies.some(Boolean) && length === PLAYED) await load(STARTED.periods); // of a long flight
    } catch (error) {
      if (signal.aborted) return;
      this.shown = null; // it is requested again
      if (!isHandledElsewhere(error)) this.#showError(error);
      return;
    }
    const name = () => `trajectory-${gamma}-${omega}`;
    this.files.replaceChildren(downloads([
      ["PNG", () => fileName(job, name(), "png"), () => this.player.plot.png()],
      ...resultFiles(job, name, [["CSV", "csv"], ["NetCDF", "nc"]], () => path, options),
    ]));
    const [mapPath, mapOptions] = requestOf(job, cell, MAPPED);
    const mapFailed = (error) => { if (!isHandledElsewhere(error)) this.portraits.mapNote.textContent = error.message; };
    requestMotion(mapPath, { ...mapOptions, signal }).then(({ flights: mapped }) => this.portraits.show({ flights: mapped })).catch(mapFailed);
    if (!options.body && (start || cycle)) this.#offerProof(path, signal, cycle);
  }

  /** Play a motion on the contact `model`. */
  async #load(path, options, start, model) {
    const trajectory = await requestMotion(path, options).finally(() => {
      if (options.signal.aborted) return; // another one is loaded, or none
      clearTimeout(this.timer);
      this.note.hidden = true;
    });
    this.trajectory = { ...trajectory, contact: model };
    this.#showError(null);
    this.player.show(this.trajectory);
    this.readout.textContent = describeMotion(this.trajectory, start);
    this.portraits.show({ trajectory: this.trajectory, flights: null });
  }

  #showError(error) {
    this.problem.show(error);
    this.root.classList.toggle("empty", Boolean(error));
  }

  /** A button that has the cell's cycle proven, or of an attractor one that it may be on, and the answer in its place. */
  #offerProof(path, signal, cycle) {
    const prove = async () => {
      const { proof, proof_says: says, proven_flight_times: times } = await requestDataset(`${path}&prove=true`, { signal });
      const flights = times.data.map(([low, high]) => h("li", {}, `${low} to ${high} rad`));
      const listed = flights.length > MAX_LISTED ? `The first ${MAX_LISTED} of ${flights.length} flights` : "Flights";
      const about = flights.length ? ` ${listed}:` : "";
      this.proof.replaceChildren(h("strong", {}, proof.data), `: ${says.data}.${about}`, h("ul", {}, flights.slice(0, MAX_LISTED)));
      if (document.activeElement === document.body) this.title.focus({ preventScroll: true }); // the button pressed is gone
    };
    const failed = (error) => { if (!signal.aborted) this.proof.textContent = error.message; };
    this.proof.replaceChildren(workButton(cycle ? "Prove this cycle" : "Look for a cycle to prove", prove, failed, { className: "quiet", busy: "Proving …" }));
  }

  hide() {
    this.request?.abort();
    clearTimeout(this.timer);
    this.player.stop();
    this.problem.show(null);
    this.files.replaceChildren();
    this.root.classList.add("empty");
    Object.assign(this, { shown: null, trajectory: null });
    this.root.hidden = true;
  }

  /** All variables that the diagram has of the cell; returns the plate periods of its cycle, 0 if it has none. */
  async #showValues(job, { gamma, ...cell }, signal) {
    const result = await requestDataset(`/v1/jobs/${job.id}/diagram?${query({ ...cell, start: gamma, stop: gamma })}`, { signal });
    const rows = Object.values(result).filter(({ attrs }) => attrs?.long_name).map((variable) => [variable.attrs.long_name, valueText(variable)]);
    this.values.replaceChildren(h("summary", {}, "All values of the cell"), table("Values of the cell", null, rows));
    return result.periods.data[0] ?? result.periods.data;
  }
}

/** The path and options of a request for the motion of a cell as the sweep left it, or of a start; of a cycle, on the contact that has it. */
function requestOf(job, { direction, ...cell }, length) {
  const start = startOf(direction);
  if (job.id && (!start || start.kind === "attractor")) {
    return [`/v1/jobs/${job.id}/trajectory?${query({ ...cell, ...(start ? { attractor: start.number } : { direction }), ...length })}`, {}];
  }
  const model = start?.kind === "cycle" && !hasOwnCycles(job) ? { kind: "rigid" } : job.spec.model;
  return ["/v1/trajectories?", { method: "POST", body: { ...cell, model, ...(start && { start }), ...length }, waits: true }];
}

/** The value of a variable of one cell, or its numbers, with units; of codes their meaning. */
function valueText({ data, attrs: { units = "1", flag_values: codes, flag_meanings: meanings } }) {
  const values = typeof data === "object" ? Array.from(data) : [data];
  const texts = values.filter((value) => !Number.isNaN(value)).map((value) => {
    if (codes) return meanings.split(" ")[codes.indexOf(value)].replaceAll("_", " ");
    return typeof value === "number" ? number(value, 6) : String(value);
  });
  const unit = units === "1" ? "" : ` ${units}`;
  return (texts.length && `${texts.slice(0, MAX_LISTED).join(", ")}${texts.length > MAX_LISTED ? " …" : ""}${unit}`) || "–";
}

/** A trajectory from its Dataset: lists, with NaN after its end; its phases since the first sample, as those of a drop begin at the plate's phase. */
async function requestMotion(path, options) {
  const { attrs, ...variables } = await requestDataset(path, { ...options, timeout: TIMEOUT_MS });
  options.signal.throwIfAborted(); // closed meanwhile
  const list = (name) => Array.from(variables[name].data);
  const named = (names, value) => Object.fromEntries(names.map((name) => [name, value(name)]));
  const ofCycle = ["bounces", "periods", "flight_time", "stable", "multipliers"];
  return {
    ...attrs, ...named(["plate", "z1", "z2", "velocity", "in_flight"], list), ...named(AXES, (name) => variables[name].data),
    ...named(["phase", "takeoff"], (name) => list(name).map((value) => value - variables.phase.data[0])), flights: list("flight_time"),
    cycle: variables.cycle_multipliers && named(ofCycle, (name) => variables[`cycle_${name}`].data),
  };
}

function describeMotion({ cycle, complete, ...motion }, start) {
  const on = Math.abs(cycle?.flight_time - start?.flight_time) > SAME_CYCLE ? "Not on the cycle pressed, but on a" : "On the";
  return `${cycle ? `${on} ${cycleText(cycle)}. ` : ""}${flightsText(motion)}${complete ? "" : " The computation stopped before the end."}`;
}

function flightsText({ phase, flights, in_flight: flies }) {
  const times = flights.filter((time) => time > MIN_FLIGHT);
  const periods = `${periodsOf({ phase })} plate periods`;
  if (!times.length) return flies.some(Boolean) ? `No flight is complete within ${periods}.` : "The spring stays on the plate.";
  const listed = times.slice(0, MAX_LISTED).map((time) => number(time, 4)).join(", ");
  return `${plural(times.length, "complete flight")} in ${periods}: ${listed}${times.length > MAX_LISTED ? " …" : ""} rad.`;
}
