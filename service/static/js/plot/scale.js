// From values to pixels, and where an axis has its ticks.

/** A linear or logarithmic scale from [low, high] to [from, to] pixels. */
export function scale(low, high, from, to, log = false) {
  const warp = log ? Math.log : (value) => value;
  const unwarp = log ? Math.exp : (value) => value;
  const [a, b] = [warp(low), warp(high)];
  const place = (value) => from + ((warp(value) - a) / (b - a)) * (to - from);
  const value = (pixel) => unwarp(a + ((pixel - from) / (to - from)) * (b - a));
  return { place, value, low, high, from, to, log };
}

/** Round values within [low, high], about `n` of them, and the digits after the point that they need. */
export function ticks(low, high, n, log = false) {
  if (log && high / low > 30) return decades(low, high);
  const rough = (high - low) / Math.max(n, 1);
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((factor) => factor * power >= rough * 0.999);
  const found = [];
  for (let i = Math.ceil(low / step - 1e-9); i * step <= high * (1 + 1e-12) + step * 1e-9; i++) found.push(i * step);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  return found.map((value) => ({ value, text: text(value, digits) }));
}

function decades(low, high) {
  const found = [];
  for (let e = Math.ceil(Math.log10(low) - 1e-9); 10 ** e <= high * (1 + 1e-9); e++) {
    found.push({ value: 10 ** e, text: Math.abs(e) <= 3 ? String(Number((10 ** e).toPrecision(3))) : `10^${e}` });
  }
  return found;
}

const text = (value, digits) => value.toFixed(Math.min(digits, 12)).replace(/^-(?=0\.?0*$)/, "").replace("-", "−");

/** [low, high], a little wider where the two are the same. */
export function spread(low, high) {
  if (high > low) return [low, high];
  const room = Math.abs(low) * 0.05 || 0.5;
  return [low - room, high + room];
}

/** The borders between n increasing values: n + 1 of them, half-way in between. */
export function edges(values) {
  const n = values.length;
  if (n === 1) return spread(values[0], values[0]);
  const found = new Float64Array(n + 1);
  for (let i = 1; i < n; i++) found[i] = (values[i - 1] + values[i]) / 2;
  found[0] = values[0] - (found[1] - values[0]);
  found[n] = values[n - 1] + (values[n - 1] - found[n - 1]);
  return found;
}
