// Cycles of one bounce over Γ: their branches, stable and unstable, and a table of their events.

import { query } from "../lib/api.js";
import { exact, number } from "../lib/format.js";
import { AXIS_LABEL, clamp, threshold } from "../lib/physics.js";
import { verticalLine } from "../plot/drawing.js";
import { branchLegend, cyclesAt, describeCycle, drawBranches, drawCycle, eventName, nearestCycle, readBranches, startOn } from "./closed-form.js";
import { sliders } from "./controls.js";
import { drawThreshold } from "./diagram.js";
import { FLIGHT_AXIS, PlotView } from "./plot-view.js";

const STEP = 0.01; // of Γ, by an arrow key

/** The branches of a study of cycles at one Ω and ξ: {branches, events}. Cells are {gamma}, and on a branch cycles. */
export class Cycles extends PlotView {
  name = "cycles";

  constructor(root, view, hint = "Cycles of one bounce. Point at a branch to read it, press to see the cycle move, drag or turn the wheel to zoom.") {
    super(view);
    const events = () => [[["event", ({ kind }) => eventName(kind)], ...this.#columns(7, 6)], this.branches.events.filter(({ violations }) => violations === 0).sort((a, b) => a.gamma - b.gamma)];
    this.build(root, { controls: this.controls(), label: "Flight times of the cycles over Γ", hint, events: ["Folds, flips and grazes", events] });
  }

  controls() {
    return sliders(this, ["omega", "xi"]);
  }

  filePath() {
    return `/v1/jobs/${this.job.id}/orbits?${query(this.place)}`;
  }

  read([result]) {
    [this.branches, this.isComplete] = [readBranches(result), result.attrs.complete];
    [this.spring, this.maxGamma, this.contact] = [{ omega: result.omega.data, xi: result.xi.data }, result.attrs.gamma_max, result.attrs.model];
  }

  /** The flight of a cycle (1, k) is hardly longer than k plate periods. */
  whole() {
    const longest = Math.max(1, ...this.branches.branches.map(([{ periods }]) => periods));
    return { x0: 0, x1: this.maxGamma, y0: 0, y1: 2.2 * Math.PI * longest };
  }

  content() {
    return {
      ...this.scales({ label: AXIS_LABEL.gamma }, FLIGHT_AXIS),
      title: `${this.textOf(this.spring)},   ${this.contact}`,
      legend: branchLegend(),
      message: this.branches.branches.length ? null : this.isComplete ? "No cycles here" : "Not computed yet",
      layers: [(ctx, box) => drawThreshold(ctx, box, this.restEnds ?? threshold(this.spring.omega, this.spring.xi)), (ctx, box) => drawBranches(ctx, box, this.branches)],
    };
  }

  drawCursor(ctx, box) {
    if (this.current?.periods) drawCycle(ctx, box, this.current);
    else if (this.current) verticalLine(ctx, box, box.x.pixel(this.current.gamma), box.theme.muted, 1, [2, 3]);
  }

  nearest(x, y) {
    return (this.plot.box && nearestCycle(this.branches, this.plot.box, x, y)) ?? { gamma: Number(x.toPrecision(4)) };
  }

  cellsShown = () => this.branches.branches.flat().filter(({ gamma, flight_time: time, violations }) => !violations && this.isVisible(gamma, time));

  #columns(...digits) {
    return [["Γ", ({ gamma }, whole) => exact(gamma, whole, digits[0])], ...this.common(this.spring), ["contact", () => this.contact, true],
      ["cycle", ({ bounces, periods }) => `(${bounces}, ${periods})`], ["φ (rad)", ({ flight_time: time }, whole) => exact(time, whole, digits[1])]];
  }

  columnsOfTable() {
    return [...this.#columns(), ["stability", ({ stable }) => (stable ? "stable" : "unstable")]];
  }

  /** Up and down go through the cycles at this Γ; to the sides, the nearest other cycle follows. */
  step(current, right, up) {
    const from = current?.sought ?? current?.gamma ?? this.place.gamma ?? this.maxGamma / 2;
    const cycleAt = (gamma) => {
      const cycles = cyclesAt(this.branches, gamma);
      const distances = cycles.map(({ flight_time: time }) => Math.abs(time - (current?.flight_time ?? 0)));
      const next = distances.indexOf(Math.min(...distances)) + (current?.periods ? Math.sign(up) : 0);
      return { gamma, ...cycles[clamp(next, 0, cycles.length - 1)], sought: gamma };
    };
    const next = clamp(from + STEP * right, STEP, this.maxGamma);
    const points = this.branches.branches.flat().filter(({ gamma, violations }) => !violations && (gamma - next) * right > 0).map(({ gamma }) => gamma).sort((a, b) => (a - b) * right);
    const isOther = ({ periods, gamma, flight_time: time }) => periods && (gamma !== current?.gamma || time !== current.flight_time);
    return cycleAt([next, ...points].find((gamma) => isOther(cycleAt(gamma))) ?? next);
  }

  at = ({ gamma, flight_time: time }) => [gamma, time];

  describe = (cell) => `${cell.periods ? describeCycle(cell) : `Γ = ${number(cell.gamma)}`} · ${this.textOf(this.spring)}`;

  cellOf(cell) {
    return cell.periods ? startOn(this.place, cell) : null;
  }
}
