// Thresholds in Γ against Ω: where bouncing begins on the ramp up and ends on the ramp down, with Eq. 25.

import { partsOf, query } from "../lib/api.js";
import { number } from "../lib/format.js";
import { axisColumn, axisText, clampIndex, hasCycles, hasSpring, inSymbols, isClose, nearestIndex, ofOtherPlate, threshold } from "../lib/physics.js";
import { CURVE_DASH, disc, legendLine, polygon, polyline, verticalLine } from "../plot/drawing.js";
import { cellExtent } from "../plot/scale.js";
import { describeEvent, drawFolds, foldLegend, foldsOver, nearestCycle, overOmega } from "./closed-form.js";
import { sliders } from "./controls.js";
import { MeasuredPoints } from "./measured.js";
import { PlotView } from "./plot-view.js";
import { RESUMABLE } from "./progress.js";

const HINT = "Point at a frequency to read it, press to show a trajectory, drag or turn the wheel to zoom.";
const BESIDE = 4; // px from the frequency, of two directions: both may lie beyond the same edge
const BEYOND = { "below the grid": 1, "above the grid": -1 }; // where a triangle points: 1 down
const UNDECIDED = ["unresolved", "diverged", "settling"]; // statuses of a cell that decides

/** Cells are {row, y, fold}: what the service found at an Ω and, from the pointer, a Γ and the fold there. Numbers that are not there are NaN. */
export class Thresholds extends PlotView {
  name = "threshold";
  along = "omega";
  awaited = () => (this.overlay && !this.requested.includes("predict=none") ? "predictions" : "");
  folds = () => this.overlay?.at({ xi: this.xi });
  marks = () => [this.edges.length && "thresholds beyond the grid", this.isUndecided && "undecided ones"];

  constructor(root, view) {
    super(view);
    this.overlay = hasCycles(this.job) && this.grid.omega.length > 1 ? foldsOver(this) : null;
    this.measured = new MeasuredPoints(this, "gamma");
    this.build(root, { controls: sliders(this, ["xi"]), label: "Thresholds against the plate frequency", hint: HINT, shown: this.overlay ? [this.overlay.element] : [] });
  }

  /** Without what the closed form predicts, which takes longer, until the thresholds at this ξ are shown. */
  paths() {
    const isShown = this.isLoaded && isClose(this.xi, this.place.xi) && (this.complete || RESUMABLE.has(this.job.state));
    return [this.#path({ predict: this.overlay && isShown ? null : "none" })];
  }

  #path = (parameters) => `/v1/jobs/${this.job.id}/threshold?${query({ xi: this.place.xi, ...parameters })}`;

  filePath = () => this.#path({ ...this.windowOn("omega", "gamma"), predict: this.folds() ? null : "none" });

  read([result]) {
    this.rows = partsOf(result, "omega");
    [this.omega, this.xi, this.complete] = [result.omega.data, result.xi.data, result.attrs.complete];
    this.series = [
      { ...(this.directions[0] === "rest" ? { name: "from rest", direction: "rest" } : { name: "ramp up", direction: "up" }), way: "up" },
      { name: "ramp down", direction: "down", way: "down" },
    ].filter(({ way }) => this.rows.some((row) => row[`${way}_status`] !== "not ramped"));
    const { gamma } = this.grid;
    const statuses = new Set(this.rows.flatMap((row) => [row.up_status, row.down_status]));
    this.isUndecided = UNDECIDED.some((status) => statuses.has(status));
    this.edges = [...(statuses.has("below the grid") ? [gamma[0]] : []), ...(statuses.has("above the grid") ? [gamma.at(-1)] : [])];
    this.computedThresholds = this.rows.flatMap(({ up, down }) => [up, down]).filter(Number.isFinite);
    this.overlay?.update();
  }

  whole() {
    const [x0, x1] = cellExtent(this.omega);
    const drawn = [...this.computedThresholds, ...this.rows.map(({ analytic }) => Math.min(analytic, this.grid.gamma.at(-1))), ...this.edges, ...this.measured.valuesIn(x0, x1)].filter(Number.isFinite);
    const [low, high] = drawn.length ? [Math.min(...drawn), Math.max(...drawn)] : [0, 1];
    return { x0, x1, y0: Math.max(0, low - 0.12 * high), y1: 1.12 * high || 1 };
  }

  content() {
    const isEmpty = !this.computedThresholds.length && !this.edges.length;
    const reason = this.complete ? "No threshold in this sweep" : "No bouncing cell is computed yet";
    return {
      ...this.scales(this.axisOf("omega"), { label: "threshold Γ" }),
      title: this.textOf({ xi: this.xi }),
      legend: this.#legend(),
      message: isEmpty ? reason : null,
      layers: [(ctx, box) => this.folds() && drawFolds(ctx, box, this.folds()), (ctx, box) => this.#draw(ctx, box), (ctx, box) => this.measured.draw(ctx, box)],
    };
  }

  drawCursor(ctx, box) {
    if (this.current) verticalLine(ctx, box, box.x.pixel(this.current.row.omega), box.theme.cursor);
  }

  #draw(ctx, box) {
    const xs = Array.from({ length: box.width / 2 + 2 }, (_, i) => box.left + 2 * i);
    const curve = xs.map((x) => [x, box.y.pixel(threshold(box.x.value(x), this.xi))]);
    if (hasSpring(this.job)) polyline(ctx, box.theme.threshold, 1.6, curve, CURVE_DASH);
    const edges = { 1: box.y.pixel(this.grid.gamma[0]), [-1]: box.y.pixel(this.grid.gamma.at(-1)) };
    for (const { direction, way } of this.series) {
      const colour = box.theme[direction];
      const points = this.rows.map(({ omega, [way]: value }) => (Number.isFinite(value) ? [box.x.pixel(omega), box.y.pixel(value)] : null));
      const size = Math.min(3.4, Math.max(1.6, 260 / points.length));
      polyline(ctx, colour, 1.2, points);
      for (const point of points.filter(Boolean)) drawMarker(ctx, point, size, colour, direction, box.theme.surface);
      const aside = direction === "down" ? BESIDE : -BESIDE;
      this.rows.forEach(({ omega, [`${way}_status`]: status }) => {
        const x = box.x.pixel(omega) + (this.series.length > 1 ? aside : 0);
        if (UNDECIDED.includes(status)) drawCross(ctx, x, box.top + box.height - 8, colour);
        else if (BEYOND[status]) drawTriangle(ctx, x, edges[BEYOND[status]], BEYOND[status], colour);
      });
    }
  }

  #legend() {
    const beyond = this.edges[0] === this.grid.gamma[0] ? 1 : -1;
    const triangle = (ctx, x, y, theme) => drawTriangle(ctx, x + 12, y - 4 * beyond, beyond, theme[this.series[0].direction]);
    return [
      ...(hasSpring(this.job) ? [["Eq. 25", (ctx, x, y, theme) => legendLine(ctx, theme.threshold, 1.6, x, y, CURVE_DASH)]] : []),
      ...(this.folds() ? foldLegend(ofOtherPlate(this.job)) : []),
      ...this.series.map(({ name, direction }) => [name, (ctx, x, y, theme) => {
        legendLine(ctx, theme[direction], 1.2, x, y);
        drawMarker(ctx, [x + 12, y], 3.4, theme[direction], direction, theme.surface);
      }]),
      ...(this.edges.length ? [["beyond the grid", triangle]] : []),
      ...(this.isUndecided ? [["undecided", (ctx, x, y, theme) => drawCross(ctx, x + 12, y, theme.muted)]] : []),
    ];
  }

  computed = () => (x) => this.series.map(({ way }) => this.nearest(x).row[way]).filter(Number.isFinite);

  nearest(x, y) {
    const fold = this.folds() && this.plot.box && nearestCycle(this.folds(), this.plot.box, x, y, overOmega);
    return { row: this.rows[nearestIndex(this.omega, x)], y, fold };
  }

  step(current, right) {
    const n = this.rows.length;
    return { row: this.rows[current ? clampIndex(this.rows.indexOf(current.row) + right, n) : n >> 1] };
  }

  at = ({ row, y }) => [row.omega, y];

  describe = (cell) => `${cell.fold ? `${describeEvent(cell.fold)} · Ω = ${number(cell.fold.omega, 7)}; ` : ""}${super.describe(cell)}`;

  cellsShown = () => this.rows.filter(({ omega }) => this.isVisible(omega)).map((row) => ({ row }));

  columnsOfTable() {
    const gammaText = (gamma) => axisText(gamma, this.grid.gamma);
    const value = (title, name, text, otherwise = () => "") => [title, ({ row }, whole) => (Number.isFinite(row[name]) ? (whole ? String : text)(row[name]) : otherwise(row))];
    const text = (name, isLong) => [name, ({ row }) => inSymbols(row[name] ?? ""), isLong];
    return [axisColumn("Ω", this.grid.omega, ({ row }) => row.omega), ...this.common({ xi: this.xi }), value("Eq. 25", "analytic", gammaText),
      ...this.series.map(({ name, way }) => value(name, way, gammaText, (row) => row[`${way}_status`])),
      // Where the closed form says that bouncing ends, and why the sweep differs; not while that is asked for.
      ...(this.overlay && this.rows[0].cause !== "not predicted" ? [value("closed form", "predicted_down", (gamma) => number(gamma, 6)), text("cause"), text("reason", true), text("difference", true)] : [])];
  }

  /** The cell at the pointer's height; from the keyboard, the one at the threshold. */
  cellOf({ row: { omega, up, down }, y }) {
    const gamma = [y, up, down].find(Number.isFinite) ?? this.grid.gamma[0];
    const isNearerDown = Number.isFinite(down) && !(Math.abs(up - gamma) <= Math.abs(down - gamma));
    const direction = isNearerDown ? "down" : this.directions[0];
    return { gamma: this.grid.gamma[nearestIndex(this.grid.gamma, gamma)], omega, xi: this.xi, direction };
  }
}

/** A disc on the way up, a hollow square on the way down: distinct without colour too. */
function drawMarker(ctx, [x, y], size, colour, direction, background) {
  if (direction !== "down") return disc(ctx, colour, x, y, size);
  const square = [[x - size, y - size], [x + size, y - size], [x + size, y + size], [x - size, y + size], [x - size, y - size]];
  polygon(ctx, background, square);
  polyline(ctx, colour, 1.6, square);
}

/** At the edge of the grid, towards where a threshold lies: down where `sign` is 1. */
const drawTriangle = (ctx, x, y, sign, colour) => polygon(ctx, colour, [[x - 4, y], [x + 4, y], [x, y + 9 * sign]]);
const drawCross = (ctx, x, y, colour) => polyline(ctx, colour, 1.4, [[x - 3.5, y - 3.5], [x + 3.5, y + 3.5], null, [x - 3.5, y + 3.5], [x + 3.5, y - 3.5]]);
