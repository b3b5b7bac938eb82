// The flight times of lines of cells on a plot: single dots while there are few, a density of flights otherwise.

import { bitmap, disc, rgba32 } from "./drawing.js";

const MAX_DOTS = 4000; // flights in view
const MIN_OPACITY = [0.42, 0.9]; // of a single flight: in a density of overlapping flights, and of mostly single ones
const SATURATION = 24; // flights on one pixel that are drawn fully opaque

/** The flights of a cell of a line that count: NaN stands for the others. */
export const flightsIn = ({ flight_time: times, keep }, cell) => times.subarray(cell * keep, (cell + 1) * keep).filter(Number.isFinite);

/**
 * Draw lines {values, flight_time, keep} over each other, each in `colourOf(line)`. All but the last are drawn with
 * larger dots, which remain visible where two directions agree.
 */
export function drawFlights(ctx, box, lines, colourOf) {
  const cells = lines.map((line) => cellsInView(box, line));
  const areFew = lines.reduce((sum, line, i) => sum + line.keep * cells[i].length, 0) <= 8 * MAX_DOTS
    && lines.reduce((sum, line, i) => sum + cells[i].reduce((n, cell) => n + flightsIn(line, cell).length, 0), 0) <= MAX_DOTS;
  lines.forEach((line, i) => (areFew ? drawDots : drawDensity)(ctx, box, line, cells[i], colourOf(line), i < lines.length - 1));
}

/** The cells between the left and right border of the box. */
function cellsInView(box, { values }) {
  const cells = [];
  for (let i = 0; i < values.length; i++) if (values[i] >= box.x.low && values[i] <= box.x.high) cells.push(i);
  return cells;
}

function drawDots(ctx, box, line, cells, colour, isLarge) {
  const radius = Math.min(2.4, Math.max(1, box.width / 3 / cells.length)) * (isLarge ? 1.5 : 1);
  ctx.globalAlpha = isLarge ? 0.75 : 0.9;
  for (const cell of cells) {
    // The flights of a periodic cell repeat: one dot stands for all within half a pixel.
    const heights = new Set(Array.from(flightsIn(line, cell), (time) => Math.round(2 * box.y.pixel(time)) / 2));
    for (const y of heights) disc(ctx, colour, box.x.pixel(line.values[cell]), y, radius);
  }
  ctx.globalAlpha = 1;
}

/** Flights per pixel: the more, the more opaque. */
function drawDensity(ctx, box, { values, flight_time: times, keep }, cells, colour, isLarge) {
  const [width, height] = [Math.round(box.width * box.ratio), Math.round(box.height * box.ratio)];
  const counted = new Uint16Array(width * height);
  const rowsPerRad = height / (box.y.high - box.y.low);
  for (const cell of cells) {
    const column = Math.min(width - 1, Math.floor(((box.x.pixel(values[cell]) - box.left) / box.width) * width));
    for (let j = cell * keep; j < (cell + 1) * keep; j++) {
      const row = height - 1 - Math.floor((times[j] - box.y.low) * rowsPerRad);
      if (row >= 0 && row < height) counted[row * width + column]++; // NaN is no row
    }
  }
  // Cells further apart than pixels need a mark larger than one pixel.
  const size = Math.round(Math.min(2.5 * box.ratio, Math.max(1, (1.6 * width) / cells.length))) + (isLarge ? 1 : 0);
  const counts = size > 1 ? dilated(counted, width, height, size) : counted;
  const shades = shadesOf(counts, colour);
  const fill = (pixels) => counts.forEach((n, i) => { if (n) pixels[i] = shades[Math.min(n, SATURATION)]; });
  bitmap(ctx, width, height, fill, box.left, box.top, box.left + box.width, box.top + box.height);
}

/** Each count spread over a square of `size` × `size` pixels; the highest count wins. */
function dilated(counts, width, height, size) {
  const result = new Uint16Array(counts.length);
  const before = (size - 1) >> 1;
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const n = counts[row * width + column];
      if (!n) continue;
      for (let r = Math.max(0, row - before); r < Math.min(height, row - before + size); r++) {
        for (let c = Math.max(0, column - before); c < Math.min(width, column - before + size); c++) {
          if (result[r * width + c] < n) result[r * width + c] = n;
        }
      }
    }
  }
  return result;
}

/** The colour of each count: the more flights, the more opaque. */
function shadesOf(counts, colour) {
  let [nonzero, single, highest] = [0, 0, 2];
  for (let i = 0; i < counts.length; i++) {
    if (counts[i]) nonzero++;
    if (counts[i] === 1) single++;
    if (counts[i] > highest) highest = counts[i];
  }
  const lowest = MIN_OPACITY[0] + (MIN_OPACITY[1] - MIN_OPACITY[0]) * (single / Math.max(nonzero, 1));
  const saturated = Math.log(Math.min(highest, SATURATION));
  const opacity = (n) => Math.min(1, lowest + (1 - lowest) * (Math.log(Math.max(n, 1)) / saturated));
  return Uint32Array.from({ length: SATURATION + 1 }, (_, n) => rgba32(colour, opacity(n)));
}
