// Axes of a sweep, outcomes of its cells, starts and cycles, Eq. 25: what the page knows of the model.

import { bound, exact, number } from "./format.js";

export const AXES = ["gamma", "omega", "xi"];
export const SYMBOL = { gamma: "Γ", omega: "Ω", xi: "ξ" };
export const MEANING = { gamma: "plate acceleration, Aω²/g", omega: "plate frequency, ω/ω₀", xi: "damping, β/(2mω₀)" };
/** Axes of a plot, as in the files of the service. */
export const AXIS_LABEL = { gamma: "plate acceleration over gravity Γ", omega: "plate frequency over that of the spring Ω", xi: "damping ratio ξ" };

export const TWO_PI = 2 * Math.PI; // phase of one plate period, rad

/** Codes of kernel.params.Outcome. */
export const OUTCOME = { missing: 0, periodic: 1, aperiodic: 2, atRest: 3, unresolved: 4, diverged: 5, settling: 6 };
/** Codes of service.views.modes.Hysteresis: how the two directions of a cell compare. */
export const HYSTERESIS = { none: 0, mode: 1, flights: 2 };

/** Threshold of lift-off from rest, Eq. 25: the Γ above which a spring resting on the plate begins to bounce. */
export function threshold(omega, xi) {
  const [w, x] = [omega ** 2, xi ** 2];
  return 2 * Math.sqrt(((1 - w) ** 2 + 4 * x * w) / ((2 - w) ** 2 + 16 * x * w));
}

/** The values of an axis of a specification: a number, a list, or {start, stop, num, spacing}. */
export function axisValues(axis) {
  if (typeof axis === "number") return [axis];
  if (Array.isArray(axis)) return axis;
  const { start, stop, num, spacing } = axis;
  const log = spacing === "log";
  const [from, to] = log ? [Math.log(start), Math.log(stop)] : [start, stop];
  return Array.from({ length: num }, (_, i) => {
    if (i === 0) return start;
    if (i === num - 1) return stop;
    const value = from + ((to - from) * i) / (num - 1);
    return log ? Math.exp(value) : value;
  });
}

const digitsOf = new WeakMap(); // by the list of an axis

/** A value of an axis in as many digits as tell neighbours among its `values` apart: five where they do. */
export function axisText(value, values) {
  const power = (x) => Math.floor(Math.log10(Math.abs(x)));
  const needed = (most, next, i) => Math.max(most, 1 + power(next) - power(next - values[i - 1]) || 0);
  if (!digitsOf.has(values)) digitsOf.set(values, Math.min(values.reduce(needed, 5), 12));
  return number(value, digitsOf.get(values));
}

/** A column of a table with values of an axis; in files they are not rounded. */
export const axisColumn = (title, values, valueOf) => [title, (item, whole) => (whole ? String(valueOf(item)) : axisText(valueOf(item), values))];

/** Digits down to the bound of an error, from 2 to 8; four without one. */
export const digitsTo = (value, bound) => clamp(1 + Math.floor(Math.log10(value)) - Math.floor(Math.log10(bound)), 2, 8) || 4;

/** The index of the value nearest to `target`; `values` increase. */
export function nearestIndex(values, target) {
  let [low, high] = [0, values.length - 1];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (values[middle] <= target) low = middle;
    else high = middle;
  }
  return target - values[low] <= values[high] - target ? low : high;
}

/** The axis value nearest to `text`, a query parameter; the middle value where it is missing or no number. */
export function initialValue(values, text) {
  const target = text === undefined ? NaN : Number(text);
  return values[Number.isFinite(target) ? nearestIndex(values, target) : values.length >> 1];
}

/** Whether two values are equal up to the rounding of their decimal form. */
export const isClose = (a, b) => Math.abs(a - b) <= 1e-8 * Math.max(Math.abs(a), Math.abs(b));
export const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
export const clampIndex = (index, length) => clamp(index, 0, length - 1);
/** Whether a specification is of a sweep; other studies have no diagrams. */
export const isSweep = ({ protocol }) => protocol.kind === "rest" || protocol.kind === "ramp";

/** The directions of a sweep, as the service names them. */
export function directionsOf({ protocol }) {
  if (protocol.kind === "rest") return ["rest"];
  return protocol.direction === "both" ? ["up", "down"] : [protocol.direction];
}

/** Names of outcomes and labels by their code, as in `kernel.labels`. */
export const LABEL_NAMES = ["missing", "periodic", "aperiodic", "at_rest", "unresolved", "diverged", "settling", "quasi-periodic", "chaotic", "unstable"];
const LABEL_TEXTS = ["not computed yet", "", "aperiodic", "at rest on the plate", "unresolved", "diverged", "still settling", "quasi-periodic", "chaotic", "unstable cycle"];
export const outcomeText = (code, bounces, periods) => (code === OUTCOME.periodic ? `mode (${bounces}, ${periods})` : LABEL_TEXTS[code]);
export const modeText = ({ outcome, label = outcome, bounces, periods }, cell) => outcomeText(label[cell], bounces[cell], periods[cell]);
/** A sentence or a mode of the service, "fold (1,2) at Gamma = 0.9", in the page's spelling. */
export const inSymbols = (text) => text.replace(/(?<=\(\d+),(?=\d)/g, ", ").replace(/\b(gamma|omega|xi)\b/gi, (axis) => SYMBOL[axis.toLowerCase()]);
/** "0.496 ± 0.05": the largest Lyapunov exponent, with its standard error where it has one. */
export const exponentText = (exponent, error) => `${number(exponent, 3)}${Number.isFinite(error) ? ` ± ${number(error, 2)}` : ""}`;
/** The largest Lyapunov exponent of a cell of a result: the first of as many as each cell has. */
export const exponentOf = ({ lyapunov, lyapunov_error: errors }, cell) => lyapunov[(cell * lyapunov.length) / errors.length];

/** What a table says of cells, as columns: of the `variables` that any of them has. `locate(cell)`: the variables that hold a cell, and its index in them. */
export function cellColumns(variables, locate) {
  const column = (title, name, text, isCommon) => variables[name] && [title, (cell, whole) => {
    const [cells, i] = locate(cell);
    return cells[name] ? text(cells, i, whole) : ""; // of compared sweeps only some may have it
  }, isCommon];
  return [
    ["mode", (cell) => modeText(...locate(cell))],
    column("λ₁", "lyapunov", (cells, i, whole) => (whole ? exact(exponentOf(cells, i), whole) : exponentText(exponentOf(cells, i), cells.lyapunov_error[i]))),
    column("error of λ₁", "lyapunov_error", (cells, i, whole) => whole && exact(cells.lyapunov_error[i], whole), true),
    column("|μ|", "multiplier", ({ multiplier }, i, whole) => exact(multiplier[i], whole, Math.max(3, digitsTo(multiplier[i], 1 - multiplier[i])))), // never 1
    column("flight error ≤ (rad)", "flight_error", (cells, i, whole) => (whole ? exact : bound)(cells.flight_error[i], whole || 1)),
    column("cell", "computed", (cells, i) => (cells.outcome[i] === OUTCOME.missing ? "" : ["taken from its block", "computed"][Number(cells.computed[i])])),
  ].filter(Boolean);
}

/** Whether cells end as certified. */
export const certifies = ({ settle, exponents, model }) => settle === "auto" && !exponents && model.kind !== "stepped";
const START_FIELDS = { __proto__: null, cycle: ["periods", "flight_time"], drop: ["height", "phase"], contact: ["elongation", "velocity"], attractor: ["number"] };
/** How addresses name a start in place of a direction: on a cycle ("cycle", its periods, its flight time, a state if it is known), with a drop, in contact, on an attractor. */
export const startName = (kind, ...values) => [kind, ...values.map((value) => Number(value.toPrecision(12)))].join(":");

/** The start of such a name, as trajectories take it; null for a direction. */
export function startOf(name) {
  const [kind, ...values] = name.split(":");
  const fields = START_FIELDS[kind] ?? [];
  const state = values.splice(fields.length).map(Number);
  if (!fields.length || values.length < fields.length || ![0, kind === "cycle" && 6].includes(state.length)) return null;
  return { kind, ...Object.fromEntries(fields.map((field, i) => [field, Number(values[i])])), ...(state.length && { state }) };
}

/** Whether Eq. 25 is of a sweep; of `auto`, of the contact that it chose. */
export const hasSpring = ({ spec, choice }) => (choice?.model ?? spec.model.kind) !== "ball";

/** Whether cycles of a spring can be drawn over a sweep. Those in closed form are of `rigid` without restitution. */
export const hasCycles = ({ spec }) => ["rigid", "soft", "stepped"].includes(spec.model.kind);

/** The contact whose cycles are followed, as a query has it; empty: those of an ideal plate, in closed form. */
export function contactQuery({ kind, restitution, penetration, adhesive }) {
  if (kind === "rigid" && restitution > 0 && restitution < 1) return { model: kind, restitution };
  return ["soft", "stepped"].includes(kind) && penetration && restitution < 1 ? { model: "soft", restitution, penetration, adhesive } : {};
}

export const isIdeal = ({ kind, restitution }) => kind === "rigid" && !restitution;
/** Springs that Explore shows: from, to and step of each axis. */
export const EXPLORED = { gamma: [0.1, 8, 0.01], omega: [0.12, 2, 0.005], xi: [0, 1, 0.005] };
export const hasOwnCycles = ({ spec }) => "model" in contactQuery(spec.model ?? {});
/** What legends add to cycles of an ideal plate over a sweep on another contact. */
export const ofOtherPlate = (job) => (hasOwnCycles(job) || isIdeal(job.spec.model) ? "" : ", ideal plate");

/** "cycle (1, 1), unstable · flight time 3.9 rad · multipliers 2.1, 0.3"; `multipliers`: real and imaginary part of two. */
export function cycleText({ bounces, periods, stable, flight_time: time, multipliers: [re, im, otherRe] }) {
  const pair = im ? `${number(re, 4)} ± ${number(Math.abs(im), 4)} i` : `${number(re, 4)}, ${number(otherRe, 4)}`;
  return `cycle (${bounces}, ${periods}), ${stable ? "stable" : "unstable"} · flight time ${number(time, 5)} rad · multipliers ${pair}`;
}
