// Scales from values to pixels, axis ticks, and cell borders.

import { number } from "../lib/format.js";

/** A linear or logarithmic scale of the values [low, high] over the pixels [from, to]. */
export function scale(low, high, from, to, log = false) {
  const forward = log ? Math.log : (value) => value;
  const inverse = log ? Math.exp : (value) => value;
  const [a, b] = [forward(low), forward(high)];
  const pixel = (value) => from + ((forward(value) - a) / (b - a)) * (to - from);
  const value = (pixel) => inverse(a + ((pixel - from) / (to - from)) * (b - a));
  return { pixel, value, low, high, log };
}

/** About `n` round values within [low, high], with their text; at least two, and three where these are at most 1.5n. */
export function ticks(low, high, n, log = false, tries = 3, most = 1.5 * n) {
  if (log && high / low > 30) return decades(low, high);
  const rough = (high - low) / Math.max(n, 1);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough * 0.999);
  const values = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high * (1 + 1e-15) + step * 1e-9; i++) values.push(i * step);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  if (values.length < 3 && tries) {
    const finer = ticks(low, high, 2 * Math.max(n, 1), false, tries - 1, most);
    if (values.length < 2 || finer.length <= most) return finer;
  }
  return values.map((value) => ({ value, text: value.toFixed(Math.min(digits, 20)).replace(/^-(?=0\.?0*$)/, "").replace("-", "−") }));
}

/** Powers of ten; where there are less than three, twice and five times them too. */
function decades(low, high) {
  const [first, last] = [low * (1 - 1e-9), high * (1 + 1e-9)].map((end) => Math.floor(Math.log10(end)));
  const powers = Array.from({ length: last - first + 1 }, (_, i) => first + i);
  const multiples = (...factors) => powers.flatMap((power) => factors.map((factor) => Number(`${factor}e${power}`))).filter((value) => value >= low * (1 - 1e-9) && value <= high * (1 + 1e-9));
  return (multiples(1).length < 3 ? multiples(1, 2, 5) : multiples(1)).map((value) => ({ value, text: number(value) }));
}

/** [low, high], widened where they are equal: a scale needs some extent. */
export function extent(low, high) {
  if (high > low) return [low, high];
  const margin = Math.abs(low) * 0.05 || 0.5;
  return [low - margin, high + margin];
}

/** The borders between n increasing values, half-way between neighbours: n + 1 of them. */
export function cellBorders(values) {
  const n = values.length;
  if (n === 1) return extent(values[0], values[0]);
  const borders = new Float64Array(n + 1);
  for (let i = 1; i < n; i++) borders[i] = (values[i - 1] + values[i]) / 2;
  borders[0] = values[0] - (borders[1] - values[0]);
  borders[n] = values[n - 1] + (values[n - 1] - borders[n - 1]);
  return borders;
}

/** [low, high] of cells at increasing `values`, whole ones; with `positive` above 0 if they are, for logarithmic axes. */
export function cellExtent(values, positive = true) {
  const borders = cellBorders(values);
  return [positive && values[0] > 0 && borders[0] <= 0 ? values[0] : borders[0], borders.at(-1)];
}
