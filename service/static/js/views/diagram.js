// The bifurcation diagram: flight times along one axis, the other axes fixed by sliders, both ramps in one plot.

import { addressValue, setQuery } from "../lib/address.js";
import { query, requestBlob } from "../lib/api.js";
import { cycleName, hasCycles } from "../lib/cycles.js";
import { debounced, gestures, h } from "../lib/dom.js";
import { AXES, TWO_PI, axisLabel, clampIndex, initialValue, isClose, isLog, nearestIndex } from "../lib/physics.js";
import { directionColour } from "../plot/colours.js";
import { pixelRatio } from "../plot/drawing.js";
import { drawFlights } from "../plot/flights.js";
import { extent } from "../plot/scale.js";
import { ClosedFormBox, branchLegend, describeCycle, drawBranches, drawCycle, nearestCycle, requestBranches } from "./closed-form.js";
import { diagramControls, minFlightOf } from "./controls.js";
import { describeCell, drawCurrent, drawSelected, drawThreshold, emptyMessage, flightTable, headings } from "./diagram-content.js";
import { flightsOf, requestLine } from "./line-data.js";
import { PlotView } from "./plot-view.js";

const MAX_POINTS = 250_000; // flights sent as points; longer lines are sent as density
const PREFETCH_STEPS = [1, 2, 3, -1]; // in the direction of the slider's last move
const BEYOND = 2; // branches are requested up to this many times the highest Γ, so that none ends within the plot
const HINT = "Point at a cell to read it, click to show its trajectory, drag to zoom, double-click to reset the zoom.";

/** Cells are {line, cell}: a line of `lines` and an index into its values; or cycles, {branch, point}. */
export class Diagram extends PlotView {
  lines = null; // one per shown direction; null before the first are loaded
  lastMove = null; // of a slider: {axis, sign}
  cycles = null; // the branches over the diagram; null where they are not shown

  constructor(root, view) {
    super(view);
    const { grid, directions, initial } = this;
    this.axes = AXES.filter((axis) => grid[axis].length > 1);
    this.along = this.axes.includes(initial.along) ? initial.along : longestAxis(grid);
    this.fixed = Object.fromEntries(AXES.map((axis) => [axis, initialValue(grid[axis], initial[axis])]));
    this.minFlight = minFlightOf(initial, this.job);
    this.shownDirections = directions.filter((direction) => !initial.show || initial.show.split(",").includes(direction));
    this.prefetch = debounced(40, () => this.#prefetch());
    this.closedForm = hasCycles(this.job) && new ClosedFormBox("Branches", initial.branches === "1", (checked) => {
      setQuery({ branches: checked ? 1 : null });
      this.load();
    });
    this.controls = h("div", {});
    this.#buildControls();
    this.build(root, { controls: this.controls, label: "Bifurcation diagram", hint: HINT });
  }

  get name() {
    return `${this.along}-phi`;
  }

  close() {
    super.close();
    this.prefetch.cancel();
    this.prefetching?.abort();
  }

  #buildControls() {
    this.controls.replaceChildren(diagramControls(this, {
      axis: (along) => {
        const cell = this.lines && this.#selectedOnLines();
        if (cell) this.fixed[this.along] = cell[this.along]; // the other diagram goes through the same cell
        Object.assign(this, { along, lines: null, current: null, lastMove: null });
        setQuery({ along });
        this.#buildControls();
        this.zoom(null);
        this.load();
      },
      move: (axis, value) => {
        this.lastMove = { axis, sign: Math.sign(value - this.fixed[axis]) || 1 };
        this.fixed[axis] = value;
        setQuery({ [axis]: addressValue(value) });
        this.load();
      },
      directions: (directions) => {
        this.shownDirections = directions;
        setQuery({ show: directions.length === this.directions.length ? null : directions.join() || "none" });
        this.load();
      },
      minFlight: (minFlight) => {
        this.minFlight = minFlight;
        setQuery({ min: minFlight === this.job.spec.micro_flight ? null : minFlight });
        this.load();
      },
    }));
    if (this.closedForm && this.along === "gamma") this.controls.firstChild.append(this.closedForm.element);
  }

  /** The query of a line except for its direction. */
  #parameters(fixed = this.fixed) {
    const others = Object.fromEntries(Object.entries(fixed).filter(([axis]) => axis !== this.along));
    return { along: this.along, ...others, min_flight: this.minFlight };
  }

  /** The lines of all shown directions at `fixed`; if they come as density, counted over `window`. */
  #requestLines(fixed, window, options) {
    const { x0: left, x1: right, y0: bottom, y1: top } = window ?? {};
    const { clientWidth, clientHeight } = this.plot.element;
    const parameters = {
      ...this.#parameters(fixed), most: MAX_POINTS, log: isLog(this.job.spec[this.along]) || null, left, right, bottom, top,
      width: Math.min(2000, Math.max(200, Math.round((clientWidth - 92) * pixelRatio()))), // without the margins
      height: Math.min(1000, Math.max(200, Math.round((clientHeight - 80) * pixelRatio()))),
    };
    return Promise.all(this.shownDirections.map((direction) => requestLine(this.job, { ...parameters, direction }, window, options)));
  }

  async request(signal) {
    this.prefetch.cancel();
    this.prefetching?.abort();
    const { along } = this;
    const window = this.#isDense() ? this.window : null;
    const [lines, cycles] = await Promise.all([this.#requestLines(this.fixed, window, { signal }), this.#requestCycles(signal)]);
    if (along !== this.along) throw new DOMException("the axis was changed", "AbortError");
    Object.assign(this, { lines, cycles });
    this.current = this.current?.line && lines.length ? this.#cell(lines[0], this.current.cell) : null;
    if (this.window && !window && this.#isDense()) return this.request(signal); // the density was counted over everything
    if (this.lastMove && this.job.state === "done") this.prefetch();
    return { along, ...lines[0]?.fixed };
  }

  /** The branches at the fixed values, if they are to be shown; a spring may have none. */
  async #requestCycles(signal) {
    if (!this.closedForm?.checked || this.along !== "gamma") return null;
    try {
      const cycles = await requestBranches(this.fixed, BEYOND * this.grid.gamma.at(-1), { signal });
      this.closedForm.note.textContent = "";
      return cycles;
    } catch (error) {
      if (!error.status || error.status === 401) throw error;
      this.closedForm.note.textContent = error.message;
      return null;
    }
  }

  /** Request the lines that the slider is likely to reach next. */
  async #prefetch() {
    const { axis, sign } = this.lastMove;
    const values = this.grid[axis];
    const index = nearestIndex(values, this.fixed[axis]);
    const window = this.#isDense() ? this.window : null;
    this.prefetching = new AbortController();
    try {
      for (const step of PREFETCH_STEPS) {
        const value = values[clampIndex(index + sign * step, values.length)];
        await this.#requestLines({ ...this.fixed, [axis]: value }, window, { signal: this.prefetching.signal, priority: "low" });
      }
    } catch {
      // Not shown: if the slider gets there, the line is requested again and its error reported.
    }
  }

  #isDense() {
    return Boolean(this.lines?.some((line) => line.arrays.density));
  }

  whole() {
    const values = this.grid[this.along];
    const flights = Math.max(...this.lines.map((line) => line.highest), 0) || TWO_PI;
    const highest = this.cycles ? Math.max(flights, TWO_PI) : flights;
    const [x0, x1] = extent(values[0], values[values.length - 1]);
    return { x0, x1, y0: 0, y1: 1.06 * highest };
  }

  zoom(window) {
    super.zoom(window);
    if (this.#isDense()) this.load();
  }

  content() {
    if (!this.lines) return null;
    const { x0, x1, y0, y1 } = this.visible();
    const { lines, cycles } = this;
    const { title, legend = [] } = lines.length ? headings(lines, (direction, theme) => this.#colour(direction, theme)) : {};
    return {
      title,
      legend: [...legend, ...(cycles ? branchLegend() : [])],
      x: { label: axisLabel(this.along), low: x0, high: x1, log: isLog(this.job.spec[this.along]) },
      y: { label: "flight time φ (rad)", low: y0, high: y1, periods: true },
      message: emptyMessage(lines),
      layers: [
        (ctx, box) => this.along === "gamma" && lines.length && drawThreshold(ctx, box, lines[0].fixed),
        (ctx, box) => drawFlights(ctx, box, lines, ({ direction }) => this.#colour(direction, box.theme)),
        (ctx, box) => cycles && drawBranches(ctx, box, cycles),
      ],
      cursor: (ctx, box) => {
        const cell = this.#selectedOnLines();
        if (cell) drawSelected(ctx, box, cell[this.along], this.#colour(cell.direction, box.theme));
        if (this.current?.branch) drawCycle(ctx, box, this.current);
        else if (this.current) drawCurrent(ctx, box, this.current);
      },
    };
  }

  /** A sweep of one direction is drawn in black, as in the paper. */
  #colour(direction, theme) {
    return directionColour(this.directions.length > 1 ? direction : "rest", theme);
  }

  /** The selected cell if it lies on a shown line. */
  #selectedOnLines() {
    const cell = this.selected();
    const contains = ({ direction, fixed }) => direction === cell.direction && Object.entries(fixed).every(([axis, value]) => isClose(value, cell[axis]));
    return cell && this.lines.some(contains) ? cell : null;
  }

  #cell(line, cell) {
    return { line, cell: clampIndex(cell, line.arrays.values.length) };
  }

  /** The cycle next to (x, y), or the cell at x; of several directions, the one with a flight nearest to y. */
  nearest(x, y) {
    const cycle = this.cycles && nearestCycle(this.cycles, this.plot.box, x, y);
    if (cycle) return cycle;
    const distance = ({ line, cell }) => Math.min(...(flightsOf(line, cell) ?? []).map((time) => Math.abs(time - y)), 1e9);
    const cells = (this.lines ?? []).map((line) => this.#cell(line, nearestIndex(line.arrays.values, x)));
    return cells.sort((a, b) => distance(a) - distance(b))[0] ?? null;
  }

  /** Up and down switch between the directions. */
  step(current, right, up) {
    if (!this.lines?.length) return null;
    if (!current?.line) return this.#cell(this.lines[0], this.lines[0].arrays.values.length >> 1);
    return this.#cell(up ? (this.lines.find((line) => line !== current.line) ?? current.line) : current.line, current.cell + right);
  }

  centre() {
    return this.current?.branch ? this.current.branch.gamma[this.current.point] : this.current?.line.arrays.values[this.current.cell];
  }

  cellOf({ line, cell, branch, point }) {
    if (branch) return { ...this.fixed, gamma: branch.gamma[point], direction: cycleName({ branch, point }) };
    return { ...line.fixed, [this.along]: line.arrays.values[cell], direction: line.direction };
  }

  describe(cell) {
    if (cell.branch) return gestures(`${describeCycle(cell)} · click to see it move`);
    return describeCell(cell, this.along, this.lines.length > 1);
  }

  /** The service's picture of the line, which shows all of it. */
  pdf(caption) {
    const [direction] = this.shownDirections.length === 1 ? this.shownDirections : [null];
    return requestBlob(`/v1/jobs/${this.job.id}/diagram?${query({ ...this.#parameters(), direction, caption, format: "pdf" })}`);
  }

  /** The flights in view; of a density, all flights from the service. */
  table() {
    if (this.#isDense()) return requestBlob(`/v1/jobs/${this.job.id}/diagram?${query({ ...this.#parameters(), format: "csv" })}`);
    return flightTable(this.lines, this.along, this.visible());
  }
}

/** The axis with most values; of equal ones, the first. */
function longestAxis(grid) {
  return AXES.reduce((longest, axis) => (grid[axis].length > grid[longest].length ? axis : longest));
}
