// Thresholds in Γ against Ω: where bouncing begins on the ramp up and ends on the ramp down, with Eq. 25.

import { query } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { number } from "../lib/format.js";
import { axisLabel, clampIndex, hasCycles, isLog, nearestIndex, threshold } from "../lib/physics.js";
import { directionColour } from "../plot/colours.js";
import { disc, polygon, polyline, verticalLine } from "../plot/drawing.js";
import { extent } from "../plot/scale.js";
import { drawFolds, foldLegend, foldsOver } from "./closed-form.js";
import { sliders } from "./controls.js";
import { PlotView } from "./plot-view.js";

const DASH = [7, 4];
const HINT = "Point at a frequency to read it, press to show a trajectory, drag to zoom.";
const BESIDE = 4; // px from the frequency: both directions may lie beyond the same edge

/** What the readout says of a threshold that is not a number, by its status; `grid` are the values of Γ. */
const REASONS = {
  "below the grid": (grid) => `bounces already at the lowest Γ, ${number(grid[0])}: start lower`,
  "above the grid": (grid) => `at rest up to the highest Γ, ${number(grid.at(-1))}: end higher`,
  "never bounces": () => "never bounces",
  "not refined": () => "not refined",
  missing: () => "not computed yet",
  unresolved: () => "the cell that decides is unresolved",
  diverged: () => "the cell that decides diverged",
  settling: () => "the cell that decides was still settling: give it more time",
};
/** What is read of each frequency; numbers that are not there are null. */
const COLUMNS = ["omega", "analytic", "up", "up_status", "down", "down_status", "predicted_jump", "predicted_down", "cause", "difference"];
const BEYOND = { "below the grid": 1, "above the grid": -1 }; // where a pointer points: 1 down
const UNDECIDED = new Set(["unresolved", "diverged", "settling"]);

/** Cells are {index, y}: an index into Ω and, from the pointer, a Γ. */
export class Thresholds extends PlotView {
  name = "thresholds";

  constructor(root, view) {
    super(view);
    this.closedForm = hasCycles(this.job) && this.grid.omega.length > 1 && foldsOver(this);
    const controls = h("div", { className: "controls" }, sliders(this, ["xi"]), this.closedForm?.element);
    this.build(root, { controls, label: "Thresholds against the plate frequency", hint: HINT });
  }

  paths() {
    return [this.filePath()];
  }

  filePath() {
    return `/v1/jobs/${this.job.id}/threshold?${query({ xi: this.place.xi })}`;
  }

  read([result]) {
    const columns = COLUMNS.map((name) => [name, Array.from(result[name].data, (value) => (Number.isNaN(value) ? null : value))]);
    this.thresholds = { xi: result.xi.data, complete: result.attrs.complete, ...Object.fromEntries(columns) };
    this.closedForm?.update?.();
  }

  get folds() {
    return this.closedForm?.data ?? null;
  }

  shown() {
    return { xi: this.thresholds.xi, folds: Boolean(this.folds) };
  }

  whole() {
    const { omega, xi } = this.thresholds;
    const [x0, x1] = extent(omega[0], omega[omega.length - 1]);
    const computed = [...this.#computed(), ...this.#edges()];
    const highest = Math.max(...(computed.length ? computed : [threshold(x0, xi), 1]));
    return { x0, x1, y0: 0, y1: 1.12 * highest };
  }

  #computed() {
    return [...this.thresholds.up, ...this.thresholds.down].filter((value) => value !== null);
  }

  /** The Γ of the grid's edges that some threshold lies beyond. */
  #edges() {
    const { gamma } = this.grid;
    const statuses = new Set([...this.thresholds.up_status, ...this.thresholds.down_status]);
    return [statuses.has("below the grid") && gamma[0], statuses.has("above the grid") && gamma.at(-1)].filter(Boolean);
  }

  content() {
    const { x0, x1, y0, y1 } = this.visible();
    const { omega, xi, complete } = this.thresholds;
    return {
      x: { label: axisLabel("omega"), low: x0, high: x1, log: isLog(this.job.spec.omega) },
      y: { label: "threshold Γ", low: y0, high: y1 },
      title: `ξ = ${number(xi)}`,
      legend: this.#legend(),
      message: this.#message(complete),
      layers: [(ctx, box) => this.folds && drawFolds(ctx, box, this.folds), (ctx, box) => this.#draw(ctx, box)],
      cursor: (ctx, box) => this.current && verticalLine(ctx, box, box.x.pixel(omega[this.current.index]), box.theme.cursor),
    };
  }

  /** Why there is nothing to draw. */
  #message(complete) {
    if (this.#computed().length || this.#edges().length) return null;
    return complete ? "No threshold in this sweep" : "No bouncing cell is computed yet";
  }

  #draw(ctx, box) {
    const { omega, xi } = this.thresholds;
    const n = Math.round(box.width / 2);
    const curve = Array.from({ length: n + 1 }, (_, i) => {
      const x = box.left + (i * box.width) / n;
      return [x, box.y.pixel(threshold(box.x.value(x), xi))];
    });
    polyline(ctx, box.theme.threshold, 1.6, curve, DASH);
    for (const { key, direction } of this.#series()) {
      const colour = directionColour(direction, box.theme);
      drawSeries(ctx, box, omega, this.thresholds[key], colour, key);
      drawOpen(ctx, box, omega, this.thresholds[`${key}_status`], this.grid.gamma, colour, key);
    }
  }

  /** The computed series: their key in the response, name and direction. */
  #series() {
    const up = this.directions[0] === "rest" ? { key: "up", name: "from rest", direction: "rest" } : { key: "up", name: "ramp up", direction: "up" };
    return [up, { key: "down", name: "ramp down", direction: "down" }].filter(({ key }) => this.thresholds[`${key}_status`].some((status) => status !== "not ramped"));
  }

  #legend() {
    const line = (ctx, x, y, colour, width, dash) => polyline(ctx, colour, width, [[x, y], [x + 24, y]], dash);
    return [
      ["Eq. 25", (ctx, x, y, theme) => line(ctx, x, y, theme.threshold, 1.6, DASH)],
      ...(this.folds ? foldLegend() : []),
      ...this.#series().map(({ key, name, direction }) => [name, (ctx, x, y, theme) => {
        const colour = directionColour(direction, theme);
        line(ctx, x, y, colour, 1.2);
        drawMarker(ctx, [x + 12, y], 3.4, colour, key, theme.surface);
      }]),
      ...(this.#edges().length ? [["beyond the grid", (ctx, x, y, theme) => drawPointer(ctx, x + 12, y - 4, 1, theme.muted)]] : []),
      ...(this.#has(UNDECIDED) ? [["undecided", (ctx, x, y, theme) => drawCross(ctx, x + 12, y, theme.muted)]] : []),
    ];
  }

  #has(statuses) {
    return [...this.thresholds.up_status, ...this.thresholds.down_status].some((status) => statuses.has(status));
  }

  nearest(x, y) {
    return { index: nearestIndex(this.thresholds.omega, x), y };
  }

  step(current, right) {
    const n = this.thresholds.omega.length;
    return { index: current ? clampIndex(current.index + right, n) : n >> 1 };
  }

  at({ index, y }) {
    return [this.thresholds.omega[index], y];
  }

  describe({ index }) {
    const { omega, analytic } = this.thresholds;
    const parts = [`Ω = ${number(omega[index])}`, `Eq. 25: Γ = ${number(analytic[index], 4)}`];
    for (const { key, name } of this.#series()) {
      const value = this.thresholds[key][index];
      parts.push(`${name}: ${value === null ? REASONS[this.thresholds[`${key}_status`][index]](this.grid.gamma) : number(value, 4)}`);
    }
    return [...parts, ...this.#predictionText(index)].join(" · ");
  }

  /** Where the closed form says that bouncing ends and why, or why it does not, and why the sweep differs. */
  #predictionText(index) {
    const { predicted_down: down, cause, difference } = this.thresholds;
    if (!this.closedForm) return [];
    if (down[index] === null) return [`closed form: ${cause[index]}`];
    return [`closed form: bouncing ends at ${number(down[index], 6)} (${cause[index]})`, ...(difference[index] ? [difference[index]] : [])];
  }

  /** The cell at the pointer's height; from the keyboard, the one at the threshold. */
  cellOf({ index, y }) {
    const { omega, xi, up, down } = this.thresholds;
    const gamma = y ?? up[index] ?? down[index] ?? this.grid.gamma[0];
    const isNearerDown = down[index] !== null && Math.abs(down[index] - gamma) < Math.abs((up[index] ?? Infinity) - gamma);
    const direction = isNearerDown ? "down" : this.directions[0];
    return { gamma: this.grid.gamma[nearestIndex(this.grid.gamma, gamma)], omega: omega[index], xi, direction };
  }
}

/** Markers joined by lines, interrupted where values are missing. */
function drawSeries(ctx, box, omega, values, colour, key) {
  let run = [];
  const runs = [run];
  values.forEach((value, i) => {
    if (value === null) runs.push((run = []));
    else run.push([box.x.pixel(omega[i]), box.y.pixel(value)]);
  });
  const size = Math.min(3.4, Math.max(1.6, 260 / omega.length));
  for (const points of runs) {
    if (points.length > 1) polyline(ctx, colour, 1.2, points);
    for (const point of points) drawMarker(ctx, point, size, colour, key, box.theme.surface);
  }
}

/** A disc on the way up, a hollow square on the way down: distinct without colour too. */
function drawMarker(ctx, [x, y], size, colour, key, background) {
  if (key === "up") {
    disc(ctx, colour, x, y, size);
    return;
  }
  ctx.fillStyle = background;
  ctx.fillRect(x - size, y - size, 2 * size, 2 * size);
  polyline(ctx, colour, 1.6, [[x - size, y - size], [x + size, y - size], [x + size, y + size], [x - size, y + size], [x - size, y - size]]);
}

/** A triangle at the edge of the grid that points to where a threshold lies; a cross where a cell left it open. */
function drawOpen(ctx, box, omega, statuses, gamma, colour, key) {
  statuses.forEach((status, i) => {
    const x = box.x.pixel(omega[i]) + (key === "up" ? -BESIDE : BESIDE);
    if (UNDECIDED.has(status)) drawCross(ctx, x, box.top + box.height - 8, colour);
    else if (BEYOND[status]) drawPointer(ctx, x, box.y.pixel(BEYOND[status] > 0 ? gamma[0] : gamma.at(-1)), BEYOND[status], colour);
  });
}

/** Down where `sign` is 1. */
const drawPointer = (ctx, x, y, sign, colour) => polygon(ctx, colour, [[x - 4, y], [x + 4, y], [x, y + 9 * sign]]);

function drawCross(ctx, x, y, colour) {
  polyline(ctx, colour, 1.4, [[x - 3.5, y - 3.5], [x + 3.5, y + 3.5]]);
  polyline(ctx, colour, 1.4, [[x - 3.5, y + 3.5], [x + 3.5, y - 3.5]]);
}
