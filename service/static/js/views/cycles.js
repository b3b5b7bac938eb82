// Cycles of one bounce over Γ: their branches, stable and unstable, and a table of their events.

import { query } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { fileName } from "../lib/downloads.js";
import { number } from "../lib/format.js";
import { axisLabel, clamp, startName, threshold } from "../lib/physics.js";
import { PagedTable } from "../lib/table.js";
import { verticalLine } from "../plot/drawing.js";
import { branchLegend, cyclesAt, describeCycle, drawBranches, drawCycle, eventName, nearestCycle, readBranches } from "./closed-form.js";
import { sliders } from "./controls.js";
import { drawThreshold } from "./diagram.js";
import { FLIGHT_AXIS, PlotView } from "./plot-view.js";

const STEP = 0.01; // of Γ, by an arrow key
const HINT = "Cycles of one bounce. Point at a branch to read it, press to see the cycle move, drag or turn the wheel to zoom.";

/** A view of branches {branches, events} at one Ω and ξ. Cells are {gamma}, and on a branch {gamma, branch, point}. */
export class CyclesView extends PlotView {
  name = "cycles";

  build(root, parts) {
    this.events = new PagedTable("Folds, flips and grazes", () => this.#events(), () => fileName(this.job, "events", "csv"), true);
    super.build(root, { label: "Flight times of the cycles over Γ", tables: [this.events.element], ...parts });
  }

  read([result]) {
    this.branches = readBranches(result);
    [this.omega, this.xi, this.maxGamma] = [result.omega.data, result.xi.data, result.attrs.gamma_max];
    this.events.update();
  }

  #events() {
    const columns = [["event", ({ kind }) => eventName(kind)], ["cycle", ({ bounces, periods }) => `(${bounces}, ${periods})`],
      ["Γ", ({ gamma }) => number(gamma, 7)], ["φ (rad)", ({ flight_time: time }) => number(time, 6)]];
    return [columns, (this.branches?.events ?? []).filter(({ violations }) => violations === 0).sort((a, b) => a.gamma - b.gamma)];
  }

  /** The flight of a cycle (1, k) is hardly longer than k plate periods. */
  whole() {
    const longest = Math.max(1, ...this.branches.branches.map(({ periods }) => periods));
    return { x0: 0, x1: this.maxGamma, y0: 0, y1: 2.2 * Math.PI * longest };
  }

  content() {
    const { omega, xi } = this;
    return {
      ...this.scales({ label: axisLabel("gamma") }, FLIGHT_AXIS),
      title: `Ω = ${number(omega)},   ξ = ${number(xi)}`,
      legend: branchLegend(),
      message: this.branches.branches.length ? null : "No cycles here",
      layers: [(ctx, box) => drawThreshold(ctx, box, this.restEnds ?? threshold(omega, xi)), (ctx, box) => drawBranches(ctx, box, this.branches)],
      cursor: (ctx, box) => {
        if (this.current?.branch) drawCycle(ctx, box, this.current);
        else if (this.current) verticalLine(ctx, box, box.x.pixel(this.current.gamma), box.theme.muted, 1, [2, 3]);
      },
    };
  }

  nearest(x, y) {
    const cycle = this.plot.box && nearestCycle(this.branches, this.plot.box, x, y);
    return cycle ? { ...cycle, gamma: cycle.branch.gamma[cycle.point] } : { gamma: Number(x.toPrecision(4)) };
  }

  cellsShown() {
    return this.branches.branches.flatMap((branch) => Array.from(branch.gamma, (gamma, point) => ({ gamma, branch, point }))).filter(({ gamma, branch, point }) => !branch.violations[point] && this.isVisible(gamma, branch.flight_time[point]));
  }

  columnsOfTable() {
    return [["Γ", ({ gamma }) => number(gamma)], ["cycle", ({ branch }) => `(${branch.bounces}, ${branch.periods})`],
      ["φ (rad)", ({ branch, point }) => number(branch.flight_time[point])], ["stability", ({ branch, point }) => (branch.stable[point] ? "stable" : "unstable")]];
  }

  /** Up and down go through the cycles at this Γ; to the sides, the nearest cycle follows. */
  step(current, right, up) {
    const from = current?.gamma ?? this.place.gamma ?? this.maxGamma / 2;
    const gamma = clamp(from + STEP * right, STEP, this.maxGamma);
    const cycles = cyclesAt(this.branches, gamma);
    const time = current?.branch?.flight_time[current.point] ?? 0;
    const away = ({ branch, point }) => Math.abs(branch.flight_time[point] - time);
    const at = cycles.indexOf(cycles.toSorted((a, b) => away(a) - away(b))[0]);
    return { gamma, ...(current?.branch || up ? cycles[clamp(at + (current?.branch ? Math.sign(up) : 0), 0, cycles.length - 1)] : null) };
  }

  at({ gamma, branch, point }) {
    return [gamma, branch?.flight_time[point]];
  }

  describe(cell) {
    return cell.branch ? describeCycle(cell) : `Γ = ${number(cell.gamma)}`;
  }

  cellOf({ branch, point }) {
    return branch ? { ...this.place, gamma: branch.gamma[point], direction: startName("cycle", branch.periods, branch.flight_time[point]) } : null;
  }
}

/** The branches of a study of cycles. */
export class Orbits extends CyclesView {
  constructor(root, view) {
    super(view);
    this.build(root, { controls: h("div", { className: "controls" }, sliders(this, ["omega", "xi"])), hint: HINT });
  }

  filePath() {
    return `/v1/jobs/${this.job.id}/orbits?${query(this.place)}`;
  }
}
