// The trajectory of one cell: requesting it from the service, waiting for it, and describing it in words.

import { requestDataset } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { duration, number, plural } from "../lib/format.js";
import { TWO_PI } from "../lib/physics.js";

export const PERIODS = 4; // plate periods shown
export const START_PERIODS = 16; // of a drop, which takes longer to show where it leads
export const SAMPLES = 240; // per plate period
export const MAP_PERIODS = 120; // of a return map, which needs many flights
export const MAP_SAMPLES = 2; // per plate period: of such a motion only its flights are shown

const TIMEOUT_MS = 180_000; // the first trajectory may wait for the kernels to be compiled
const SLOW_MS = 2500; // after which the note explains the delay
const MIN_FLIGHT = 1e-3; // rad: shorter flights are not listed
const MAX_LISTED = 8;

/** As requestDataset, with the time that compiling takes; the motion is an object of lists, with null after its end. */
export const requestTrajectory = async (path, options = {}) => read(await requestDataset(path, { ...options, waits: true, timeout: TIMEOUT_MS }));

/** A trajectory from its Dataset, its phases since the first sample: those of a drop begin at the plate's phase. */
function read({ attrs, ...found }) {
  const list = (name) => Array.from(found[name].data, (value) => (Number.isNaN(value) ? null : value));
  const named = (names, value) => Object.fromEntries(names.map((name) => [name, value(name)]));
  return {
    ...attrs, ...named(["plate", "z1", "z2", "in_flight"], list), ...named(["gamma", "omega", "xi"], (name) => found[name].data),
    phase: list("phase").map((value, i, [first]) => value - first), flights: list("flight_time"),
    cycle: found.cycle_multipliers && named(["bounces", "periods", "flight_time", "stable", "multipliers"], (name) => found[`cycle_${name}`].data),
  };
}

/** The plate periods that a trajectory spans. */
export const periodsOf = ({ phase }) => Math.round(phase.at(-1) / TWO_PI);

/** The flights of a trajectory in words. */
export function describe({ phase, flights, complete }) {
  const times = flights.filter((time) => time > MIN_FLIGHT);
  const listed = times.slice(0, MAX_LISTED).map((time) => number(time, 4)).join(", ");
  const text = times.length
    ? `${plural(times.length, "complete flight")} in ${periodsOf({ phase })} plate periods: ${listed}${times.length > MAX_LISTED ? " …" : ""} rad.`
    : "The spring stays on the plate.";
  return complete ? text : `${text} The computation stopped before the end.`;
}

/** A note shown while a trajectory is computed. */
export class ComputingNote {
  constructor() {
    this.element = h("p", { className: "note computing", role: "status", hidden: true });
  }

  show() {
    this.hide();
    this.element.textContent = "Computing the trajectory …";
    this.element.hidden = false;
    const began = Date.now();
    this.timer = setInterval(() => {
      const waited = duration((Date.now() - began) / 1000);
      this.element.textContent = `Computing the trajectory … The first one of a contact model compiles its kernel (${waited}).`;
    }, SLOW_MS);
  }

  hide() {
    clearInterval(this.timer);
    this.element.hidden = true;
  }
}
