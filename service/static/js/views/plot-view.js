// The frame of every plot of results: it loads, follows the address, points, zooms, and downloads.

import { WINDOW, addressValue, currentQuery, navigate, queryChanges, setQuery, windowIn, windowQuery } from "../lib/address.js";
import { isHandledElsewhere, requestDataset, shared } from "../lib/api.js";
import { announce, button, copyButton, debounced, downloads, fileName, h, latest, problemLine, resultFiles } from "../lib/dom.js";
import { AXES, AXIS_LABEL, SYMBOL, axisColumn, axisText, axisValues, clamp, directionsOf, initialValue } from "../lib/physics.js";
import { PagedTable } from "../lib/table.js";
import { onThemeChange } from "../plot/colours.js";
import { polygon } from "../plot/drawing.js";
import { listenToInput, scaled } from "../plot/input.js";
import { Plot } from "../plot/plot.js";
import { wholeStudy } from "./measured.js";

const RETRY_MS = 3000; // after 503: results that were damaged are computed again
const KEYS = `Arrow keys step through cells, Home and End go to the ends, ${shared ? "" : "Enter shows the trajectory, "}plus and minus zoom, 0 resets the zoom.`;
const ANNOUNCED_MS = 250; // after the last key: a cursor that moves is not read cell by cell
const GESTURE_MS = 700; // between two turns of the wheel
const LOG_RANGE = 1000; // the end of a logarithmic axis over its beginning, where the linear one begins at zero
const PLACE = [...AXES, "cell"]; // parameters which nothing but the cursor depends on, unless they change the paths
const SYMBOLS = new Set(Object.values(SYMBOL));
/** The axis of flight times in a plot, with whole plate periods marked. */
export const FLIGHT_AXIS = { label: "flight time φ (rad)", periods: true };
const FORMATS = [["SVG", "svg"], ["PDF", "pdf"], ["CSV", "csv"]];

/** What a view shows of a job; `number` is its place among compared ones. */
export const sourceOf = (job, number = 1) => ({
  job, number, directions: directionsOf(job.spec),
  grid: Object.fromEntries(AXES.filter((axis) => axis in job.spec).map((axis) => [axis, axisValues(job.spec[axis])])),
});

/** Plots end at the window's lower edge, or above a cell's motion, whatever stands above them. */
const measure = (name, selector, side) => document.body.style.setProperty(name, `${document.querySelector(selector)?.[side] ?? 0}px`);
new ResizeObserver(() => {
  measure("--above", ".panels figure", "offsetTop");
  measure("--below", ".trajectory", "offsetHeight");
}).observe(document.body);

/** The frame of a page with plots in `root`: bar, line on what is shown, tabs; controls, panels and a motion below are filled later. */
export function buildFrame(root, { bar, line, tabs = false }) {
  const controls = h("div", { className: "view-controls" });
  const panel = h("section", { className: "panel" });
  const secondPanel = h("section", { className: "beside", hidden: true });
  const trajectorySection = h("section", { className: "trajectory", "aria-label": "Trajectory of a cell", hidden: true });
  document.getElementById("bar").replaceChildren(...bar);
  root.replaceChildren(h("header", { className: "job" }, line), h("div", { className: "views" }, tabs, controls),
    h("div", { className: "panels" }, panel, secondPanel), trajectorySection);
  return { controls, panel, secondPanel, trajectorySection };
}

/** How many points of the results at these paths are one that fits, as the service said when it refused them all. */
const fitting = new Map();

/** A result; of more points than the service sends, every n-th. */
const requestFitting = (path, options) => requestDataset(path + (fitting.get(path) ?? ""), options).catch((error) => {
  const [, every] = /every=(\d+) fits/.exec(error.message) ?? [];
  if (!every || fitting.has(path)) throw error;
  fitting.set(path, `&every=${every}`); // a running sweep is asked for each second
  return requestFitting(path, options);
});

/** A view of one source or several around a Plot. Its state is the query of the page's address. A subclass defines
 *   name             part of the names of its files, and what a shared file calls its results
 *   paths()          optional; the addresses of the results to show, if they are not those of filePath()
 *   read(results)    takes their Datasets (see requestDataset)
 *   filePath(source, format)   the address of the result of a source that is downloaded
 *   content(), drawCursor(ctx, box), whole()   what to draw (see Plot), and the window {x0, x1, y0, y1} of all data
 *   nearest(x, y), step(cell, right, up)   the cell at a position, or this many cells further; only the view's own
 *                    methods look into one, but for its `source` where views have several
 *   at(cell)         its position [x, y]
 *   describe(cell)   the cell in words, or a list of elements, if it is not what the table says of it
 *   cellOf(cell)     its {gamma, omega, xi, direction}
 *   cellsShown(), or cellsInWindow(), classOf(cell); columnsOfTable()   of the table of what is shown (see PagedTable)
 *   windowed         optional; the axes of a sweep along x and y, of a window that can be computed
 *   measured         optional; points that are dropped on the page (see measured.js)
 *   marks()          optional; what else the pictures of the service lack, in words; false for what is not shown
 *   legend, classes, indicesInWindow()   optional; a ClassLegend, the classes of cells, and those in the window. Or showLegend(), called when data or colours have changed */
export class PlotView {
  current = null; // the cell under the pointer or reached by keyboard
  isLoaded = false;
  turn = { at: -Infinity }; // the last of the wheel, and the window that it left: Back undoes a gesture, not its parts
  log = currentQuery().log; // the logarithmic axes: until it is drawn, those of the address
  isThinned = false; // whether all of it is more than the service sends

  /** `signal` aborts when the view is left. `bar`: where the controls are shown, if not above the plot; `isBeside`: beside
   * a map, whose window it has along Γ. `selected()`: the cell whose trajectory is shown; `onSelect(cell, job)`: one is
   * pressed. Of compared views, the first moves the others, which follow; `compared`, `grid` and `extent()` are those of
   * all; titles begin with `prefix`; `onPoint(view, x, y)`: the pointer is there, `onLoad(view)`: there are data. */
  constructor({ sources, ...options }) {
    const [source] = sources;
    const single = { compared: sources, grid: source.grid, extent: () => this.whole(), isFollower: false, prefix: "" };
    const handlers = { selected: () => null, onPoint: () => {}, onLoad: () => {} };
    Object.assign(this, { sources, source, job: source.job, directions: source.directions, isCompared: sources.length > 1 }, single, handlers, options);
  }

  /** The values nearest to those of the address. */
  get place() {
    const query = currentQuery();
    return Object.fromEntries(Object.keys(this.grid).map((axis) => [axis, initialValue(this.valuesOf(axis), query[axis])]));
  }

  /** The values of an axis that can be shown: of a shared file, those it holds. */
  valuesOf(axis) {
    const answers = (shared?.answers[this.name] ?? shared?.answers.diagram ?? []).filter((answer) => axis in answer);
    return answers.length ? [...new Set(answers.map((answer) => answer[axis]))].sort((a, b) => a - b) : this.grid[axis];
  }

  /** "Ω = 0.5,   ξ = 0.26" */
  textOf = (place) => Object.entries(place).map(([axis, value]) => `${SYMBOL[axis]} = ${axisText(value, this.grid[axis])}`).join(",   ");

  /** Columns of what all cells shown have in common, which their title says: for files and readings. */
  common = (place) => Object.entries(place).map(([axis, value]) => [...axisColumn(SYMBOL[axis], this.grid[axis], () => value), true]);

  /** The window zoomed to; null for everything. */
  get window() {
    return windowIn(currentQuery());
  }

  /** The logarithmic axes of the address; beside a map, y is another axis than the map's. */
  wantedLog = (log = currentQuery().log) => (this.isBeside && log ? log.replace("y", "") || "none" : log);

  /** The window on display: of a logarithmic axis, what is above zero. */
  visible = () => this.#positive(this.window ?? this.extent());

  #positive(window) {
    const lowest = (name, low, high) => (this.wantedLog()?.includes(name) && low <= 0 ? high / LOG_RANGE : low);
    return { ...window, x0: lowest("x", window.x0, window.x1), y0: lowest("y", window.y0, window.y1) };
  }

  /** Build the view with its `controls`, and start loading; the column beside the plot has `shown`: legend, options, notes,
   * and ends with `below`, and a table of `events`: its label and a function that reads it (see PagedTable). */
  build(root, { controls, label, hint, shown = [], below = [], events }) {
    this.hint = shared ? hint.replace(/, press to [^,]*,/, ",") : hint; // a shared file computes no motion
    this.readout = h("p", { className: "readout" }, this.hint);
    this.problem = problemLine();
    const tableOf = (title, read, nameOf, open) => new PagedTable(title, () => (this.isLoaded ? read() : [[], []]), () => fileName(this.job, nameOf(), "csv"), open);
    this.table = tableOf("Table of what is shown", () => [this.columnsOfTable(), this.cellsShown()], () => `${this.name}-table`);
    this.events = events && tableOf(...events, () => "events", true);
    const line = h("div", { className: "controls" }, controls);
    this.bar?.replaceChildren(line);
    const figure = h("figure", {});
    this.unzoom = button("Show all", () => this.#zoom(null), { hidden: !this.window });
    const toggleLog = (toggled) => setQuery({ log: ["x", "y"].filter((axis) => this.log.includes(axis) !== (axis === toggled)).join("") || "none" });
    this.logButtons = ["x", "y"].map((axis) => button(`log ${axis}`, () => toggleLog(axis), { hidden: !this.windowed, disabled: true, title: `Logarithmic ${axis} axis` }));
    const compute = this.windowed && this.bar && !this.isCompared && button("Compute this window", () => this.#computeWindow(), { "data-service": true });
    const actions = (...buttons) => h("div", { className: "actions" }, buttons);
    const column = [ // the legend grows while cells are computed: what is above it stays where it is
      this.readout, actions(copyButton("what is read", () => this.lastReadout ?? this.hint), this.logButtons, this.unzoom, compute), this.#downloads(),
      ...shown, this.measured?.elements, ...below, this.events?.element, this.table.element,
    ];
    root.replaceChildren(...(this.bar ? [] : [line]), this.problem.element, figure, h("aside", { "aria-label": `Beside: ${label}` }, column));
    this.plot = new Plot(figure, { signal: this.signal, label: `${label}. ${KEYS}`, content: () => (this.isLoaded ? this.content() : null), drawMark: (ctx, box) => this.drawCursor(ctx, box) });
    this.plot.element.addEventListener("drawn", () => { this.lacking.textContent = this.#lacking(); });
    listenToInput(this.plot, {
      hover: (x, y) => this.#point(this.nearest(x, y), x, y),
      leave: () => this.#point(null),
      select: (x, y) => this.#select(this.nearest(x, y)),
      selectCurrent: () => this.#select(this.current),
      step: (right, up) => this.#step(right, up),
      zoom: (window) => this.#zoom(window),
      isZoomed: () => Boolean(this.window),
      scale: (factors, from, to) => this.#scale(factors, from, to),
    });
    this.load = latest((signal) => this.#load(signal));
    queryChanges.addEventListener("change", ({ detail }) => this.#follow(detail), { signal: this.signal });
    onThemeChange(() => this.isLoaded && this.showLegend(), this.signal);
    this.load();
  }

  #scale(factors, from = this.current && this.at(this.current), to = from) {
    const isStep = performance.now() - this.turn.at > GESTURE_MS || this.turn.window !== JSON.stringify(this.window);
    this.#zoom(scaled(this.plot, this.visible(), this.#positive(this.extent()), factors, from, to), isStep);
    this.turn = { at: performance.now(), window: JSON.stringify(this.window) };
  }

  #zoom(window, isStep = true) {
    const query = windowQuery(window);
    const isPossible = window ? windowIn(query) : this.window;
    if (!isPossible || this.isBeside) return;
    setQuery(query, isStep);
    this.#announce(this.plot.axes);
  }

  #announce = debounced(ANNOUNCED_MS, (element) => this.signal.aborted || announce(element.textContent));
  #updateAside = debounced(ANNOUNCED_MS, () => this.signal.aborted || this.table.update() || !this.isLoaded || this.showLegend());

  cellsShown() {
    const hidden = this.classes && this.legend.hidden; // once: there may be a million cells
    return this.cellsInWindow().filter((cell) => !hidden?.has(this.classOf(cell)));
  }

  isVisible(x, y = null) {
    const { x0, x1, y0, y1 } = this.visible();
    return x >= x0 && x <= x1 && (y === null || (y >= y0 && y <= y1));
  }

  /** The axes of the window on display, of which `x` and `y` have label and marks. */
  scales(x, y) {
    const { x0, x1, y0, y1 } = this.visible();
    this.log = (this.windowed && this.wantedLog()) || `${x.log ? "x" : ""}${y.log ? "y" : ""}` || "none"; // for the service too
    const [isX, isY] = ["x", "y"].map((axis) => this.log.includes(axis));
    this.logButtons.forEach((button, i) => Object.assign(button, { ariaPressed: String([isX, isY][i]), disabled: false }));
    return { x: { ...x, low: x0, high: x1, log: isX }, y: { ...y, low: y0, high: y1, log: isY } };
  }

  axisOf = (axis) => ({ label: AXIS_LABEL[axis], log: this.sources.every(({ job }) => job.spec[axis]?.spacing === "log"), single: this.grid[axis].length > 1 ? undefined : this.grid[axis][0] });

  #computeWindow() {
    const { x0, x1, y0, y1 } = this.visible();
    const { [this.job.spec.protocol.axis]: ramped, ...fixed } = this.place; // a ramp keeps its axis
    const ends = this.windowed.map((axis, i) => [axis, [[x0, x1], [y0, y1]][i].map((end) => addressValue(clamp(end, this.grid[axis][0], this.grid[axis].at(-1)))).join()]);
    navigate(["new"], { from: this.job.id, ...fixed, ...Object.fromEntries(ends) });
  }

  /** Of a running job each second: what is loading is shown first, however long it takes. */
  update = () => this.load(true);

  showLegend() {
    this.legend?.show(this.classes);
  }

  describe(cell) {
    const known = this.columnsOfTable().map(([title, text]) => [title, text(cell)]).filter(([, text]) => text && text !== "–");
    const separator = (title) => (SYMBOLS.has(title) ? " = " : ": ");
    return known.map(([title, text]) => (title === "mode" ? text : title + separator(title) + text)).join(" · ");
  }

  paths() {
    return this.sources.map((source) => this.filePath(source));
  }

  /** The window zoomed to, as parameters of a query whose axes have these names. */
  windowOn(x, y) {
    const { x0, x1, y0, y1 } = this.window ?? {};
    return { [`${x}_start`]: x0, [`${x}_stop`]: x1, [`${y}_start`]: y0, [`${y}_stop`]: y1 };
  }

  /** The parameters with these names have changed. */
  #follow(changed) {
    this.unzoom.hidden = !this.window;
    const isDue = this.paths().join() !== this.requested;
    if (isDue) this.load();
    if (changed.length && changed.every((name) => (isDue ? !WINDOW.includes(name) : PLACE.includes(name)))) return; // what is there is zoomed at once
    this.plot.redraw();
    this.#updateAside();
  }

  async #load(signal) {
    clearTimeout(this.timer);
    if (this.signal.aborted) return;
    this.plot.element.setAttribute("aria-busy", "true");
    const paths = this.paths();
    this.requested = paths.join();
    this.plot.element.dataset.awaited = this.awaited?.() ?? "";
    try {
      const results = await Promise.all(paths.map((path) => requestFitting(path, { signal: AbortSignal.any([signal, this.signal]) })));
      if (this.signal.aborted) return;
      const position = this.current && this.at(this.current);
      this.read(results);
      this.isThinned ||= results.some(({ attrs }) => attrs.every > 1);
      this.isLoaded = true;
      this.#showError(null);
      this.#setCurrent(position && this.nearest(...position));
      this.showLegend();
      this.draw();
      this.plot.element.dataset.shown = parametersOf(results[0]);
      this.onLoad(this);
      if (this.paths().join() !== this.requested) this.load(); // thinned: the window in more detail
    } catch (error) {
      this.#showError(error);
    } finally {
      this.plot.element.removeAttribute("aria-busy");
    }
  }

  draw() {
    this.measured?.update();
    this.plot.draw();
    this.events?.update();
    this.#updateAside();
  }

  /** An error takes the place of the plot unless earlier data are still shown. */
  #showError(error) {
    if (this.signal.aborted || (error && isHandledElsewhere(error))) return;
    this.problem.show(error);
    this.plot.element.hidden = this.readout.hidden = Boolean(error) && !this.isLoaded;
    if (error?.status === 503) this.timer = setTimeout(() => this.load(), RETRY_MS);
    else if (error && !error.status) throw error;
  }

  follow(x, y) {
    if (this.isLoaded) this.#setCurrent(x === undefined ? null : this.nearest(x, y));
  }

  #setCurrent(cell) {
    this.current = cell;
    this.readout.replaceChildren(...(cell ? [this.describe(cell)].flat() : [this.hint]));
    if (cell) this.lastReadout = this.readout.textContent; // which is copied once the pointer has left the plot
    this.plot.drawCursor();
  }

  #point(cell, x, y) {
    this.#setCurrent(cell);
    this.onPoint(this, x, y);
  }

  #step(right, up) {
    if (!this.isLoaded) return;
    const { x0, x1, y0, y1 } = this.visible();
    const isSeen = (cell) => !cell || this.isVisible(this.at(cell)[0]);
    const from = this.window && (!this.current || !isSeen(this.current)) ? this.nearest((x0 + x1) / 2, (y0 + y1) / 2) : this.current;
    let cell = this.step(from ?? (Number.isFinite(right) ? null : this.step(null, 0, 0)), right, up); // the first key goes to the middle, Home and End beyond
    if (this.window && !isSeen(cell)) { // Home and End go to the ends of what is shown
      const [x, y] = this.at(cell);
      cell = this.nearest(clamp(x, x0, x1), y ?? (y0 + y1) / 2);
      if (!isSeen(cell)) cell = this.step(cell, x < x0 ? 1 : -1, 0);
    }
    if (!cell) return;
    this.#point(cell, ...this.at(cell));
    this.#announce(this.readout);
  }

  #select(cell) {
    const selected = cell && this.cellOf(cell);
    if (!selected) return;
    this.#setCurrent(cell);
    this.onSelect(selected, (cell.source ?? this.source).job);
  }

  png() {
    if (!this.isLoaded) throw new Error("Nothing is shown yet.");
    const legend = this.plot.element.closest("section").querySelectorAll(".legend li:not(:has([aria-pressed=false]))");
    const square = ({ style }) => (ctx, x, y) => polygon(ctx, style.background, [[x + 10, y - 7], [x + 24, y - 7], [x + 24, y + 7], [x + 10, y + 7]]);
    const entries = Array.from(legend, (entry) => [entry.textContent, square(entry.querySelector(".swatch"))]);
    return this.plot.png(entries, this.exponents && [this.exponents], this.plot.element.dataset.shown);
  }

  /** What the files of the service lack of what is shown, in words. */
  #lacking() {
    if (!this.isLoaded || !this.lacking.isConnected) return "";
    const sent = new URLSearchParams(this.filePath(this.source).split("?")[1]);
    const ends = Object.values(this.window ?? {}).map(String);
    const hides = !sent.has("hide") && this.classes?.present.some(({ id }) => this.legend.hidden.has(id));
    const isAll = hides || !ends.every((end) => [...sent.values()].includes(end));
    const marks = [this.measured?.points.length && "the measured points", ...(this.marks?.() ?? [])].filter(Boolean);
    const lack = marks.length ? `SVG and PDF lack ${marks.join(" and ")}.` : "";
    return isAll ? `SVG, PDF and CSV hold everything, not only what is shown. ${lack}` : lack;
  }

  #downloads() {
    this.lacking = h("span", { className: "note" });
    const png = ["PNG", () => fileName(this.job, this.name, "png"), () => this.png()];
    if (shared) return downloads([png]);
    const files = (source, formats) => resultFiles(source.job, () => this.name, formats, (format) => this.filePath(source, format));
    const ofSources = () => this.sources.flatMap((source) => files(source, [[`CSV of ${source.number}`, "csv"]]));
    if (this.isCompared && this.paths().length > 1) return downloads([png, ...ofSources()]);
    const whole = this.job.id && !this.isCompared ? wholeStudy(this.job, [["NetCDF", "nc"]]) : [];
    return downloads([png, ...files(this.source, FORMATS), ...whole], this.lacking);
  }
}

/** What a result is of, as JSON: its attributes, and its coordinates of one value. */
function parametersOf({ attrs, ...variables }) {
  const values = [...AXES, "direction"].filter((name) => variables[name]).map((name) => [name, variables[name].data])
    .map(([name, data]) => [name, typeof data === "object" && data.length === 1 ? data[0] : data]);
  return JSON.stringify({ ...attrs, ...Object.fromEntries(values.filter(([, value]) => typeof value !== "object")) });
}
