// What a mode map shows: the modes of its cells, the threshold of Eq. 25, a cell in words, a table.

import { csv, decimal } from "../lib/downloads.js";
import { number, plural } from "../lib/format.js";
import { HYSTERESIS, HYSTERESIS_NAMES, LABEL_NAMES, OUTCOME, labelsOf, outcomeText, threshold } from "../lib/physics.js";
import { modeColour } from "../plot/colours.js";
import { polyline, rgba32 } from "../plot/drawing.js";
import { drawCells } from "./cells.js";

const DASH = [7, 4];
const HATCH = 9; // px between the lines over cells whose directions differ; each is two lines, of text and of surface
const HATCH_LINE = 1.6; // px, of either

/** The cells of a plane in the colours of their classes; hatched where up and down differ. */
export function drawModes(ctx, box, { arrays }, classes, { marksComputed = false } = {}) {
  const { gamma, omega, computed, hysteresis } = arrays;
  const colours = new Uint32Array(256);
  for (const { id } of classes.present) colours[id] = rgba32(modeColour(id, box.theme.dark));
  const hatch = [rgba32(box.theme.text), rgba32(box.theme.surface)];
  const mark = marksComputed ? rgba32(box.theme.cursor) : null;
  drawCells(ctx, box, gamma, omega, (row, column, x, y) => {
    const cell = row * gamma.length + column;
    if (hysteresis?.[cell]) {
      const line = lineAt(hysteresis[cell], x / box.ratio, y / box.ratio);
      if (line >= 0) return hatch[line];
    }
    return mark !== null && computed[cell] ? mark : colours[classes.ofCell[cell]];
  });
}

/** The Γ of Eq. 25 over Ω. */
export function drawThresholdCurve(ctx, box, xi) {
  const n = Math.max(2, Math.round(box.height / 2));
  const points = Array.from({ length: n }, (_, i) => {
    const y = box.top + (i * box.height) / (n - 1);
    return [box.x.pixel(threshold(box.y.value(y), xi)), y];
  });
  polyline(ctx, box.theme.surface, 4, points);
  polyline(ctx, box.theme.text, 1.8, points, DASH);
}

/** Its entry of a plot's legend. */
export const thresholdLegend = ["threshold, Eq. 25", (ctx, x, y, theme) => polyline(ctx, theme.text, 1.8, [[x, y], [x + 24, y]], DASH)];

/** A cell of a plane in words: its place, its mode, and what the mode means. */
export function describeMode({ arrays }, { column, row }) {
  const { gamma, omega, outcome, bounces, periods } = arrays;
  const cell = row * gamma.length + column;
  const parts = [`Γ = ${number(gamma[column])}`, `Ω = ${number(omega[row])}`, outcomeText(labelsOf(arrays)[cell], bounces[cell], periods[cell])];
  if (outcome[cell] === OUTCOME.periodic) parts.push(`${plural(bounces[cell], "bounce")} in ${plural(periods[cell], "plate period")}`);
  return parts;
}

/** The cells of a plane as CSV, with columns of `bounce modes`. */
export function modeTable({ arrays }) {
  const { gamma, omega, outcome, label, bounces, periods, hysteresis } = arrays;
  const row = (_, i) => [
    decimal(omega[Math.floor(i / gamma.length)]), decimal(gamma[i % gamma.length]), LABEL_NAMES[outcome[i]], bounces[i], periods[i],
    ...(label ? [LABEL_NAMES[label[i]]] : []), ...(hysteresis ? [HYSTERESIS_NAMES[hysteresis[i]]] : []),
  ];
  return csv(["omega", "gamma", "outcome", "bounces", "periods", ...(label ? ["label"] : []), ...(hysteresis ? ["hysteresis"] : [])], Array.from(outcome, row));
}

/** Which line of the hatching is at (x, y): 0 of text, 1 of surface beside it, -1 none. They rise where modes differ. */
function lineAt(hysteresis, x, y) {
  const along = hysteresis === HYSTERESIS.mode ? x + y : x - y + 1e6 * HATCH;
  const line = Math.floor((along % HATCH) / HATCH_LINE);
  return line < 2 ? line : -1;
}
