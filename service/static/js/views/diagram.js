// The bifurcation diagram: flight times along one axis, the other axes fixed by sliders; both ramps, or several sweeps, in one plot.

import { currentQuery, setQuery, windowQuery } from "../lib/address.js";
import { partsOf, query } from "../lib/api.js";
import { checkBox, choice, h } from "../lib/dom.js";
import { AXES, OUTCOME, SYMBOL, TWO_PI, axisColumn, cellColumns, clampIndex, exponentOf, hasCycles, hasSpring, isClose, nearestIndex, ofOtherPlate, threshold } from "../lib/physics.js";
import { numberedColour, modeClasses, modeColour, theme } from "../plot/colours.js";
import { disc, polygon, polyline, verticalLine } from "../plot/drawing.js";
import { distinctFlights, drawFlights, flightsIn, flightsText, markCell } from "../plot/flights.js";
import { Plot } from "../plot/plot.js";
import { cellExtent } from "../plot/scale.js";
import { branchLegend, branchesOver, describeCycle, drawBranches, drawCycle, nearestCycle, startOn } from "./closed-form.js";
import { ClassLegend, swatch } from "./cells.js";
import { minFlightInput, minFlightOf, sliders } from "./controls.js";
import { MeasuredPoints } from "./measured.js";
import { FLIGHT_AXIS, PlotView } from "./plot-view.js";
import { shortTitleOf, titleOf } from "./progress.js";

const HINT = "Point at a cell to read it, press to show its trajectory, drag or turn the wheel to zoom.";
const MAX_CIRCLES = 200;
const STRIP = 8; // px, of the modes of a line

/** Cells are {line, cell, source}: a line of `lines`, an index into its values, and its source; or cycles. */
export class Diagram extends PlotView {
  lines = []; // one per source and shown direction

  constructor(root, view) {
    super(view);
    this.axes = AXES.filter((axis) => this.grid[axis].length > 1);
    this.overlay = !this.isCompared && hasCycles(this.job) ? branchesOver(this) : null;
    this.measured = this.isCompared || this.isBeside ? null : new MeasuredPoints(this, "flight_time");
    this.caption = checkBox("SVG and PDF with a caption", { checked: true, "data-service": true });
    this.legend = new ClassLegend(this, "Modes: (bounces, plate periods)");
    const diagrams = this.axes.map((axis) => [axis, `${SYMBOL[axis]}–φ`]);
    const setAxis = (along) => setQuery({ along, ...windowQuery(null) });
    const axis = choice("Diagram", diagrams, this.along, setAxis, { "aria-label": "Axis of the diagram", "data-service": true });
    const controls = [this.axes.length > 1 && !this.isFollower && axis, sliders(this, AXES)];
    const options = h("div", { className: "controls" },
      this.directions.length > 1 && !this.isCompared && choice("Ramp", [["", "both"], ...this.directions], currentQuery().show, (show) => setQuery({ show: show || null })),
      this.overlay?.element,
      !this.isCompared && !this.isFollower && minFlightInput(this.job));
    const ofSweep = { shown: [options, this.legend.element], below: [this.caption], label: `Bifurcation diagram of ${titleOf(this.job)}` };
    this.build(root, { controls, hint: HINT, ...(this.isCompared ? { shown: [options], label: "Bifurcation diagrams" } : ofSweep) });
    if (!this.job.spec.exponents || this.isCompared) return;
    const content = () => (this.isLoaded && this.plot.box ? this.#exponents() : null);
    this.exponents = new Plot(this.plot.element.parentElement, { signal: this.signal, takesInput: false, label: "Largest Lyapunov exponent", content });
    this.plot.element.addEventListener("drawn", () => this.exponents.draw());
  }

  /** The largest Lyapunov exponent on the axis of the diagram, below it. */
  #exponents() {
    const { left, width, x } = this.plot.box;
    const points = this.cellsShown().map(({ line, cell }) => ({ line, value: line.values[cell], exponent: exponentOf(line, cell) })).filter(({ exponent }) => Number.isFinite(exponent));
    const [low, high] = points.reduce(([least, most], { exponent }) => [Math.min(least, exponent), Math.max(most, exponent)], [0, 0]);
    const margin = 0.08 * (high - low) || 0.1;
    return {
      margins: [left, this.plot.element.clientWidth - left - width],
      x: { label: "", low: x.low, high: x.high, log: x.log },
      title: "λ₁ per plate period",
      y: { label: "λ₁", isTitled: true, low: low - margin, high: high + margin },
      layers: [
        (ctx, box) => polyline(ctx, box.theme.border, 1, [[box.left, box.y.pixel(0)], [box.left + box.width, box.y.pixel(0)]]),
        (ctx, box) => points.forEach(({ line, value, exponent }) => disc(ctx, this.#colour(line, box.theme), box.x.pixel(value), box.y.pixel(exponent), 1.4)),
      ],
    };
  }

  get name() {
    return `${this.along}-phi`;
  }

  /** The axis of the diagram: of the address, or the one with most values. */
  get along() {
    if (this.isBeside) return "gamma";
    const { along } = currentQuery();
    return this.axes.includes(along) ? along : AXES.reduce((longest, axis) => (this.grid[axis].length > this.grid[longest].length ? axis : longest));
  }

  get windowed() {
    return [this.along];
  }

  get window() {
    const window = super.window;
    return this.isBeside && window ? { ...this.whole(), x0: window.x0, x1: window.x1 } : window;
  }

  #shownOf({ directions }) {
    const { show } = currentQuery();
    return directions.includes(show) ? [show] : directions;
  }

  #path(source, parameters) {
    const { along, place } = this;
    const fixed = AXES.filter((axis) => axis !== along).map((axis) => [axis, source.grid[axis][nearestIndex(source.grid[axis], place[axis])]]);
    const shown = this.#shownOf(source);
    const direction = shown.length < source.directions.length ? shown[0] : null;
    return `/v1/jobs/${source.job.id}/diagram?${query({ along, ...Object.fromEntries(fixed), direction, min_flight: minFlightOf(source.job), ...parameters })}`;
  }

  /** The whole lines; where they have more cells than are sent, the zoomed window in more detail. */
  paths() {
    const { x0: start, x1: stop } = (this.isThinned && this.window) || {};
    return this.sources.map((source) => this.#path(source, { start, stop }));
  }

  /** What is shown: the window, without the flights of hidden modes. */
  filePath(source, format) {
    const { x0: start, x1: stop, y0, y1 } = this.window ?? {};
    const of = { hide: this.isCompared ? null : this.legend.query, caption: this.caption.control.checked ? null : false };
    const branches = this.cycles && format !== "csv" ? true : null;
    return this.#path(source, { start, stop, flight_start: y0, flight_stop: y1, log: this.log, branches, ...of });
  }

  read(results) {
    this.lines = results.flatMap((result) => {
      const source = this.sources.find(({ job }) => job.id === result.attrs.job);
      return linesOf(source, result).filter(({ direction }) => this.#shownOf(source).includes(direction));
    });
    const joined = (name) => this.lines.flatMap((line) => Array.from(line[name] ?? line.outcome));
    this.classes = modeClasses({ label: joined("label"), bounces: joined("bounces"), periods: joined("periods") });
    let first = 0;
    for (const line of this.lines) {
      Object.assign(line, { first, classes: this.classes.ofCell.subarray(first, first + line.values.length) });
      first += line.values.length;
    }
    this.overlay?.update();
  }

  get cycles() {
    const [{ along, fixed } = {}] = this.lines;
    const cycles = along && this.overlay?.at(fixed);
    return cycles?.along === along ? cycles : null;
  }

  whole() {
    const ends = this.sources.map(({ grid }) => cellExtent(grid[this.along]));
    const [x0, x1] = [Math.min(...ends.map(([low]) => low)), Math.max(...ends.map(([, high]) => high))];
    const flights = Math.max(...this.lines.map((line) => line.highest), ...(this.measured?.valuesIn(x0, x1) ?? [])) || TWO_PI;
    const lowest = Math.min(...this.lines.map((line) => line.lowest)) / 1.5;
    const isLog = this.wantedLog()?.includes("y");
    return { x0, x1, y0: isLog && lowest < flights ? lowest : 0, y1: (isLog ? 1.5 : 1.09) * (this.cycles ? Math.max(flights, TWO_PI) : flights) };
  }

  content() {
    const { lines, cycles } = this;
    const [{ along, fixed }] = lines;
    const hasThreshold = along === "gamma" && !this.isCompared && hasSpring(this.job);
    return {
      ...this.scales(this.axisOf(along), FLIGHT_AXIS),
      title: this.#title(),
      legend: [...this.#legend(), ...(cycles ? branchLegend(ofOtherPlate(this.job)) : [])],
      message: emptyMessage(lines),
      above: this.isCompared ? null : { height: lines.length * (STRIP + 1), draw: (ctx, box) => drawStrips(ctx, box, lines, this.legend.hidden) },
      layers: [
        (ctx, box) => hasThreshold && drawThreshold(ctx, box, threshold(fixed.omega, fixed.xi)),
        (ctx, box) => drawFlights(ctx, box, this.#visibleLines(), (line) => this.#colour(line, box.theme)),
        (ctx, box) => cycles && drawBranches(ctx, box, cycles),
        (ctx, box) => this.measured?.draw(ctx, box),
      ],
    };
  }

  #visibleLines() {
    const { hidden } = this.legend;
    if (!hidden.size || this.isCompared) return this.lines;
    return this.lines.map((line) => ({ ...line, flight_time: line.flight_time.map((time, i) => (hidden.has(line.classes[Math.floor(i / line.keep)]) ? NaN : time)) }));
  }

  computed() {
    const lines = this.#visibleLines();
    return (x) => lines.flatMap((line) => Array.from(flightsIn(line, nearestIndex(line.values, x))));
  }

  /** The fixed axes that have one value in all lines, or those of compared sweeps that have several. */
  #fixed(areSame) {
    const [{ fixed }] = this.lines;
    return Object.keys(fixed).filter((axis) => this.lines.every((line) => isClose(line.fixed[axis], fixed[axis])) === areSame);
  }

  /** The fixed values, which of the cells are shown, how many were computed; of compared sweeps, the values they share. */
  #title() {
    const [line] = this.lines;
    const fixed = this.textOf(Object.fromEntries(this.#fixed(true).map((axis) => [axis, line.fixed[axis]])));
    if (this.isCompared) return fixed;
    const thinned = line.every > 1 ? `,   1 ${SYMBOL[line.along]} in ${line.every}` : "";
    const computed = line.computed ? `,   ${line.computed.reduce((sum, value) => sum + value, 0)} of ${line.computed.length} cells computed` : "";
    return this.prefix + fixed + thinned + computed;
  }

  #legend() {
    const several = this.#fixed(false);
    const nameOf = ({ source, fixed }) => [shortTitleOf(source.job), ...several.map((axis) => this.textOf({ [axis]: fixed[axis] }))].join(", ");
    const entries = this.isCompared
      ? this.lines.filter(({ source }, i) => this.lines[i - 1]?.source !== source).map((line) => [nameOf(line), line])
      : this.lines.map((line) => [`ramp ${line.direction}`, line]);
    if (entries.length < 2 && (this.isCompared || this.directions[0] === "rest")) return [];
    return entries.map(([name, line], i) => [name, (ctx, x, y, theme) => disc(ctx, this.#colour(line, theme), x + 16, y, i ? 2.8 : 4.5)]);
  }

  drawCursor(ctx, box) {
    const cell = this.selected();
    const isAt = (fixed) => Object.entries(fixed).every(([axis, value]) => isClose(value, cell[axis]));
    if (cell && this.lines.some(({ direction, fixed }) => direction === cell.direction && isAt(fixed))) {
      const [x, bottom, colour] = [box.x.pixel(cell[this.lines[0].along]), box.top + box.height, this.#colour(cell, box.theme)];
      verticalLine(ctx, box, x, colour, 1, [2, 3]);
      polygon(ctx, colour, [[x, bottom - 13], [x - 6, bottom - 1], [x + 6, bottom - 1]]);
    }
    if (this.current?.periods) drawCycle(ctx, box, this.current, this.lines[0].along);
    else if (this.current) this.#atCurrent().forEach(({ line, cell }) => markCell(ctx, box, line.values[cell], distinctFlights(flightsIn(line, cell)).slice(0, MAX_CIRCLES)));
  }

  /** The colour of a direction; of several sweeps, each has a colour of its own. */
  #colour({ source = this.source, direction }, theme) {
    return this.isCompared ? numberedColour(source.number, theme.dark) : theme[direction];
  }

  #cell = (line, cell) => ({ line, cell: clampIndex(cell, line.values.length), source: line.source });

  /** The cycle next to (x, y), or the cell at x; of several lines, the one with a flight nearest to y. */
  nearest(x, y) {
    const cycle = this.cycles && this.plot.box && nearestCycle(this.cycles, this.plot.box, x, y);
    if (cycle) return cycle;
    const distance = ({ line, cell }) => Math.min(...Array.from(flightsIn(line, cell), (time) => Math.abs(time - y)), 1e9);
    const cells = this.lines.map((line) => this.#cell(line, nearestIndex(line.values, x)));
    return cells.sort((a, b) => distance(a) - distance(b))[0];
  }

  cellsInWindow() {
    const { x0, x1 } = this.visible(); // once: a line may have a hundred thousand cells
    const all = this.lines.flatMap((line) => Array.from(line.values.keys(), (cell) => ({ line, cell })));
    return all.filter(({ line: { values }, cell }) => values[cell] >= x0 && values[cell] <= x1);
  }

  indicesInWindow() {
    return this.cellsInWindow().map(({ line, cell }) => line.first + cell);
  }

  classOf = ({ line, cell }) => line.classes[cell];

  columnsOfTable() {
    const isOne = (valueOf) => new Set(this.lines.map(valueOf)).size < 2;
    const [{ fixed, direction }] = this.lines;
    return [
      axisColumn(SYMBOL[this.along], this.grid[this.along], ({ line, cell }) => line.values[cell]),
      ...(this.isCompared ? [["sweep", ({ line }) => titleOf(line.source.job)]] : []),
      ...AXES.filter((axis) => axis in fixed).map((axis) => [...axisColumn(SYMBOL[axis], this.grid[axis], ({ line }) => line.fixed[axis]), isOne((line) => line.fixed[axis])]),
      ...(isOne((line) => line.direction) && direction === "rest" ? [] : [["ramp", ({ line }) => line.direction, isOne((line) => line.direction)]]),
      ...cellColumns(Object.assign({}, ...this.lines), ({ line, cell }) => [line, cell]),
      ["flight times (rad)", ({ line, cell }, whole) => flightsText(flightsIn(line, cell), whole, line.flight_error?.[cell])],
    ];
  }

  step(current, right, up) {
    if (!current?.line) return this.#cell(this.lines[0], this.lines[0].values.length >> 1);
    const other = up ? this.lines.find((line) => line !== current.line) : null;
    return this.#cell(other ?? current.line, current.cell + right);
  }

  at({ line, cell, ...cycle }) {
    return line ? [line.values[cell], flightsIn(line, cell)[0]] : [cycle[this.lines[0].along], cycle.flight_time];
  }

  cellOf({ line, cell, ...cycle }) {
    if (!line) return startOn(this.place, cycle, this.lines[0].along);
    return { ...line.fixed, [line.along]: line.values[cell], direction: line.direction };
  }

  /** The current cell; of compared sweeps, the cells of all there. */
  #atCurrent() {
    const { line, cell } = this.current;
    return this.isCompared ? this.lines.map((other) => this.#cell(other, nearestIndex(other.values, line.values[cell]))) : [this.current];
  }

  describe(cell) {
    if (cell.periods) return `${describeCycle(cell, this.lines[0].along)} · ${this.textOf(this.lines[0].fixed)} · press to see it move`;
    if (!this.isCompared) return super.describe(cell);
    return this.#atCurrent().map((entry) => h("span", { className: "entry" }, swatch(this.#colour(entry.line, theme())), `${super.describe(entry)} `));
  }
}

/** The lines of a diagram: the variables of each direction, and its `highest` and `lowest` flight, NaN left out. */
function linesOf(source, result) {
  const { along, every } = result.attrs;
  const fixed = Object.fromEntries(AXES.filter((axis) => axis !== along).map((axis) => [axis, result[axis].data]));
  return partsOf(result, "direction").map((variables) => {
    const highest = variables.flight_time.reduce((most, time) => (time > most ? time : most), 0);
    const lowest = variables.flight_time.reduce((least, time) => (time < least ? time : least), Infinity);
    return { ...variables, source, along, fixed, every, highest, lowest, values: result[along].data, keep: result.dims.flight };
  });
}

/** A strip for each line above the box: the colour of each cell's mode. */
function drawStrips(ctx, box, lines, hidden) {
  lines.forEach(({ values, classes }, i) => {
    for (let x = box.left; x < box.left + box.width; x++) {
      const id = classes[nearestIndex(values, box.x.value(x + 0.5))];
      ctx.fillStyle = hidden.has(id) ? box.theme.surface : modeColour(id, box.theme.dark);
      ctx.fillRect(x, box.top - (lines.length - i) * (STRIP + 1), 1, STRIP);
    }
  });
}

function emptyMessage(lines) {
  if (lines.some(({ highest }) => highest > 0)) return null;
  const allAre = (wanted) => lines.every(({ outcome }) => outcome.every((value) => value === wanted));
  if (allAre(OUTCOME.missing)) return "Not computed yet";
  return allAre(OUTCOME.atRest) ? "The spring stays on the plate" : "No flights to show";
}

/** The Γ at which rest ends, labelled Γ_th, where it lies in the box. */
export function drawThreshold(ctx, box, gamma) {
  const x = box.x.pixel(gamma);
  if (!(x >= box.left && x <= box.left + box.width)) return;
  verticalLine(ctx, box, x, box.theme.threshold, 1.2, [5, 4]);
  const letter = { x: x + 32 < box.left + box.width ? x + 5 : x - 26, y: box.top + 17, colour: box.theme.threshold };
  box.texts.push({ ...letter, text: "Γ", size: 15, italic: true }, { ...letter, text: "th", size: 11, x: letter.x + 11, y: letter.y + 5 });
}
