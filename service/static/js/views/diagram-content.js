// What a bifurcation diagram shows besides its flights: title and legend, marked cells, their description, CSV.

import { csv } from "../lib/downloads.js";
import { number, ordinal, plural } from "../lib/format.js";
import { OUTCOME, SYMBOL, labelsOf, outcomeText, threshold } from "../lib/physics.js";
import { circle, disc, polygon, verticalLine } from "../plot/drawing.js";
import { flightsOf } from "./line-data.js";

const MAX_CIRCLES = 200;
const MAX_LISTED = 6; // flights listed one by one

/** Title (the fixed values) and legend (the directions, where there are two) of a Plot. */
export function headings(lines, colourOf) {
  const title = Object.entries(lines[0].fixed).map(([axis, value]) => `${SYMBOL[axis]} = ${number(value)}`).join(",   ");
  const dot = (direction, i) => (ctx, x, y, theme) => disc(ctx, colourOf(direction, theme), x + 16, y, i ? 2.8 : 4.5);
  const every = Math.max(...lines.map((line) => line.every ?? 1)); // above 1 where the line has more cells than are sent
  const computed = lines[0].arrays.computed;
  const cells = computed ? `,   ${computed.reduce((sum, value) => sum + value, 0)} of ${computed.length} cells computed` : "";
  const thinned = every > 1 ? `,   every ${ordinal(every)} ${SYMBOL[lines[0].along]}` : "";
  return { title: title + thinned + cells, legend: lines.length > 1 ? lines.map(({ direction }, i) => [`ramp ${direction}`, dot(direction, i)]) : [] };
}

/** Why a diagram is empty; null if it is not. */
export function emptyMessage(lines) {
  if (!lines.length) return "No ramp direction is selected";
  if (lines.some(({ points }) => points)) return null;
  const allAre = (outcome) => lines.every(({ arrays }) => arrays.outcome.every((value) => value === outcome));
  if (allAre(OUTCOME.missing)) return "Not computed yet";
  return allAre(OUTCOME.atRest) ? "The spring stays on the plate" : "No flights to show";
}

/** The threshold of Eq. 25, labelled Γ_th, where it lies in the box. */
export function drawThreshold(ctx, box, { omega, xi }) {
  const x = box.x.pixel(threshold(omega, xi));
  if (!(x >= box.left && x <= box.left + box.width)) return;
  verticalLine(ctx, box, x, box.theme.threshold, 1.2, [5, 4]);
  const fitsRight = x + 32 < box.left + box.width;
  ctx.fillStyle = box.theme.threshold;
  ctx.textAlign = "left";
  ctx.textBaseline = "alphabetic";
  ctx.font = `italic 15px ${box.theme.serif}`;
  ctx.fillText("Γ", fitsRight ? x + 5 : x - 26, box.top + 22);
  ctx.font = `11px ${box.theme.serif}`;
  ctx.fillText("th", fitsRight ? x + 16 : x - 15, box.top + 26);
}

/** A triangle on the axis at the cell whose trajectory is shown. */
export function drawSelected(ctx, box, value, colour) {
  const [x, bottom] = [box.x.pixel(value), box.top + box.height];
  polygon(ctx, colour, [[x, bottom - 13], [x - 6, bottom - 1], [x + 6, bottom - 1]]);
}

/** A line through the cell under the pointer and a circle around each of its flights. */
export function drawCurrent(ctx, box, { line, cell }) {
  const x = box.x.pixel(line.arrays.values[cell]);
  verticalLine(ctx, box, x, box.theme.cursor);
  for (const time of flightsOf(line, cell)?.slice(0, MAX_CIRCLES) ?? []) {
    circle(ctx, box.theme.cursor, 1.5, x, box.y.pixel(time), 4.5);
  }
}

/** A cell in words; `withDirection` where the diagram shows two directions. */
export function describeCell({ line, cell }, along, withDirection) {
  const { values, outcome, bounces, periods, shown } = line.arrays;
  const parts = [`${SYMBOL[along]} = ${number(values[cell])}`];
  if (withDirection) parts.push(`ramp ${line.direction}`);
  parts.push(outcomeText(labelsOf(line.arrays)[cell], bounces[cell], periods[cell]));
  if (outcome[cell] === OUTCOME.periodic) parts.push(`${plural(bounces[cell], "bounce")} in ${plural(periods[cell], "plate period")}`);
  if (line.arrays.computed && !line.arrays.computed[cell] && outcome[cell] !== OUTCOME.missing) parts.push("taken from its block, without flights");
  const times = flightsOf(line, cell);
  if (times?.length && times.length <= MAX_LISTED) parts.push(`flight times ${times.map((time) => number(time, 4)).join(", ")} rad`);
  else if (shown[cell]) parts.push(`${plural(shown[cell], "flight")} stored`);
  return parts.join(" · ");
}

/** The flights within a window as CSV, one per row. */
export function flightTable(lines, along, { x0, x1, y0, y1 }) {
  const rows = [];
  for (const { arrays, starts, direction, fixed } of lines) {
    arrays.values.forEach((value, i) => {
      if (value < x0 || value > x1) return;
      const { gamma, omega, xi } = { ...fixed, [along]: value };
      for (const time of arrays.flight_time.subarray(starts[i], starts[i + 1])) {
        if (time >= y0 && time <= y1) rows.push([direction, gamma, omega, xi, time, labelsOf(arrays)[i], arrays.bounces[i], arrays.periods[i]]);
      }
    });
  }
  return csv(["direction", "gamma", "omega", "xi", "flight_time", lines[0]?.arrays.label ? "label" : "outcome", "bounces", "periods"], rows);
}
