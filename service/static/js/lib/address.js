// The view's state in the address: #/job/ID/diagram?omega=0.5. A copied link shows the same view.

import { query as encode } from "./api.js";
import { debounced } from "./dom.js";
import { AXES, clamp } from "./physics.js";

/** The parameters of a zoom window. */
export const WINDOW = ["x0", "x1", "y0", "y1"];
const NARROWEST = 1e-12; // of the values: numbers end at 1e-16

/** The current address: {path: ["job", ID, "diagram"], query: {omega: "0.5"}}. */
export function currentAddress() {
  const [path, query = ""] = location.hash.replace(/^#\/?/, "").split("?");
  return { path: path.split("/").filter(Boolean), query: Object.fromEntries(new URLSearchParams(query)) };
}

export function link(path, query = {}) {
  const text = encode(query).replaceAll("%2C", ",");
  return `#/${path.join("/")}${text ? `?${text}` : ""}`;
}

export const navigate = (path, query = {}) => { location.hash = link(path, query); };

// Browsers limit how often the address may change; a slider changes it hundreds of times.
const write = debounced(120, () => flush());
let pending = null; // `from`: the address that it replaces, unless a link or Back has changed it meanwhile
const isPending = () => pending?.from === location.hash;

function flush(isStep = false) {
  if (!isPending()) return;
  history[isStep ? "pushState" : "replaceState"](null, "", link(pending.path, pending.query));
  pending.from = location.hash;
}

/** Dispatches "change" after every setQuery(), with the names of what it changed. */
export const queryChanges = new EventTarget();

/** Change query parameters; null removes one. With `isStep`, the browser's Back returns to the state before. */
export function setQuery(changes, isStep = false) {
  if (isStep) flush();
  if (!isPending()) pending = { ...currentAddress(), from: location.hash };
  const entries = Object.entries({ ...pending.query, ...changes }).filter(([, value]) => (value ?? null) !== null);
  pending.query = Object.fromEntries(entries.map(([name, value]) => [name, String(value)])); // as read from the address
  if (isStep) flush(true); // at once: written later it would replace the state to which Back has returned
  else write();
  queryChanges.dispatchEvent(new CustomEvent("change", { detail: Object.keys(changes) }));
}

/** The query parameters, including changes not written yet. */
export const currentQuery = () => (isPending() ? pending : currentAddress()).query;

/** Drop changes not written yet: they belong to a view that was left. */
export const discardPending = () => { pending = null; };

/** The zoom window {x0, x1, y0, y1} in a query; null without a valid one. */
export function windowIn(query) {
  const [x0, x1, y0, y1] = WINDOW.map((name) => Number(query[name] ?? NaN));
  const isWide = (low, high) => high - low > NARROWEST * Math.max(Math.abs(low), Math.abs(high)) && Number.isFinite(high - low);
  return isWide(x0, x1) && isWide(y0, y1) ? { x0, x1, y0, y1 } : null;
}

/** A zoom window as query parameters, to a millionth of its sides; null removes it. */
export function windowQuery(window) {
  const digits = (end, side) => clamp(Math.ceil(6 + (Math.log10(Math.abs(end) / side) || 0)), 6, 17); // 0: no window
  return Object.fromEntries(WINDOW.map((name) => [name, window && rounded(window[name], digits(window[name], window[`${name[0]}1`] - window[`${name[0]}0`]))]));
}

const rounded = (value, digits) => Number(value.toPrecision(digits));

/** A selected cell as query parameters, with its axis values for the sliders. */
export function cellQuery({ direction, ...cell }) {
  const [gamma, omega, xi] = AXES.map((axis) => addressValue(cell[axis]));
  return { gamma, omega, xi, cell: [gamma, omega, xi, direction].join() };
}

/** The selected cell, or start, in a query; null without a valid one. */
export function cellIn({ cell = "" }) {
  const [gamma, omega, xi, direction] = cell.split(",").map((text, i) => (i < 3 ? Number(text) : text));
  return direction !== undefined && [gamma, omega, xi].every(Number.isFinite) ? { gamma, omega, xi, direction } : null;
}

/** An axis value as addresses hold it: fifteen significant digits. */
export const addressValue = (value) => rounded(value, 15);
