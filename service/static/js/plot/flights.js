// The flight times of lines of cells on a plot: single dots while there are few, a density of flights otherwise.

import { exact } from "../lib/format.js";
import { digitsTo } from "../lib/physics.js";
import { bitmap, circle, disc, rgba32, verticalLine } from "./drawing.js";

const MAX_DOTS = 4000; // flights in view
const FAINTEST = 0.5; // opacity of a single flight, as in the service's pictures
const SAME_FLIGHT = 2e-3; // rad: shorter differences between flights of a cell are not listed
const MAX_LISTED = 6; // flights listed one by one
const SATURATION = 24; // flights on one pixel that are drawn fully opaque

/** The flights of a cell of a line; NaN stands for those that do not count. */
export const flightsIn = ({ flight_time: times, keep }, cell) => times.subarray(cell * keep, (cell + 1) * keep).filter(Number.isFinite);

/** The distinct times among those of a cell's flights, shortest first. */
export const distinctFlights = (times) => Array.from(Float64Array.from(times).sort()).filter((time, i, all) => i === 0 || time - all[i - 1] > SAME_FLIGHT);

/** The flights of a cell in a table: distinct ones, the first few where it is not `whole`, as sharply as `bound` says. */
export function flightsText(times, whole, bound) {
  const distinct = distinctFlights(times);
  const listed = distinct.slice(0, whole ? Infinity : MAX_LISTED).map((time) => exact(time, whole, digitsTo(time, bound))).join(" ");
  return listed + (!whole && distinct.length > MAX_LISTED ? " …" : "");
}

/** Draw lines {values, flight_time, keep} over each other; all but the last have larger dots, visible where two agree. */
export function drawFlights(ctx, box, lines, colourOf) {
  const cells = lines.map(({ values }) => Array.from(values.keys()).filter((cell) => values[cell] >= box.x.low && values[cell] <= box.x.high)); // in view
  let dots = 0;
  const areFew = lines.every((line, i) => cells[i].every((cell) => (dots += flightsIn(line, cell).length) <= MAX_DOTS));
  lines.forEach((line, i) => (areFew ? drawDots : drawDensity)(ctx, box, line, cells[i], colourOf(line), i < lines.length - 1));
}

function drawDots(ctx, box, line, cells, colour, isLarge) {
  const radius = Math.min(2.4, Math.max(1, box.width / 3 / cells.length)) * (isLarge ? 1.5 : 1);
  ctx.globalAlpha = isLarge ? 0.75 : 0.9;
  for (const cell of cells) drawCell(ctx, box, line.values[cell], flightsIn(line, cell), colour, radius);
  ctx.globalAlpha = 1;
}

/** The flights of a cell. Those of a periodic one repeat: one dot stands for all within half a pixel. */
export function drawCell(ctx, box, value, times, colour, radius) {
  const heights = new Set(Array.from(times, (time) => Math.round(2 * box.y.pixel(time)) / 2));
  for (const y of heights) disc(ctx, colour, box.x.pixel(value), y, radius);
}

export function markCell(ctx, box, value, times) {
  const x = box.x.pixel(value);
  verticalLine(ctx, box, x, box.theme.cursor);
  for (const time of times) circle(ctx, box.theme.cursor, 1.5, x, box.y.pixel(time), 4.5);
}

/** Flights per pixel, each on a square of pixels where cells are further apart: the more, the more opaque. */
function drawDensity(ctx, box, { values, flight_time: times, keep }, cells, colour, isLarge) {
  const [width, height] = [Math.round(box.width * box.ratio), Math.round(box.height * box.ratio)];
  const size = Math.round(Math.min(2.5 * box.ratio, Math.max(1, (1.6 * width) / cells.length))) + (isLarge ? 1 : 0);
  const { low, high, log } = box.y;
  const [bottom, top] = log ? [Math.log(low), Math.log(high)] : [low, high];
  const rows = height / (top - bottom);
  const first = (middle, length) => Math.max(0, Math.min(length - size, Math.floor(middle - (size - 1) / 2)));
  const counts = new Uint16Array(width * height);
  for (const cell of cells) {
    const column = first(((box.x.pixel(values[cell]) - box.left) / box.width) * width, width);
    for (let j = cell * keep; j < (cell + 1) * keep; j++) {
      if (!(times[j] >= low && times[j] <= high)) continue; // NaN is none
      const row = first(height - ((log ? Math.log(times[j]) : times[j]) - bottom) * rows, height);
      for (let r = row; r < row + size; r++) {
        for (let c = column; c < column + size; c++) counts[r * width + c]++;
      }
    }
  }
  const opacity = (n) => FAINTEST + ((1 - FAINTEST) * Math.log(Math.max(n, 1))) / Math.log(SATURATION);
  const shades = Uint32Array.from({ length: SATURATION + 1 }, (_, n) => rgba32(colour, opacity(n)));
  const fill = (pixels) => {
    for (let i = 0; i < counts.length; i++) if (counts[i]) pixels[i] = shades[Math.min(counts[i], SATURATION)];
  };
  bitmap(ctx, width, height, fill, box.left, box.top, box.left + box.width, box.top + box.height);
}
