// A line's flights on a plot: dots while they are few, density when they are many.

import { disc, packed, picture } from "./drawing.js";

const FEW = 4000;
const FAINTEST = [0.42, 0.9]; // opacity of a single flight: where many fall together, where nearly all are single
const MOST = 24; // flights on one spot that are as dark as it gets

/** Where each cell's flights begin in `flight_time`: one more entry than there are cells. */
export function starts(shown) {
  const found = new Int32Array(shown.length + 1);
  for (let i = 0; i < shown.length; i++) found[i + 1] = found[i] + shown[i];
  return found;
}

/** Draw lines over each other in their colours: of two, the first wider, so that it shows where they agree. */
export function drawFlights(pen, box, lines, colourOf) {
  const few = lines.every((line) => line.arrays.flight_time) && lines.reduce((n, line) => n + visible(box, line).flights, 0) <= FEW;
  lines.forEach((line, i) => {
    const wider = i < lines.length - 1;
    const colour = colourOf(line);
    if (line.arrays.density) drawDensity(pen, box, line.arrays.density, line.window, colour);
    else if (few) drawDots(pen, box, line, colour, wider);
    else drawDensity(pen, box, counted(box, line, wider), null, colour);
  });
}

/** The cells and flights between the left and the right of the box. */
function visible(box, { arrays: { values, shown } }) {
  let [cells, flights] = [0, 0];
  for (let i = 0; i < values.length; i++) {
    if (values[i] < box.x.low || values[i] > box.x.high) continue;
    cells++;
    flights += shown[i];
  }
  return { cells, flights };
}

function drawDots(pen, box, line, colour, wider) {
  const { arrays: { values, flight_time: times }, starts } = line;
  const radius = Math.min(2.4, Math.max(1, box.width / 3 / visible(box, line).cells)) * (wider ? 1.5 : 1);
  pen.globalAlpha = wider ? 0.75 : 0.9;
  // The flights of a cycle lie on each other: one dot for all on the same half pixel.
  for (let i = 0; i < values.length; i++) {
    if (values[i] < box.x.low || values[i] > box.x.high) continue;
    const x = box.x.place(values[i]);
    const drawn = new Set();
    for (let j = starts[i]; j < starts[i + 1]; j++) {
      const y = Math.round(2 * box.y.place(times[j])) / 2;
      if (drawn.has(y)) continue;
      drawn.add(y);
      disc(pen, colour, x, y, radius);
    }
  }
  pen.globalAlpha = 1;
}

/** How many flights fall on each dot of the box, as the service counts them for lines that are longer. */
function counted(box, line, wider) {
  const [width, height] = [Math.round(box.width * box.dots), Math.round(box.height * box.dots)];
  const counts = new Uint16Array(width * height);
  const { arrays: { values, flight_time: times }, starts } = line;
  const rows = height / (box.y.high - box.y.low);
  for (let i = 0; i < values.length; i++) {
    const column = Math.min(width - 1, Math.floor(((box.x.place(values[i]) - box.left) / box.width) * width));
    if (!(column >= 0) || values[i] > box.x.high) continue;
    for (let j = starts[i]; j < starts[i + 1]; j++) {
      const row = Math.floor((times[j] - box.y.low) * rows);
      if (row >= 0 && row < height) counts[row * width + column]++;
    }
  }
  // Where cells lie further apart than dots, a dot is too small a mark.
  const size = Math.round(Math.min(2.5 * box.dots, Math.max(1, (1.6 * width) / visible(box, line).cells))) + (wider ? 1 : 0);
  return { counts: size > 1 ? thickened(counts, width, height, size) : counts, width, height };
}

/** Every count spread over a square of `size` dots; the higher one wins. */
function thickened(counts, width, height, size) {
  const found = new Uint16Array(counts.length);
  const back = (size - 1) >> 1;
  for (let row = 0; row < height; row++) {
    for (let column = 0; column < width; column++) {
      const n = counts[row * width + column];
      if (!n) continue;
      for (let r = Math.max(0, row - back); r < Math.min(height, row - back + size); r++) {
        for (let c = Math.max(0, column - back); c < Math.min(width, column - back + size); c++) {
          if (found[r * width + c] < n) found[r * width + c] = n;
        }
      }
    }
  }
  return found;
}

/** Counts, low flights first, as a picture over the window they were counted in (or the whole box). */
function drawDensity(pen, box, { counts, width, height }, window, colour) {
  const shades = shadesOf(counts, colour);
  const fill = (pixels) => {
    for (let row = 0; row < height; row++) {
      const to = (height - 1 - row) * width;
      for (let column = 0; column < width; column++) {
        const n = counts[row * width + column];
        if (n) pixels[to + column] = shades[Math.min(n, MOST)];
      }
    }
  };
  const { x0, x1, y0, y1 } = window ?? { x0: box.x.low, x1: box.x.high, y0: box.y.low, y1: box.y.high };
  picture(pen, width, height, fill, box.x.place(x0), box.y.place(y1), box.x.place(x1), box.y.place(y0));
}

/** Count → colour: the more flights, the more opaque. */
function shadesOf(counts, colour) {
  let [some, single, most] = [0, 0, 2];
  for (let i = 0; i < counts.length; i++) {
    if (counts[i]) some++;
    if (counts[i] === 1) single++;
    if (counts[i] > most) most = counts[i];
  }
  const faintest = FAINTEST[0] + (FAINTEST[1] - FAINTEST[0]) * (single / Math.max(some, 1));
  const full = Math.log(Math.min(most, MOST));
  const opacity = (n) => Math.min(1, faintest + (1 - faintest) * (Math.log(Math.max(n, 1)) / full));
  return Uint32Array.from({ length: MOST + 1 }, (_, n) => packed(colour, opacity(n)));
}

/** The different flights of one cell, rounded to what can be told apart, shortest first; null if not known. */
export function flightsOf({ arrays, starts }, cell) {
  if (!arrays.flight_time) return null;
  const times = Array.from(arrays.flight_time.subarray(starts[cell], starts[cell + 1])).sort((a, b) => a - b);
  return times.filter((time, i) => i === 0 || time - times[i - 1] > 2e-3);
}
