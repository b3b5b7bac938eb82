// What the explorer draws between its axes besides the flights.

import { flightsOf } from "./flights.js";
import { SYMBOL, threshold } from "./physics.js";
import { number } from "./format.js";
import { stroke } from "./plot.js";
import { colourOf } from "./theme.js";

const MOST_RINGS = 200;

/** What the axes say: the values held still, and the ramps' colours where there are two. */
export function head(lines) {
  const title = Object.entries(lines[0].fixed).map(([axis, value]) => `${SYMBOL[axis]} = ${number(value)}`).join(",   ");
  const dot = (direction) => (pen, x, y, theme) => {
    pen.fillStyle = colourOf(direction, theme);
    pen.fillRect(x + 12, y - 4, 9, 9);
  };
  return { title, key: lines.length > 1 ? lines.map(({ direction }) => [direction, dot(direction)]) : [] };
}

/** Γ_th of Eq. 25, where a spring at rest begins to bounce. */
export function drawOnset(pen, box, { omega, xi }) {
  const x = box.x.place(threshold(omega, xi));
  if (!(x >= box.left && x <= box.left + box.width)) return;
  stroke(pen, box.theme.onset, 1.2, [[x, box.top], [x, box.top + box.height]], [5, 4]);
  pen.fillStyle = box.theme.onset;
  pen.textAlign = "left";
  pen.textBaseline = "alphabetic";
  pen.font = `italic 15px ${box.theme.serif}`;
  pen.fillText("Γ", x + 5, box.top + 20);
  pen.font = `10px ${box.theme.serif}`;
  pen.fillText("th", x + 16, box.top + 24);
}

/** A wedge at the foot of the frame, under the cell that is shown in motion. */
export function drawChosen(pen, box, value, colour) {
  const [x, foot] = [box.x.place(value), box.top + box.height];
  pen.fillStyle = colour;
  pen.beginPath();
  [[x, foot - 13], [x - 6, foot - 1], [x + 6, foot - 1]].forEach(([px, py], i) => (i ? pen.lineTo(px, py) : pen.moveTo(px, py)));
  pen.closePath();
  pen.fill();
}

/** A line through the cell under the cursor, and a ring about each of its flights. */
export function drawCell(pen, box, { line, cell }) {
  const x = box.x.place(line.arrays.values[cell]);
  stroke(pen, box.theme.cursor, 1, [[x, box.top], [x, box.top + box.height]]);
  pen.lineWidth = 1.5;
  for (const time of flightsOf(line, cell)?.slice(0, MOST_RINGS) ?? []) {
    pen.beginPath();
    pen.arc(x, box.y.place(time), 4.5, 0, 2 * Math.PI);
    pen.stroke();
  }
}
