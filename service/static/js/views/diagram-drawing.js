// What the explorer draws between its axes besides the flights.

import { flightsOf } from "../plot/flights.js";
import { number, ordinal } from "../lib/format.js";
import { area, circle, disc, upright } from "../plot/drawing.js";
import { OUTCOME, SYMBOL, threshold } from "../lib/physics.js";

const MOST_RINGS = 200;

/** What stands over the frame: the values held still, and the ramps' colours where there are two. */
export function head(lines, colourOf) {
  const title = Object.entries(lines[0].fixed).map(([axis, value]) => `${SYMBOL[axis]} = ${number(value)}`).join(",   ");
  const dot = (direction, i) => (pen, x, y, theme) => disc(pen, colourOf(direction, theme), x + 16, y, i ? 2.8 : 4.5);
  const every = Math.max(...lines.map((line) => line.every ?? 1)); // where they are too many, every so many-th
  const part = every > 1 ? `,   every ${ordinal(every)} ${SYMBOL[lines[0].along]}` : "";
  return { title: title + part, key: lines.length > 1 ? lines.map(({ direction }, i) => [`ramp ${direction}`, dot(direction, i)]) : [] };
}

/** Why there is nothing to see, if there is nothing. */
export function emptiness(lines) {
  if (!lines.length) return "Neither ramp is chosen";
  if (lines.some(({ points }) => points)) return null;
  const every = (kind) => lines.every(({ arrays }) => arrays.outcome.every((one) => one === kind));
  if (every(OUTCOME.missing)) return "Not computed yet";
  return every(OUTCOME.atRest) ? "The spring stays on the plate" : "No flight to show";
}

/** Γ_th of Eq. 25, where a spring at rest begins to bounce. */
export function drawOnset(pen, box, { omega, xi }) {
  const x = box.x.place(threshold(omega, xi));
  if (!(x >= box.left && x <= box.left + box.width)) return;
  upright(pen, box, x, box.theme.onset, 1.2, [5, 4]);
  const room = x + 32 < box.left + box.width;
  pen.fillStyle = box.theme.onset;
  pen.textAlign = "left";
  pen.textBaseline = "alphabetic";
  pen.font = `italic 15px ${box.theme.serif}`;
  pen.fillText("Γ", room ? x + 5 : x - 26, box.top + 22);
  pen.font = `11px ${box.theme.serif}`;
  pen.fillText("th", room ? x + 16 : x - 15, box.top + 26);
}

/** A wedge at the foot of the frame, under the cell that is shown in motion. */
export function drawChosen(pen, box, value, colour) {
  const [x, foot] = [box.x.place(value), box.top + box.height];
  area(pen, colour, [[x, foot - 13], [x - 6, foot - 1], [x + 6, foot - 1]]);
}

/** A line through the cell under the cursor, and a ring about each of its flights. */
export function drawCell(pen, box, { line, cell }) {
  const x = box.x.place(line.arrays.values[cell]);
  upright(pen, box, x, box.theme.cursor);
  for (const time of flightsOf(line, cell)?.slice(0, MOST_RINGS) ?? []) {
    circle(pen, box.theme.cursor, 1.5, x, box.y.place(time), 4.5);
  }
}
