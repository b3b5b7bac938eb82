// Cycles over the diagram: branches, solid where stable and dashed where not, and their events; in closed form, or of a contact.

import { currentQuery, queryChanges, setQuery } from "../lib/address.js";
import { isHandledElsewhere, partsOf, query, requestDataset } from "../lib/api.js";
import { h, latest } from "../lib/dom.js";
import { number } from "../lib/format.js";
import { SYMBOL, clamp, contactQuery, cycleText, hasOwnCycles, isClose, isIdeal, startName } from "../lib/physics.js";
import { circle, curve, disc, isInBox, legendLine, polyline } from "../plot/drawing.js";

const FOLD_MODES = "1-1,1-2";
const POINTS = 400; // of a branch, at least
const BEYOND = 2; // branches are requested up to this many times the highest Γ, so that none ends within the plot
const FOLD_WIDTH = 1.8; // px
const [STABLE, UNSTABLE] = [{ width: 2, dash: [] }, { width: 1.4, dash: [6, 4] }];
const NEAR_PX = 9; // a pointer nearer to a branch than to any flight selects the cycle
const MARK_PX = 4;
const RING_PX = MARK_PX + 2; // within which a pointer is on an event
const BESIDE_PX = 8; // from the middle of a ring: a name beside another one would seem to be its own

/** Labels of events, where they are not their kind. */
const EVENTS = {
  "neimark-sacker": "Neimark–Sacker", "bogdanov-takens": "Bogdanov–Takens",
  "immediate-takeoff": "take-off at once", "graze-flight": "graze in flight", "graze-contact": "graze in contact",
};

export const eventName = (kind) => EVENTS[kind] ?? kind;

/** Cycles over a plot: a check box with a note beside it, and their data, null where they are not shown, with the values of the axes at which they are. */
class CyclesOverlay {
  data = null;
  at = (fixed) => (Object.entries(fixed).every(([axis, value]) => isClose(value, this.data?.place[axis])) ? this.data : null); // as the view shows them
  isComplete = true; // whether no cell that is computed later changes the data

  /** `parameter` of the address; `path()` of the result, null where there is none; `read(result)` gives the data. */
  constructor(view, label, parameter, path, read) {
    Object.assign(this, { view, parameter, path, read });
    this.input = h("input", { type: "checkbox", onchange: () => setQuery({ [parameter]: this.input.checked ? 1 : null }) });
    this.note = h("span", { className: "note", role: "status" });
    const title = `${hasOwnCycles(view.job) ? "Of the contact that the sweep has, or its steps approximate, followed by workers" : "In closed form, on an ideal plate without restitution"}; unstable cycles too`;
    this.element = h("span", { className: "closed-form", hidden: path() === null }, h("label", { title }, this.input, ` ${label}`), " ", this.note);
    this.load = latest((signal) => this.#load(signal));
    queryChanges.addEventListener("change", () => this.update(), { signal: view.signal });
  }

  update() {
    this.input.checked = currentQuery()[this.parameter] === "1";
    const path = this.path();
    this.element.hidden = path === null;
    const wanted = this.input.checked ? path : null;
    const isSame = wanted === this.requested;
    if (!isSame) Object.assign(this, { requested: wanted, isComplete: false });
    if (!this.isComplete) this.load(isSame); // there may be more cells
  }

  async #load(signal) {
    if (this.isComplete) return; // since this was due
    const [path, { place }] = [this.requested, this.view];
    this.note.textContent = path ? "computing …" : "";
    try {
      const result = path && await requestDataset(path, { signal });
      Object.assign(this, { data: result && { ...this.read(result), place }, isComplete: path === this.requested && (result?.attrs.complete ?? true) });
      this.note.textContent = this.data?.events.some(({ kind }) => kind === "cut-off") ? "Branches with too many points were cut off" : "";
    } catch (error) {
      if (error.name === "AbortError") return;
      Object.assign(this, { data: null, requested: null, isComplete: true });
      this.note.textContent = isHandledElsewhere(error) ? "" : error.message;
    }
    if (this.view.isLoaded && !this.view.signal.aborted) this.view.draw();
  }
}

/** The address of the branches and events of a spring up to `gammaMax` on the contact `model`, of cycles up to `longest` plate periods. */
export function branchesPath({ omega, xi }, gammaMax, model, longest = 3) {
  const modes = Array.from({ length: longest }, (_, i) => `1-${i + 1}`).join();
  return `/v1/orbits?${query({ omega, xi, modes, gamma_max: gammaMax, points: POINTS, ...contactQuery(model) })}`;
}

/** The address of the branches along Ω or ξ of the cycles that cells of a sweep settled to; null where its contact's are not followed. */
const cellBranchesPath = ({ job, along, place }) => (hasOwnCycles(job) || isIdeal(job.spec.model)
  ? `/v1/jobs/${job.id}/orbits?${query({ ...place, along, [along]: null })}` : null);

/** Branches as lists of cycles {gamma, flight_time, stable, violations, multipliers, bounces, periods}, with the value of the axis
 * `along` which they are, and their events. Of several flights, flight_time is the longest. */
export function readBranches(result) {
  const { along = "gamma" } = result.attrs;
  const cyclesOf = ({ bounces, periods, gamma, [along]: values, flight_time: times, stable, violations, multipliers, cycle_state: states }) => Array.from(gamma, (value, i) => ({
    bounces, periods, gamma: value, [along]: values[i], flight_time: times[(i * times.length) / gamma.length],
    stable: stable[i], violations: violations[i], multipliers: multipliers.subarray(4 * i), state: states?.subarray(6 * i, 6 * i + 6),
  }));
  return { along, branches: partsOf(result, "branch").map(cyclesOf), events: partsOf(result, "event") };
}

export const branchesOver = (view) => new CyclesOverlay(view, "Branches", "branches",
  () => (view.along === "gamma" ? branchesPath(view.place, BEYOND * view.grid.gamma.at(-1), view.job.spec.model) : cellBranchesPath(view)), readBranches);

/** The curves of folds over Ω, and the points at which they meet. */
export function foldsOver(view) {
  const { omega, gamma } = view.grid;
  const fixed = { omega_start: omega[0], omega_stop: omega.at(-1), modes: FOLD_MODES, kinds: "fold", gamma_max: gamma.at(-1) };
  const path = () => `/v1/curves?${query({ xi: view.place.xi, ...fixed, ...contactQuery(view.job.spec.model) })}`;
  return new CyclesOverlay(view, "Folds", "folds", path, (result) => ({ branches: partsOf(result, "curve").map(foldsOf), events: partsOf(result, "event") }));
}

const foldsOf = ({ omega, gamma, flight_time: times, violations, ...curve }) => Array.from(omega, (value, i) => ({
  ...curve, omega: value, gamma: gamma[i], flight_time: times[i], violations: violations[i],
}));

/** Where cycles are drawn, in px: over the axis `along`, and folds over Ω. */
const overAxis = (along) => ({ x, y }) => ({ [along]: value, flight_time: time }) => [x.pixel(value), y.pixel(time)];
export const overOmega = ({ x, y }) => ({ omega, gamma }) => [x.pixel(omega), y.pixel(gamma)];

/** Draw the folds of cycles that the spring has, and mark cusps and the like. */
export function drawFolds(ctx, box, { branches, events }) {
  const lines = branches.map((folds) => curve(folds.map(({ omega, gamma, violations }) => (violations ? null : [omega, gamma])), box));
  for (const line of lines) polyline(ctx, box.theme.branch, FOLD_WIDTH, line);
  drawEvents(ctx, box, events, overOmega(box), lines.flat().filter(Boolean));
}

export const foldLegend = (plate) => [[`fold${plate}`, (ctx, x, y, theme) => legendLine(ctx, theme.branch, FOLD_WIDTH, x, y)]];

/** Draw the cycles that the spring has, and mark their events. */
export function drawBranches(ctx, box, { branches, events, along }) {
  for (const { stable, points } of branches.flatMap((branch) => runsOf(branch, events, along))) {
    const { width, dash } = stable ? STABLE : UNSTABLE;
    polyline(ctx, box.theme.branch, width, curve(points.map(({ [along]: value, flight_time: time }) => [value, time]), box), dash);
  }
  const cycles = branches.flat().filter(({ violations }) => !violations);
  drawEvents(ctx, box, events, overAxis(along)(box), cycles.map(overAxis(along)(box)));
}

/** The parts of a branch on which cycles exist and are all stable, or all unstable; they begin and end at events. */
function runsOf(branch, events, along) {
  const runs = [];
  let run = null;
  for (const [i, cycle] of branch.entries()) {
    if (run && !cycle.violations && run.stable === cycle.stable) {
      run.points.push(cycle);
      continue;
    }
    const last = branch[i - 1] ?? {}; // of the first cycle none: then no event is between
    const near = Math.max(Math.abs(last[along] - cycle[along]), 0.01 * cycle[along]); // a fold is beyond both
    const isBetween = ({ flight_time: time, [along]: value }) =>
      (time - last.flight_time) * (time - cycle.flight_time) < 0 && Math.abs(value - cycle[along]) <= near;
    const between = events.filter((event) => event.periods === cycle.periods && event.violations === 0 && isBetween(event));
    if (between.length) run?.points.push(between[0]);
    run = cycle.violations ? null : { stable: cycle.stable, points: [...between.slice(-1), cycle] };
    if (run) runs.push(run);
  }
  return runs;
}

/** Rings at the events, with their names where these cover no other, no ring, and none of the `points`, in px, and stand beside no other ring. */
function drawEvents(ctx, box, events, pixel, points) {
  const isInside = ([x, y]) => isInBox(x, y, box);
  const shown = events.map((event) => ({ ...event, position: pixel(event) })).filter(({ violations, position }) => violations === 0 && isInside(position));
  const square = (size) => ([x, y]) => ({ left: x - size, right: x + size, top: y - size, bottom: y + size });
  const rings = shown.map(({ position }) => square(MARK_PX)(position));
  const taken = [...points.filter(isInside).map(square(1)), ...rings];
  for (const { kind, position } of shown) drawEvent(ctx, box, position, eventName(kind), taken, rings);
}

/** A ring, and its name beside it where it is free. `taken`: the boxes taken so far, `rings` those of all rings. */
function drawEvent(ctx, box, [px, py], text, taken, rings) {
  disc(ctx, box.theme.surface, px, py, MARK_PX);
  circle(ctx, box.theme.branch, 1.6, px, py, MARK_PX);
  ctx.font = `italic 13px ${box.theme.serif}`;
  const width = ctx.measureText(text).width;
  const [before, after] = [px - MARK_PX - 5 - width, px + MARK_PX + 5];
  const places = [[after, py - 15], [after, py + 2], [before, py - 15], [before, py + 2]];
  const overlap = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
  const others = rings.filter(({ left, top }) => Math.hypot(left + MARK_PX - px, top + MARK_PX - py) > MARK_PX);
  const beside = (label) => ({ ...label, left: Math.min(label.left, px - BESIDE_PX), right: Math.max(label.right, px + BESIDE_PX) });
  const isFree = (label) => isInBox(label.left, label.top, box) && isInBox(label.right, label.bottom, box)
    && !taken.some((other) => overlap(label, other)) && !others.some((other) => overlap(beside(label), other));
  const label = places.map(([left, top]) => ({ left, right: left + width, top, bottom: top + 15 })).find(isFree);
  if (!label) return;
  taken.push(label);
  box.texts.push({ text, x: label.left, y: label.top + 7, italic: true, colour: box.theme.branch });
}

/** The cycle next to which a branch passes a position in axis values within NEAR_PX, null if none does; first the event marked there, with the cycle next to it as its `start`. */
export function nearestCycle({ branches, events, along }, box, x, y, pixelOf = overAxis(along)) {
  const [pixel, px, py] = [pixelOf(box), box.x.pixel(x), box.y.pixel(y)];
  const distance = ([left, top]) => Math.hypot(left - px, top - py);
  const nearest = (items, limit) => items.filter(([length, { violations }]) => length < limit && !violations).sort(([a], [b]) => a - b)[0]?.[1];
  const between = (branch) => branch.map((cycle, i) => {
    const from = [branch[i - 1], cycle].every((end) => end?.violations === 0) ? branch[i - 1] : cycle;
    const [[ax, ay], [bx, by]] = [from, cycle].map(pixel);
    const part = clamp(((px - ax) * (bx - ax) + (py - ay) * (by - ay)) / Math.hypot(bx - ax, by - ay) ** 2 || 0, 0, 1);
    return [distance([ax + part * (bx - ax), ay + part * (by - ay)]), part < 0.5 ? from : cycle];
  });
  const event = nearest(events.map((marked) => [distance(pixel(marked)), marked]), RING_PX);
  const cycles = branches.flatMap(between);
  return event ? { ...event, start: nearest(cycles, Infinity) } : (nearest(cycles, NEAR_PX) ?? null);
}

/** The cycles nearest to a Γ, one for each time that a branch passes it, those of the shortest flight first. */
export function cyclesAt({ branches }, gamma) {
  const isPassed = (cycle, i, branch) => i && !cycle.violations && (cycle.gamma - gamma) * (branch[i - 1].gamma - gamma) <= 0;
  const nearer = (cycle, before) => (!before.violations && Math.abs(before.gamma - gamma) < Math.abs(cycle.gamma - gamma) ? before : cycle);
  const passed = branches.flatMap((branch) => branch.flatMap((cycle, i) => (isPassed(cycle, i, branch) ? nearer(cycle, branch[i - 1]) : [])));
  return [...new Set(passed)].sort((a, b) => a.flight_time - b.flight_time);
}

export const drawCycle = (ctx, box, cycle, along = "gamma") => circle(ctx, box.theme.cursor, 1.8, ...overAxis(along)(box)(cycle), 5.5);
export const describeCycle = (cycle, along = "gamma") => (cycle.kind ? describeEvent(cycle, along) : `${SYMBOL[along]} = ${number(cycle[along], 5)} · ${cycleText(cycle)}`);
/** "fold (1, 1) · Γ = 0.7678248 · φ = 4.29437 rad" */
export const describeEvent = ({ kind, bounces, periods, flight_time: time, ...event }, along = "gamma") => `${eventName(kind)} (${bounces}, ${periods}) · ${SYMBOL[along]} = ${number(event[along], 7)} · φ = ${number(time, 6)} rad`;

/** The motion that begins on a cycle, or next to an event. */
export const startOn = (place, cycle, along = "gamma") => (cycle.start ? startOn(place, cycle.start, along)
  : { ...place, [along]: cycle[along], direction: [startName("cycle", cycle.periods, cycle.flight_time), ...(cycle.state ?? [])].join(":") });

export const branchLegend = (plate = "") => [["stable", STABLE], ["unstable", UNSTABLE]].map(([name, { width, dash }]) =>
  [name + plate, (ctx, x, y, theme) => legendLine(ctx, theme.branch, width, x, y, dash)]);
