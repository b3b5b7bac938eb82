// The zoomed window in the address: x0, x1, y0, y1.

import { note } from "./address.js";

const NAMES = ["x0", "x1", "y0", "y1"];

/** The window that an address asks for; null for all. */
export function askWindow(asked) {
  const values = NAMES.map((name) => (asked[name] === undefined ? NaN : Number(asked[name])));
  if (!values.every(Number.isFinite) || values[0] >= values[1] || values[2] >= values[3]) return null;
  return Object.fromEntries(NAMES.map((name, i) => [name, values[i]]));
}

export function noteWindow(window) {
  note(Object.fromEntries(NAMES.map((name) => [name, window ? Number(window[name].toPrecision(6)) : null])));
}
