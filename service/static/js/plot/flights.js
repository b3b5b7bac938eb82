// The flight times of lines of cells on a plot: single dots while there are few, a density of flights otherwise.

import { bitmap, disc, rgba32 } from "./drawing.js";

const MAX_DOTS = 4000; // flights in view
const MIN_OPACITY = [0.42, 0.9]; // of a single flight: in a density of overlapping flights, and of mostly single ones
const SATURATION = 24; // flights on one pixel that are drawn fully opaque

/**
 * Draw lines (see views/line-data.js) over each other, each in `colourOf(line)`. All but the last are drawn with
 * larger dots, which remain visible where two directions agree.
 */
export function drawFlights(ctx, box, lines, colourOf) {
  const areFew = lines.every((line) => line.arrays.flight_time) && lines.reduce((n, line) => n + inView(box, line).flights, 0) <= MAX_DOTS;
  lines.forEach((line, i) => {
    const isLarge = i < lines.length - 1;
    const colour = colourOf(line);
    if (line.arrays.density) drawDensity(ctx, box, line.arrays.density, line.window, colour);
    else if (areFew) drawDots(ctx, box, line, colour, isLarge);
    else drawDensity(ctx, box, densityOf(box, line, isLarge), null, colour);
  });
}

/** The numbers of cells and flights between the left and right border of the box. */
function inView(box, { arrays: { values, shown } }) {
  let [cells, flights] = [0, 0];
  for (let i = 0; i < values.length; i++) {
    if (values[i] < box.x.low || values[i] > box.x.high) continue;
    cells++;
    flights += shown[i];
  }
  return { cells, flights };
}

function drawDots(ctx, box, line, colour, isLarge) {
  const { arrays: { values, flight_time: times }, starts } = line;
  const radius = Math.min(2.4, Math.max(1, box.width / 3 / inView(box, line).cells)) * (isLarge ? 1.5 : 1);
  ctx.globalAlpha = isLarge ? 0.75 : 0.9;
  // The flights of a periodic cell repeat: one dot stands for all within half a pixel.
  for (let i = 0; i < values.length; i++) {
    if (values[i] < box.x.low || values[i] > box.x.high) continue;
    const x = box.x.pixel(values[i]);
    const drawn = new Set();
    for (let j = starts[i]; j < starts[i + 1]; j++) {
      const y = Math.round(2 * box.y.pixel(times[j])) / 2;
      if (drawn.has(y)) continue;
      drawn.add(y);
      disc(ctx, colour, x, y, radius);
    }
  }
  ctx.globalAlpha = 1;
}

/** Flights per pixel of the box, counted as service/results/density.py counts them for longer lines. */
function densityOf(box, line, isLarge) {
  const [width, height] = [Math.round(box.width * box.ratio), Math.round(box.height * box.ratio)];
  const counts = new Uint16Array(width * height);
  const { arrays: { values, flight_time: times }, starts } = line;
  const rowsPerRad = height / (box.y.high - box.y.low);
  for (let i = 0; i < values.length; i++) {
    const column = Math.min(width - 1, Math.floor(((box.x.pixel(values[i]) - box.left) / box.width) * width));
    if (!(column >= 0) || values[i] > box.x.high) continue;
    for (let j = starts[i]; j < starts[i + 1]; j++) {
      const row = Math.floor((times[j] - box.y.low) * rowsPerRad);
      if (row >= 0 && row < height) counts[row * width + column]++;
    }
  }
  // Cells further apart than pixels need a mark larger than one pixel.
  const size = Math.round(Math.min(2.5 * box.ratio, Math.max(1, (1.6 * width) / inView(box, line).cells))) + (isLarge ? 1 : 0);
  return { counts: size > 1 ? dilated(counts, width, height, size) : counts, width, height };
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

/** Draw counts, whose first row is the shortest flights, over the window they were counted in (null: the whole box). */
function drawDensity(ctx, box, { counts, width, height }, window, colour) {
  const shades = shadesOf(counts, colour);
  const fill = (pixels) => {
    for (let row = 0; row < height; row++) {
      const target = (height - 1 - row) * width;
      for (let column = 0; column < width; column++) {
        const n = counts[row * width + column];
        if (n) pixels[target + column] = shades[Math.min(n, SATURATION)];
      }
    }
  };
  const { x0, x1, y0, y1 } = window ?? { x0: box.x.low, x1: box.x.high, y0: box.y.low, y1: box.y.high };
  bitmap(ctx, width, height, fill, box.x.pixel(x0), box.y.pixel(y1), box.x.pixel(x1), box.y.pixel(y0));
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
