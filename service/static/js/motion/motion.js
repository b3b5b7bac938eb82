// The motion of a spring: requested from the service, played, told in words, with its return map and phase portrait.

import { isHandledElsewhere, requestDataset } from "../lib/api.js";
import { h, problemLine } from "../lib/dom.js";
import { number, plural } from "../lib/format.js";
import { cycleText } from "../lib/physics.js";
import { Player, periodsOf } from "./player.js";
import { Portraits } from "./portraits.js";

/** Of a motion that is played, in plate periods and samples per period; of a start, which takes longer to show where it leads. */
export const PLAYED = { periods: 4, samples: 240 };
export const STARTED = { periods: 16, samples: 240 };
/** Of a return map, which needs many flights and nothing else of the motion. */
export const MAPPED = { periods: 120, samples: 2 };

const TIMEOUT_MS = 180_000; // the first trajectory may wait for the kernels to be compiled
const SLOW_MS = 2500; // after which the note explains the delay
const MIN_FLIGHT = 1e-3; // rad: shorter flights are not listed
const MAX_LISTED = 8;

export class Motion {
  trajectory = null;

  constructor() {
    this.note = h("p", { className: "note computing", role: "status", hidden: true });
    this.problem = problemLine();
    this.readout = h("p", { className: "readout", role: "status" });
    this.element = h("div", {}, this.note, this.problem.element);
    this.player = new Player(this.element);
    this.element.append(this.readout);
    this.portraits = new Portraits(); // shown where its owner puts them
  }

  close() {
    this.closed = true;
    clearTimeout(this.timer);
    this.player.close();
    this.portraits.close();
  }

  /** Play the motion at `path`, requested with `options`; false if there is none. */
  async load(path, options) {
    this.#wait();
    try {
      const trajectory = await request(path, options);
      if (this.closed) return false;
      this.trajectory = trajectory;
      this.player.show(trajectory);
      this.readout.textContent = describe(trajectory);
      this.portraits.show({ trajectory });
      this.#showError(null);
      return true;
    } catch (error) {
      if (!isHandledElsewhere(error)) this.#showError(error);
      return false;
    } finally {
      if (!options.signal?.aborted) {
        clearTimeout(this.timer);
        this.note.hidden = true;
      }
    }
  }

  /** Show the return map of a longer motion, which the rest does not need. */
  async loadMap(path, options) {
    try {
      const { flights } = await request(path, options);
      if (!this.closed) this.portraits.show({ flights });
    } catch (error) {
      if (!isHandledElsewhere(error)) this.portraits.mapNote.textContent = error.message;
    }
  }

  #wait() {
    clearTimeout(this.timer);
    this.note.textContent = "Computing the trajectory …";
    this.note.hidden = Boolean(this.trajectory);
    this.timer = setTimeout(() => {
      this.note.hidden = false;
      this.note.textContent = "Computing the trajectory … The first one of a contact model compiles its kernel.";
    }, SLOW_MS);
  }

  /** An error takes the place of the motion. */
  #showError(error) {
    this.problem.show(error);
    for (const element of [this.player.element, this.portraits.element, this.readout]) element.hidden = Boolean(error);
  }
}

/** A trajectory from its Dataset: lists, with NaN after its end; its phases since the first sample, as those of a drop begin at the plate's phase. */
async function request(path, options) {
  const { attrs, ...found } = await requestDataset(path, { ...options, waits: true, timeout: TIMEOUT_MS });
  const list = (name) => Array.from(found[name].data);
  const named = (names, value) => Object.fromEntries(names.map((name) => [name, value(name)]));
  return {
    ...attrs, ...named(["plate", "z1", "z2", "velocity", "in_flight"], list), ...named(["gamma", "omega", "xi"], (name) => found[name].data),
    phase: list("phase").map((value, i, [first]) => value - first), flights: list("flight_time"),
    cycle: found.cycle_multipliers && named(["bounces", "periods", "flight_time", "stable", "multipliers"], (name) => found[`cycle_${name}`].data),
  };
}

/** The flights of a trajectory in words. */
function describe({ phase, flights, in_flight: flies, cycle, complete }) {
  const times = flights.filter((time) => time > MIN_FLIGHT);
  const listed = times.slice(0, MAX_LISTED).map((time) => number(time, 4)).join(", ");
  const text = times.length
    ? `${plural(times.length, "complete flight")} in ${periodsOf({ phase })} plate periods: ${listed}${times.length > MAX_LISTED ? " …" : ""} rad.`
    : flies.some(Boolean) ? `No flight is complete within ${periodsOf({ phase })} plate periods.` : "The spring stays on the plate.";
  return `${cycle ? `On the ${cycleText(cycle)}. ` : ""}${text}${complete ? "" : " The computation stopped before the end."}`;
}
