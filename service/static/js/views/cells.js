// Cells on a rectangular plane: drawing them, pointing at one, stepping from one to the next, their legend.

import { h } from "../lib/dom.js";
import { clampIndex, nearestIndex } from "../lib/physics.js";
import { bitmap, circle, polyline } from "../plot/drawing.js";
import { cellBorders } from "../plot/scale.js";

/** The window of all cells around `columns` and `rows`; with `positive` none of it is below 0, for logarithmic axes. */
export function windowOf(columns, rows, positive = false) {
  const [x, y] = [cellBorders(columns), cellBorders(rows)];
  const first = (borders, values) => (positive && borders[0] <= 0 ? values[0] : borders[0]);
  return { x0: first(x, columns), x1: x.at(-1), y0: first(y, rows), y1: y.at(-1) };
}

/** Each pixel has the colour of the nearest cell: `colourOf(row, column, x, y)` as 32 bits; x and y count pixels. */
export function drawCells(ctx, box, columns, rows, colourOf) {
  const [width, height] = [Math.round(box.width * box.ratio), Math.round(box.height * box.ratio)];
  const nearest = Int32Array.from({ length: width }, (_, i) => nearestIndex(columns, box.x.value(box.left + ((i + 0.5) * box.width) / width)));
  const fill = (pixels) => {
    for (let y = 0; y < height; y++) {
      const row = nearestIndex(rows, box.y.value(box.top + ((y + 0.5) * box.height) / height));
      for (let i = 0; i < width; i++) pixels[y * width + i] = colourOf(row, nearest[i], i, y);
    }
  };
  bitmap(ctx, width, height, fill, box.left, box.top, box.left + box.width, box.top + box.height);
}

/** The cell {column, row} nearest to (x, y). */
export const nearestCell = (columns, rows, x, y) => ({ column: nearestIndex(columns, x), row: nearestIndex(rows, y) });

/** The cell so many columns and rows further; from the middle without a current one. */
export function nextCell(columns, rows, current, right, up) {
  const { column, row } = current ?? { column: columns.length >> 1, row: rows.length >> 1 };
  return { column: clampIndex(column + right, columns.length), row: clampIndex(row + up, rows.length) };
}

/** A ring with an outline, visible on every colour. */
export function drawRing(ctx, { x, y, theme }, column, row, radius) {
  circle(ctx, theme.surface, 4.5, x.pixel(column), y.pixel(row), radius);
  circle(ctx, theme.cursor, 2, x.pixel(column), y.pixel(row), radius);
}

/** Hatched cells in a plot's legend. */
export function hatchSymbol(ctx, x, y, theme) {
  for (const left of [x, x + 8, x + 16]) polyline(ctx, theme.text, 1.6, [[left, y + 6], [left + 8, y - 6]]);
}

/** An entry of a legend: a colour and what it stands for. */
export function legendEntry(colour, ...texts) {
  const swatch = h("span", { className: "swatch", "aria-hidden": "true" });
  swatch.style.background = colour;
  return h("li", {}, swatch, ...texts);
}
