// The motion of a spring: requested from the service, and told in words.

import { requestDataset } from "../lib/api.js";
import { number, plural } from "../lib/format.js";
import { cycleText } from "../lib/physics.js";
import { periodsOf } from "./player.js";

const TIMEOUT_MS = 180_000; // the first trajectory may wait for the kernels to be compiled
const MIN_FLIGHT = 1e-3; // rad: shorter flights are not listed
const MAX_LISTED = 8;

/** A trajectory from its Dataset: lists, with NaN after its end; its phases since the first sample, as those of a drop begin at the plate's phase. */
export async function requestMotion(path, options) {
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
export function describeMotion({ phase, flights, in_flight: flies, cycle, complete }) {
  const times = flights.filter((time) => time > MIN_FLIGHT);
  const listed = times.slice(0, MAX_LISTED).map((time) => number(time, 4)).join(", ");
  const text = times.length
    ? `${plural(times.length, "complete flight")} in ${periodsOf({ phase })} plate periods: ${listed}${times.length > MAX_LISTED ? " …" : ""} rad.`
    : flies.some(Boolean) ? `No flight is complete within ${periodsOf({ phase })} plate periods.` : "The spring stays on the plate.";
  return `${cycle ? `On the ${cycleText(cycle)}. ` : ""}${text}${complete ? "" : " The computation stopped before the end."}`;
}
