// Cycles in closed form over the diagram: branches, solid where stable and dashed where not, and their events.

import { query, requestDataset } from "../lib/api.js";
import { cycleText } from "../lib/cycles.js";
import { h } from "../lib/dom.js";
import { number } from "../lib/format.js";
import { SYMBOL } from "../lib/physics.js";
import { circle, disc, polyline } from "../plot/drawing.js";

const MODES = "1-1,1-2,1-3";
const FOLD_MODES = "1-1,1-2";
const POINTS = 400; // of a branch, at least
const DASH = [6, 4];
const NEAR_PX = 9; // a pointer nearer to a branch than to any flight selects the cycle
const MARK_PX = 4;

/** Events by kind: the words of their labels. */
const EVENTS = {
  fold: "fold",
  flip: "flip",
  "neimark-sacker": "Neimark–Sacker",
  "immediate-takeoff": "take-off at once",
  "graze-flight": "graze in flight",
  "graze-contact": "graze in contact",
  cusp: "cusp",
  "bogdanov-takens": "Bogdanov–Takens",
  "fold-flip": "fold-flip",
};

/** A check box for what the closed form adds to a plot, and a note beside it. */
export class ClosedFormBox {
  constructor(label, checked, onChange) {
    this.input = h("input", { type: "checkbox", checked, onchange: () => onChange(this.input.checked) });
    this.note = h("span", { className: "note", role: "status" });
    const title = "In closed form, on an ideal plate without restitution; unstable cycles too";
    this.element = h("span", { className: "closed-form" }, h("label", { className: "direction branch", title }, this.input, ` ${label}`), " ", this.note);
  }

  get checked() {
    return this.input.checked;
  }
}

const OF_EVENT = ["kind", "gamma", "omega", "bounces", "periods", "flight_time", "admissible"].map((name) => [name, `event_${name}`]);
const OF_BRANCH = [["bounces", "branch_bounces"], ["periods", "branch_periods"], ...["gamma", "flight_time", "stable", "admissible", "multipliers"].map((name) => [name, name])];
const OF_CURVE = ["omega", "gamma", "admissible"].map((name) => [name, name]);

/** The things along the first dimension of some variables: for each an object of its value or its part of each array. */
function things(result, dim, fields) {
  return Array.from({ length: result.dims[dim] }, (_, i) => Object.fromEntries(fields.map(([field, name]) => {
    const { data, shape = [data.length] } = result[name];
    const size = data.length / shape[0];
    return [field, shape.length === 1 ? data[i] : data.subarray(i * size, (i + 1) * size)];
  })));
}

/** The branches and events of a spring up to `gammaMax`. Beyond the end of a branch nothing is admissible. */
export async function requestBranches({ omega, xi }, gammaMax, options) {
  const result = await requestDataset(`/v1/orbits?${query({ omega, xi, modes: MODES, gamma_max: gammaMax, points: POINTS })}`, options);
  return { branches: things(result, "branch", OF_BRANCH), events: things(result, "event", OF_EVENT) };
}

/** The curves of folds over Ω, and the points at which they meet. */
export async function requestFolds(xi, [low, high], gammaMax, options) {
  const result = await requestDataset(`/v1/curves?${query({ xi, omega_start: low, omega_stop: high, modes: FOLD_MODES, kinds: "fold", gamma_max: gammaMax })}`, options);
  return { xi: result.xi.data, curves: things(result, "curve", OF_CURVE), points: things(result, "event", OF_EVENT) };
}

/** Draw the folds of cycles that the spring has, and mark cusps and the like. */
export function drawFolds(ctx, box, { curves, points }) {
  for (const { omega, gamma, admissible } of curves) {
    let run = [];
    const runs = [run];
    omega.forEach((value, i) => {
      if (admissible[i]) runs.push((run = []));
      else run.push([box.x.pixel(value), box.y.pixel(gamma[i])]);
    });
    for (const part of runs.filter(({ length }) => length > 1)) polyline(ctx, box.theme.branch, 1.8, part);
  }
  const labels = [];
  for (const point of points.filter(({ admissible }) => admissible === 0)) drawEvent(ctx, box, point.omega, point.gamma, point, labels);
}

/** The legend of folds in a Plot. */
export const foldLegend = () => [["fold", (ctx, x, y, theme) => polyline(ctx, theme.branch, 1.8, [[x, y], [x + 24, y]])]];

/** Draw the cycles that the spring has, and mark their events. */
export function drawBranches(ctx, box, { branches, events }) {
  const labels = [];
  for (const branch of branches) {
    for (const { stable, points } of runsOf(branch, events)) {
      const pixels = points.map(({ gamma, flight_time: time }) => [box.x.pixel(gamma), box.y.pixel(time)]);
      polyline(ctx, box.theme.branch, stable ? 2 : 1.4, pixels, stable ? [] : DASH);
    }
  }
  for (const event of events.filter(({ admissible }) => admissible === 0)) drawEvent(ctx, box, event.gamma, event.flight_time, event, labels);
}

/** The parts of a branch on which cycles exist and are all stable, or all unstable; they begin and end at events. */
function runsOf({ periods, gamma, flight_time: time, stable, admissible }, events) {
  const runs = [];
  let run = null;
  for (let i = 0; i < gamma.length; i++) {
    const isSame = run && !admissible[i] && run.stable === stable[i];
    const between = isSame || i === 0 ? [] : events.filter((event) => event.periods === periods && event.admissible === 0
      && event.flight_time > time[i - 1] && event.flight_time < time[i]);
    if (!isSame) {
      if (between.length) run?.points.push(between[0]);
      run = null;
    }
    if (admissible[i]) continue;
    if (!run) runs.push((run = { stable: stable[i], points: between.slice(-1) }));
    run.points.push({ gamma: gamma[i], flight_time: time[i] });
  }
  return runs;
}

/** A ring, and its name beside it where no other label is. `labels` are the boxes taken so far. */
export function drawEvent(ctx, box, x, y, { kind }, labels) {
  const [px, py] = [box.x.pixel(x), box.y.pixel(y)];
  if (!(px >= box.left && px <= box.left + box.width && py >= box.top && py <= box.top + box.height)) return;
  disc(ctx, box.theme.surface, px, py, MARK_PX);
  circle(ctx, box.theme.branch, 1.6, px, py, MARK_PX);
  const text = EVENTS[kind] ?? kind;
  ctx.font = `italic 13px ${box.theme.serif}`;
  const width = ctx.measureText(text).width;
  const right = px + MARK_PX + 5;
  for (const [left, top] of [[right, py - 15], [right, py + 2], [px - MARK_PX - 5 - width, py - 15], [px - MARK_PX - 5 - width, py + 2]]) {
    const label = { left, right: left + width, top, bottom: top + 15 };
    const isInside = left >= box.left && label.right <= box.left + box.width && top >= box.top && label.bottom <= box.top + box.height;
    if (!isInside || labels.some((other) => overlaps(other, label))) continue;
    labels.push(label);
    ctx.fillStyle = box.theme.branch;
    ctx.textAlign = "left";
    ctx.textBaseline = "top";
    ctx.fillText(text, left, top);
    return;
  }
}

const overlaps = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;

/** The cycle at most NEAR_PX from a position in axis values, {branch, point, distance}; null if there is none. */
export function nearestCycle({ branches }, box, x, y) {
  const [px, py] = [box.x.pixel(x), box.y.pixel(y)];
  let nearest = { distance: NEAR_PX };
  for (const branch of branches) {
    branch.gamma.forEach((gamma, point) => {
      if (branch.admissible[point]) return;
      const distance = Math.hypot(box.x.pixel(gamma) - px, box.y.pixel(branch.flight_time[point]) - py);
      if (distance < nearest.distance) nearest = { branch, point, distance };
    });
  }
  return nearest.branch ? nearest : null;
}

/** A ring around a cycle. */
export function drawCycle(ctx, box, { branch, point }) {
  circle(ctx, box.theme.cursor, 1.8, box.x.pixel(branch.gamma[point]), box.y.pixel(branch.flight_time[point]), 5.5);
}

/** A cycle in words, with its multipliers. */
export function describeCycle({ branch, point }) {
  const at = Object.fromEntries(["gamma", "flight_time", "stable"].map((name) => [name, branch[name][point]]));
  const [re, im, otherRe, otherIm] = branch.multipliers.subarray(4 * point);
  return `${SYMBOL.gamma} = ${number(at.gamma, 5)} · ${cycleText({ ...branch, ...at, multipliers: [[re, im], [otherRe, otherIm]] })}`;
}

/** The legend of branches in a Plot. */
export const branchLegend = () => [["stable", []], ["unstable", DASH]].map(([name, dash]) =>
  [name, (ctx, x, y, theme) => polyline(ctx, theme.branch, dash.length ? 1.4 : 2, [[x, y], [x + 24, y]], dash)]);
