// Cycles over the diagram: branches, solid where stable and dashed where not, and their events; in closed form, or of a contact.

import { currentQuery, queryChanges, setQuery } from "../lib/address.js";
import { isHandledElsewhere, partsOf, query, requestDataset } from "../lib/api.js";
import { h, latest } from "../lib/dom.js";
import { number } from "../lib/format.js";
import { SYMBOL, contactQuery, cycleText, hasOwnCycles } from "../lib/physics.js";
import { circle, disc, polyline } from "../plot/drawing.js";

const FOLD_MODES = "1-1,1-2";
const POINTS = 400; // of a branch, at least
const BEYOND = 2; // branches are requested up to this many times the highest Γ, so that none ends within the plot
const DASH = [6, 4];
const NEAR_PX = 9; // a pointer nearer to a branch than to any flight selects the cycle
const MARK_PX = 4;

/** Labels of events, where they are not their kind. */
const EVENTS = {
  "neimark-sacker": "Neimark–Sacker",
  "immediate-takeoff": "take-off at once",
  "graze-flight": "graze in flight",
  "graze-contact": "graze in contact",
  "bogdanov-takens": "Bogdanov–Takens",
};

export const eventName = (kind) => EVENTS[kind] ?? kind;

/** What cycles add to a plot: a check box with a note beside it, and its data, null where they are not shown. */
class ClosedForm {
  data = null;

  /** `parameter` of the address; `path()` of the result, null where there is none; `read(result)` gives the data. */
  constructor(view, label, parameter, path, read) {
    Object.assign(this, { view, parameter, path, read });
    this.input = h("input", { type: "checkbox", onchange: () => setQuery({ [parameter]: this.input.checked ? 1 : null }) });
    this.note = h("span", { className: "note", role: "status" });
    const title = `${hasOwnCycles(view.job) ? "Of the sweep's own contact, followed by workers" : "In closed form, on an ideal plate without restitution"}; unstable cycles too`;
    this.element = h("span", { className: "closed-form", hidden: path() === null }, h("label", { className: "direction branch", title }, this.input, ` ${label}`), " ", this.note);
    this.load = latest((signal) => this.#load(signal));
    queryChanges.addEventListener("change", () => this.update(), { signal: view.signal });
  }

  /** Load what the address asks for, unless it is there. */
  update() {
    this.input.checked = currentQuery()[this.parameter] === "1";
    const found = this.path();
    this.element.hidden = found === null;
    const path = this.input.checked ? found : null;
    if (path === this.requested) return;
    this.requested = path;
    this.load();
  }

  /** Workers may compute the result first, which takes some seconds. */
  async #load(signal) {
    const path = this.requested;
    this.note.textContent = path ? "computing …" : "";
    try {
      this.data = path && this.read(await requestDataset(path, { signal }));
      this.note.textContent = "";
    } catch (error) {
      if (error.name === "AbortError") return;
      Object.assign(this, { data: null, requested: null });
      this.note.textContent = isHandledElsewhere(error) ? "" : error.message;
    }
    if (this.view.isLoaded && !this.view.signal.aborted) this.view.draw();
  }
}

const unprefixed = (part) => Object.fromEntries(Object.entries(part).map(([name, value]) => [name.replace(/^(event|branch)_/, ""), value]));

/** The address of the branches and events of a spring up to `gammaMax` on the contact `model`, of cycles up to `longest` plate periods, and what is drawn of them. */
export const branchesPath = ({ omega, xi }, gammaMax, model, longest = 3) => `/v1/orbits?${query({ omega, xi, modes: Array.from({ length: longest }, (_, i) => `1-${i + 1}`).join(), gamma_max: gammaMax, points: POINTS, ...contactQuery(model) })}`;
/** Branches are lists of cycles {gamma, flight_time, stable, violations, multipliers, bounces, periods}. */
export const readBranches = (result) => ({ branches: partsOf(result, "branch").map(unprefixed).map(cyclesOf), events: partsOf(result, "event").map(unprefixed) });

const cyclesOf = ({ bounces, periods, multipliers, ...branch }) => Array.from(branch.gamma, (gamma, i) => ({
  bounces, periods, gamma, ...Object.fromEntries(["flight_time", "stable", "violations"].map((name) => [name, branch[name][i]])), multipliers: multipliers.subarray(4 * i),
}));

/** The branches over a diagram along Γ. */
export const branchesOver = (view) => new ClosedForm(view, "Branches", "branches",
  () => (view.along === "gamma" ? branchesPath(view.place, BEYOND * view.grid.gamma.at(-1), view.job.spec.model) : null), readBranches);

/** The curves of folds over Ω, and the points at which they meet. */
export function foldsOver(view) {
  const { omega, gamma } = view.grid;
  const fixed = { omega_start: omega[0], omega_stop: omega.at(-1), modes: FOLD_MODES, kinds: "fold", gamma_max: gamma.at(-1) };
  return new ClosedForm(view, "Folds", "folds", () => `/v1/curves?${query({ xi: view.place.xi, ...fixed, ...contactQuery(view.job.spec.model) })}`,
    (result) => ({ curves: partsOf(result, "curve"), points: partsOf(result, "event").map(unprefixed) }));
}

/** Draw the folds of cycles that the spring has, and mark cusps and the like. */
export function drawFolds(ctx, box, { curves, points }) {
  for (const { omega, gamma, violations } of curves) {
    polyline(ctx, box.theme.branch, 1.8, Array.from(omega, (value, i) => (violations[i] ? null : [box.x.pixel(value), box.y.pixel(gamma[i])])));
  }
  const lines = curves.flatMap(({ omega, gamma, violations }) => Array.from(omega, (value, i) => [value, gamma[i]]).filter((_, i) => !violations[i]));
  drawEvents(ctx, box, points.map(({ omega, gamma, ...point }) => ({ ...point, at: [omega, gamma] })), lines);
}

/** The legend of folds in a Plot. */
export const foldLegend = () => [["fold", (ctx, x, y, theme) => polyline(ctx, theme.branch, 1.8, [[x, y], [x + 24, y]])]];

/** Draw the cycles that the spring has, and mark their events. */
export function drawBranches(ctx, box, { branches, events }) {
  for (const branch of branches) {
    for (const { stable, points } of runsOf(branch, events)) {
      const pixels = points.map(({ gamma, flight_time: time }) => [box.x.pixel(gamma), box.y.pixel(time)]);
      polyline(ctx, box.theme.branch, stable ? 2 : 1.4, pixels, stable ? [] : DASH);
    }
  }
  const lines = branches.flat().filter(({ violations }) => !violations).map(({ gamma, flight_time: time }) => [gamma, time]);
  drawEvents(ctx, box, events.map(({ gamma, flight_time: time, ...event }) => ({ ...event, at: [gamma, time] })), lines);
}

/** The parts of a branch on which cycles exist and are all stable, or all unstable; they begin and end at events. */
function runsOf(branch, events) {
  const runs = [];
  let run = null;
  for (const [i, cycle] of branch.entries()) {
    const isSame = run && !cycle.violations && run.stable === cycle.stable;
    const between = isSame || i === 0 ? [] : events.filter((event) => event.periods === cycle.periods && event.violations === 0
      && (event.flight_time - branch[i - 1].flight_time) * (event.flight_time - cycle.flight_time) < 0);
    if (!isSame) {
      if (between.length) run?.points.push(between[0]);
      run = null;
    }
    if (cycle.violations) continue;
    if (!run) runs.push((run = { stable: cycle.stable, points: between.slice(-1) }));
    run.points.push(cycle);
  }
  return runs;
}

/** Rings at the events, with their names where these cover no other, no ring, and no point of the `lines`. */
function drawEvents(ctx, box, events, lines) {
  const pixel = ([x, y]) => [box.x.pixel(x), box.y.pixel(y)];
  const isInside = ([x, y]) => x >= box.left && x <= box.left + box.width && y >= box.top && y <= box.top + box.height;
  const shown = events.filter(({ violations }) => violations === 0).map(({ kind, at }) => ({ kind, at: pixel(at) })).filter(({ at }) => isInside(at));
  const square = (size) => ([x, y]) => ({ left: x - size, right: x + size, top: y - size, bottom: y + size });
  const taken = [...lines.map(pixel).filter(isInside).map(square(1)), ...shown.map(({ at }) => square(MARK_PX)(at))];
  for (const { kind, at } of shown) drawEvent(ctx, box, at, eventName(kind), taken);
}

/** A ring, and its name beside it where it is free. `taken`: the boxes taken so far. */
function drawEvent(ctx, box, [px, py], text, taken) {
  disc(ctx, box.theme.surface, px, py, MARK_PX);
  circle(ctx, box.theme.branch, 1.6, px, py, MARK_PX);
  ctx.font = `italic 13px ${box.theme.serif}`;
  const width = ctx.measureText(text).width;
  const right = px + MARK_PX + 5;
  for (const [left, top] of [[right, py - 15], [right, py + 2], [px - MARK_PX - 5 - width, py - 15], [px - MARK_PX - 5 - width, py + 2]]) {
    const label = { left, right: left + width, top, bottom: top + 15 };
    const isInside = left >= box.left && label.right <= box.left + box.width && top >= box.top && label.bottom <= box.top + box.height;
    if (!isInside || taken.some((other) => overlaps(other, label))) continue;
    taken.push(label);
    box.texts.push({ text, x: left, y: top + 7, italic: true, colour: box.theme.branch });
    return;
  }
}

const overlaps = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;

/** The cycle nearest to a position in axis values, nearer than NEAR_PX; null if there is none. */
export function nearestCycle({ branches }, box, x, y) {
  const [px, py] = [box.x.pixel(x), box.y.pixel(y)];
  const away = ({ gamma, flight_time: time, violations }) => (violations ? Infinity : Math.hypot(box.x.pixel(gamma) - px, box.y.pixel(time) - py));
  const near = branches.flat().map((cycle) => [away(cycle), cycle]).filter(([distance]) => distance < NEAR_PX);
  return near.sort(([a], [b]) => a - b)[0]?.[1] ?? null;
}

/** The cycles nearest to a Γ, one for each time that a branch passes it, those of the shortest flight first. */
export function cyclesAt({ branches }, gamma) {
  const found = branches.flatMap((branch) => branch.filter((cycle, i) => i && !cycle.violations && (cycle.gamma - gamma) * (branch[i - 1].gamma - gamma) <= 0));
  return found.sort((a, b) => a.flight_time - b.flight_time);
}

/** A ring around a cycle. */
export const drawCycle = (ctx, box, { gamma, flight_time: time }) => circle(ctx, box.theme.cursor, 1.8, box.x.pixel(gamma), box.y.pixel(time), 5.5);

/** A cycle in words, with its multipliers. */
export const describeCycle = (cycle) => `${SYMBOL.gamma} = ${number(cycle.gamma, 5)} · ${cycleText(cycle)}`;

/** The legend of branches in a Plot. */
export const branchLegend = () => [["stable", []], ["unstable", DASH]].map(([name, dash]) =>
  [name, (ctx, x, y, theme) => polyline(ctx, theme.branch, dash.length ? 1.4 : 2, [[x, y], [x + 24, y]], dash)]);
