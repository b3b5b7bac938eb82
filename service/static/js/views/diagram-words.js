// A cell of the explorer in words, and the flights that are shown as a table.

import { csv } from "../lib/downloads.js";
import { flightsOf } from "../plot/flights.js";
import { number, plural } from "../lib/format.js";
import { OUTCOME, SYMBOL, modeText } from "../lib/physics.js";

const FEW = 6; // flights that are told one by one

/** What became of a cell; `several`: there is more than one ramp to tell apart. */
export function wordsOn({ line, cell }, along, several) {
  const { values, outcome, bounces, periods, shown } = line.arrays;
  const parts = [`${SYMBOL[along]} = ${number(values[cell])}`];
  if (several) parts.push(`ramp ${line.direction}`);
  parts.push(modeText(outcome[cell], bounces[cell], periods[cell]));
  if (outcome[cell] === OUTCOME.periodic) parts.push(`${plural(bounces[cell], "bounce")} in ${plural(periods[cell], "plate period")}`);
  const times = flightsOf(line, cell);
  if (times?.length && times.length <= FEW) parts.push(`flights of ${times.map((one) => number(one, 4)).join(", ")} rad`);
  else if (shown[cell]) parts.push(`${plural(shown[cell], "flight")} stored`);
  return parts.join(" · ");
}

/** The flights within a window, one a row, as CSV. */
export function tableOf(lines, along, { x0, x1, y0, y1 }) {
  const rows = [];
  for (const { arrays, starts, direction, fixed } of lines) {
    arrays.values.forEach((value, i) => {
      if (value < x0 || value > x1) return;
      const { gamma, omega, xi } = { ...fixed, [along]: value };
      for (const time of arrays.flight_time.subarray(starts[i], starts[i + 1])) {
        if (time >= y0 && time <= y1) rows.push([direction, gamma, omega, xi, time, arrays.bounces[i], arrays.periods[i]]);
      }
    });
  }
  return csv(["direction", "gamma", "omega", "xi", "flight_time_rad", "bounces", "periods"], rows);
}
