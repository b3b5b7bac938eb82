// Cycles in closed form: which sweeps have them, their description in words, and their names in addresses.

import { number } from "./format.js";
import { startName } from "./starts.js";

/** Contact models whose cells move as a spring: the closed form is that of `rigid` without restitution. */
export const hasCycles = ({ spec }) => ["rigid", "soft", "stepped"].includes(spec.model.kind);

/** "cycle (1, 1), unstable · flight time 3.9 rad · multipliers 2.1, 0.3" */
export function cycleText({ bounces, periods, stable, flight_time: time, multipliers }) {
  const texts = multipliers[0][1] ? [`${number(multipliers[0][0], 4)} ± ${number(Math.abs(multipliers[0][1]), 4)} i`] : multipliers.map(([real]) => number(real, 4));
  return `cycle (${bounces}, ${periods}), ${stable ? "stable" : "unstable"} · flight time ${number(time, 5)} rad · multipliers ${texts.join(", ")}`;
}

/** How addresses name a cycle in place of a direction. */
export const cycleName = ({ branch, point }) => startName("cycle", branch.periods, branch.flight_time[point]);
