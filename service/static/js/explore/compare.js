// Two or more sweeps in one diagram, or side by side as diagrams or mode maps: the same axes, one window, one cursor.

import { addressValue, currentQuery, link, setQuery, setWindow, windowIn } from "../lib/address.js";
import { isHandledElsewhere, query, requestArrays, requestBlob, requestJson } from "../lib/api.js";
import { announce, gestures, h, latest } from "../lib/dom.js";
import { downloads, fileName, originOf } from "../lib/downloads.js";
import { number } from "../lib/format.js";
import { AXES, SYMBOL, TWO_PI, axisLabel, axisValues, clampIndex, directionsOf, initialValue, isLog, isSweep, nearestIndex } from "../lib/physics.js";
import { branchColour, modeClasses, modeColour, theme } from "../plot/colours.js";
import { clipped, disc } from "../plot/drawing.js";
import { pngOf, svgOf } from "../plot/export.js";
import { drawFlights } from "../plot/flights.js";
import { listenToInput, magnified } from "../plot/input.js";
import { Plot } from "../plot/plot.js";
import { extent } from "../plot/scale.js";
import { drawRing, legendEntry, nearestCell, nextCell, windowOf } from "../views/cells.js";
import { sliders } from "../views/controls.js";
import { describeCell, drawCurrent, emptyMessage, flightTable } from "../views/diagram-content.js";
import { requestLine } from "../views/line-data.js";
import { describeMode, drawModes, drawThresholdCurve, modeTable, thresholdLegend } from "../views/mode-map.js";
import { summary, titleOf } from "../views/progress.js";

const MAX_SWEEPS = 6; // more cannot be told apart by colour
const MAX_POINTS = 100_000; // flights of a sweep's line that are sent as points; longer ones are sent as density
const LAYOUTS = { overlay: "overlaid", side: "side by side", maps: "mode maps" };
const HINT = "Point at the diagram to read all sweeps there, drag to zoom, double-click to reset the zoom.";
const KEYS = "Arrow keys step through the cells of the first sweep, plus and minus zoom, 0 resets the zoom.";

export class Compare {
  lines = null; // of each sweep, one per direction
  planes = null; // of the mode maps, one per sweep and direction: {sweep, plane, classes}
  point = null; // where the pointer is: {x, y}
  plots = [];

  constructor(root, { query: parameters }) {
    document.title = "Comparison · Bouncing spring";
    this.ids = [...new Set((parameters.jobs ?? "").split(",").filter(Boolean))];
    this.layout = parameters.layout in LAYOUTS ? parameters.layout : "overlay";
    this.window = windowIn(parameters);
    this.controls = h("div", { className: "controls" });
    this.problem = h("p", { className: "problem", role: "alert", hidden: true });
    this.figures = h("div", { className: "figures" });
    this.legend = h("ul", { className: "compared", "aria-label": "Sweeps" });
    this.modes = h("ul", { className: "legend", "aria-label": "Modes: (bounces, plate periods)", hidden: true });
    this.readout = h("ul", { className: "readout", "aria-label": "Cells at the pointer" }, h("li", {}, gestures(HINT)));
    this.panel = h("section", { className: "panel" }, this.controls, this.problem, this.figures, this.modes, this.legend, this.readout);
    root.replaceChildren(h("p", { className: "back" }, h("a", { href: link([]) }, "← All sweeps")), h("h1", { tabindex: "-1" }, "Comparison"), this.panel);
    this.load = latest((signal) => this.#load(signal));
    this.refresh();
  }

  handles({ path, query: { jobs = "" } }) {
    return path[0] === "compare" && [...new Set(jobs.split(",").filter(Boolean))].join() === this.ids.join();
  }

  show() {}

  close() {
    this.closed = true;
    this.plots.forEach((plot) => plot.close());
  }

  async refresh() {
    if (this.sweeps) {
      this.load();
      return;
    }
    try {
      if (this.ids.length < 2) throw new Error("Select two sweeps or more in the list of sweeps, and press Compare.");
      if (this.ids.length > MAX_SWEEPS) throw new Error(`At most ${MAX_SWEEPS} sweeps can be compared; ${this.ids.length} were selected.`);
      const jobs = await Promise.all(this.ids.map((id) => requestJson(`/v1/jobs/${id}`)));
      if (this.closed) return;
      const others = jobs.filter(({ spec }) => !isSweep(spec));
      if (jobs.length - others.length < 2) throw new Error(`Only sweeps have diagrams to compare: ${others.map(titleOf).join(", ")} ${others.length === 1 ? "is another study" : "are other studies"}.`);
      this.#showError(others.length ? new Error(`Left out, because only sweeps have diagrams: ${others.map(titleOf).join(", ")}.`) : null);
      this.#start(jobs.filter(({ spec }) => isSweep(spec)));
    } catch (error) {
      this.#showError(error);
    }
  }

  #start(jobs) {
    const initial = currentQuery();
    this.sweeps = jobs.map((job, i) => ({
      job, number: i + 1, directions: directionsOf(job.spec),
      grid: Object.fromEntries(AXES.map((axis) => [axis, axisValues(job.spec[axis])])),
    }));
    this.axes = AXES.filter((axis) => this.sweeps.some(({ grid }) => grid[axis].length > 1));
    if (!this.axes.length) this.axes = ["gamma"];
    this.mapped = this.sweeps.filter(({ grid }) => grid.gamma.length > 1 && grid.omega.length > 1);
    if (this.mapped.length < 2 && this.layout === "maps") this.layout = "overlay";
    this.along = this.axes.includes(initial.along) ? initial.along : this.axes[0];
    // The values that any of the sweeps has; each is shown at its own nearest one.
    this.grid = Object.fromEntries(AXES.map((axis) => [axis, merged(this.sweeps.map(({ grid }) => grid[axis]))]));
    this.fixed = Object.fromEntries(AXES.map((axis) => [axis, initialValue(this.grid[axis], initial[axis])]));
    this.legend.replaceChildren(...this.sweeps.map((sweep) => {
      const entry = legendEntry(branchColour(sweep.number, theme().dark), h("a", { href: link(["job", sweep.job.id]) }, titleOf(sweep.job)), " ", sweep.note = h("span", { className: "note" }), h("p", { className: "summary" }, summary(sweep.job)));
      return entry;
    }));
    this.panel.append(this.#downloads());
    this.#buildControls();
    this.#buildPlots();
    this.load();
  }

  #buildControls() {
    const option = (value, text, chosen) => h("option", { value, selected: value === chosen }, text);
    this.controls.replaceChildren(
      h("label", { className: "option" }, "Layout ", h("select", { onchange: (event) => this.#setLayout(event.target.value) },
        Object.entries(LAYOUTS).filter(([layout]) => layout !== "maps" || this.mapped.length > 1).map(([layout, text]) => option(layout, text, this.layout)))),
      ...(this.axes.length > 1 && !this.#isMap ? [h("label", { className: "option" }, "Diagram ", h("select", { "aria-label": "Axis of the diagram", onchange: (event) => this.#setAxis(event.target.value) }, this.axes.map((axis) => option(axis, `${SYMBOL[axis]}–φ`, this.along))))] : []),
      sliders(this.#isMap ? ["xi"] : this.axes.filter((axis) => axis !== this.along), this.grid, this.fixed, (axis, value) => {
        this.fixed[axis] = value;
        setQuery({ [axis]: addressValue(value) });
        this.load();
      }) || "");
  }

  get #isMap() {
    return this.layout === "maps";
  }

  #setLayout(layout) {
    const wasMap = this.#isMap;
    this.layout = layout;
    setQuery({ layout: layout === "overlay" ? null : layout });
    if (wasMap !== this.#isMap) {
      Object.assign(this, { lines: null, planes: null, point: null, window: null });
      setWindow(null);
      this.#buildControls();
    }
    this.#buildPlots();
    if (wasMap === this.#isMap) this.#draw();
    else this.load();
  }

  #setAxis(along) {
    Object.assign(this, { along, lines: null, point: null });
    setQuery({ along });
    this.#buildControls();
    this.#zoom(null);
    this.load();
  }

  #buildPlots() {
    this.plots.forEach((plot) => plot.close());
    this.figures.className = `figures ${this.layout === "overlay" ? "overlay" : "side"}`;
    this.legend.classList.toggle("uncoloured", this.#isMap);
    this.modes.hidden = !this.#isMap;
    const shown = this.#isMap ? this.#mapContents() : this.#diagramContents();
    const figures = shown.map(() => h("figure", {}));
    this.figures.replaceChildren(...figures);
    this.plots = shown.map(({ label, content }, i) => {
      const plot = new Plot(figures[i], { label: `${label}. ${KEYS}`, content, minHeight: 260 });
      listenToInput(plot, {
        hover: (x, y) => this.#point({ x, y }),
        leave: () => this.#point(null),
        select: (x, y) => this.#point({ x, y }),
        selectCurrent: () => {},
        step: (right, up) => this.#step(right, up),
        zoom: (window) => this.#zoom(window),
        magnify: (factor) => this.#zoom(magnified(this.#visible(), this.#whole(), factor, this.point?.x)),
      });
      return plot;
    });
  }

  #diagramContents() {
    const groups = this.layout === "side" ? this.sweeps.map((sweep) => [sweep]) : [this.sweeps];
    return groups.map((sweeps) => ({
      label: `Bifurcation diagrams of ${sweeps.map(({ job }) => titleOf(job)).join(", ")}`, content: () => this.#content(sweeps),
    }));
  }

  /** A map of each sweep that has one, of each direction. */
  #mapContents() {
    return this.mapped.flatMap((sweep) => sweep.directions.map((direction) => ({
      label: `Mode map of ${titleOf(sweep.job)}${sweep.directions.length > 1 ? `, ramp ${direction}` : ""}`,
      content: () => this.#mapContent(this.planes?.find((map) => map.sweep === sweep && map.direction === direction)),
    })));
  }

  async #load(signal) {
    if (!this.sweeps) return;
    const { along, layout } = this;
    this.plots.forEach((plot) => plot.element.setAttribute("aria-busy", "true"));
    try {
      const shown = this.#isMap ? await this.#loadPlanes(signal) : await this.#loadLines(signal);
      if (this.closed || along !== this.along || layout !== this.layout) return;
      shown();
      this.#draw();
      this.plots.forEach((plot) => { plot.element.dataset.shown = JSON.stringify({ along, ...this.fixed, layout: this.layout }); });
    } catch (error) {
      this.#showError(error);
    } finally {
      this.plots.forEach((plot) => plot.element.removeAttribute("aria-busy"));
    }
  }

  async #loadLines(signal) {
    const lines = await Promise.all(this.sweeps.map((sweep) => this.#requestLines(sweep, this.along, signal)));
    return () => {
      this.lines = lines;
      this.sweeps.forEach((sweep, i) => {
        sweep.lines = lines[i];
        sweep.note.textContent = Object.entries(lines[i][0].fixed).map(([axis, value]) => `${SYMBOL[axis]} = ${number(value)}`).join(", ");
      });
    };
  }

  /** The maps at the ξ nearest to the slider's. */
  async #loadPlanes(signal) {
    const planes = await Promise.all(this.mapped.flatMap((sweep) => sweep.directions.map(async (direction) => {
      const { job, grid } = sweep;
      const parameters = { xi: grid.xi[nearestIndex(grid.xi, this.fixed.xi)], direction, min_flight: job.spec.micro_flight };
      const plane = await requestArrays(`/v1/jobs/${job.id}/plane?${query(parameters)}`, { signal });
      return { sweep, direction, plane, classes: modeClasses(plane.arrays) };
    })));
    return () => {
      this.planes = planes;
      const present = new Map(planes.flatMap(({ classes }) => classes.present.map(({ id, name }) => [id, name])));
      this.modes.replaceChildren(...[...present].map(([id, name]) => legendEntry(modeColour(id, theme().dark), name)));
      for (const sweep of this.sweeps) {
        const map = planes.find((other) => other.sweep === sweep);
        sweep.note.textContent = map ? `${SYMBOL.xi} = ${number(map.plane.xi)}` : "no map: one value of Γ or Ω";
      }
    };
  }

  /** The lines of a sweep through its grid values nearest to the fixed ones. */
  #requestLines({ job, grid, directions }, along, signal) {
    const fixed = Object.fromEntries(AXES.filter((axis) => axis !== along).map((axis) => [axis, grid[axis][nearestIndex(grid[axis], this.fixed[axis])]]));
    const parameters = { along, ...fixed, min_flight: job.spec.micro_flight, most: MAX_POINTS, log: isLog(job.spec[along]) || null, width: 1000, height: 500 };
    return Promise.all(directions.map((direction) => requestLine(job, { ...parameters, direction }, null, { signal })));
  }

  #draw() {
    this.plots.forEach((plot) => plot.draw());
    this.#describe();
  }

  #content(sweeps) {
    if (!this.lines) return null;
    const { x0, x1, y0, y1 } = this.#visible();
    const lines = sweeps.flatMap((sweep) => sweep.lines);
    const sweepOf = new Map(sweeps.flatMap((sweep) => sweep.lines.map((line) => [line, sweep])));
    const colour = (line, theme) => branchColour(sweepOf.get(line).number, theme.dark);
    return {
      title: sweeps.length === 1 ? titleOf(sweeps[0].job) : "",
      legend: sweeps.length === 1 ? [] : sweeps.map(({ job, number: id }) => [shortened(titleOf(job)), (ctx, x, y, theme) => disc(ctx, branchColour(id, theme.dark), x + 16, y, 4)]),
      x: { label: axisLabel(this.along), low: x0, high: x1, log: this.sweeps.every(({ job }) => isLog(job.spec[this.along])) },
      y: { label: "flight time φ (rad)", low: y0, high: y1, periods: true },
      message: emptyMessage(lines),
      layers: [(ctx, box) => drawFlights(ctx, box, lines, (line) => colour(line, box.theme))],
      cursor: (ctx, box) => {
        if (!this.point) return;
        for (const line of lines) drawCurrent(ctx, box, { line, cell: nearestIndex(line.arrays.values, this.point.x) });
      },
    };
  }

  #mapContent(map) {
    if (!map) return null;
    const { sweep, plane, classes } = map;
    const { x0, x1, y0, y1 } = this.#visible();
    const isLogarithmic = (axis) => this.mapped.every(({ job }) => isLog(job.spec[axis]));
    return {
      title: titleOfMap(map),
      legend: [thresholdLegend],
      colours: classes.present.map(({ id, name }) => [name, (theme) => modeColour(id, theme.dark)]),
      x: { label: axisLabel("gamma"), low: x0, high: x1, log: isLogarithmic("gamma") },
      y: { label: axisLabel("omega"), low: y0, high: y1, log: isLogarithmic("omega") },
      layers: [(ctx, box) => clipped(ctx, within(box, sweep.grid), () => drawModes(ctx, box, plane, classes)), (ctx, box) => drawThresholdCurve(ctx, box, plane.xi)],
      cursor: (ctx, box) => {
        if (!this.point || !covers(sweep.grid, this.point)) return;
        const { column, row } = nearestCell(plane.arrays.gamma, plane.arrays.omega, this.point.x, this.point.y);
        drawRing(ctx, box, plane.arrays.gamma[column], plane.arrays.omega[row], 6);
      },
    };
  }

  #whole() {
    if (this.#isMap) {
      const windows = this.mapped.map(({ grid }) => windowOf(grid.gamma, grid.omega, true));
      const least = (name) => Math.min(...windows.map((window) => window[name]));
      const greatest = (name) => Math.max(...windows.map((window) => window[name]));
      return { x0: least("x0"), x1: greatest("x1"), y0: least("y0"), y1: greatest("y1") };
    }
    const lines = this.lines.flat();
    const [x0, x1] = extent(Math.min(...lines.map(({ arrays }) => arrays.values[0])), Math.max(...lines.map(({ arrays }) => arrays.values.at(-1))));
    return { x0, x1, y0: 0, y1: 1.06 * (Math.max(...lines.map(({ highest }) => highest), 0) || TWO_PI) };
  }

  #visible() {
    return this.window ?? this.#whole();
  }

  #zoom(window) {
    this.window = window;
    setWindow(window);
    this.plots.forEach((plot) => plot.redraw());
  }

  #point(point) {
    this.point = point;
    this.plots.forEach((plot) => plot.drawCursor());
    this.#describe();
  }

  #step(right, up) {
    if (this.#isMap ? !this.planes : !this.lines) return;
    this.#point(this.#isMap ? this.#nextCell(right, up) : this.#nextValue(right));
    announce([...this.readout.children].map((child) => child.textContent).join(". "));
  }

  #nextValue(right) {
    const { values } = this.lines[0][0].arrays;
    const index = this.point ? clampIndex(nearestIndex(values, this.point.x) + right, values.length) : values.length >> 1;
    return { x: values[index], y: 0 };
  }

  #nextCell(right, up) {
    const { gamma, omega } = this.planes[0].plane.arrays;
    const current = this.point && nearestCell(gamma, omega, this.point.x, this.point.y);
    const { column, row } = nextCell(gamma, omega, current, right, up);
    return { x: gamma[column], y: omega[row] };
  }

  /** What every sweep has at the pointer. */
  #describe() {
    const items = this.point && (this.#isMap ? this.#describeMaps() : this.#describeLines());
    this.readout.replaceChildren(...(items || [h("li", {}, gestures(HINT))]));
  }

  #describeLines() {
    return this.lines && this.sweeps.flatMap(({ job, number: id, lines }) => lines.map((line) =>
      legendEntry(branchColour(id, theme().dark), `${titleOf(job)}: `, describeCell({ line, cell: nearestIndex(line.arrays.values, this.point.x) }, this.along, lines.length > 1))));
  }

  #describeMaps() {
    return this.planes?.map((map) => {
      const { sweep, plane, classes } = map;
      if (!covers(sweep.grid, this.point)) return h("li", {}, `${titleOfMap(map)}: outside its grid`);
      const { gamma, omega } = plane.arrays;
      const cell = nearestCell(gamma, omega, this.point.x, this.point.y);
      return legendEntry(modeColour(classes.ofCell[cell.row * gamma.length + cell.column], theme().dark), `${titleOfMap(map)}: `, describeMode(plane, cell).join(" · "));
    });
  }

  #downloads() {
    const [first] = this.sweeps;
    // All diagrams in one picture, in either layout; of mode maps the first one.
    const overlaid = () => (this.#isMap ? this.plots[0] : Object.create(this.plots[0], { content: { value: () => this.#content(this.sweeps) } }));
    const files = [["PNG", "png", pngOf], ["SVG", "svg", svgOf]].map(([label, extension, make]) =>
      [label, () => fileName(first.job, "comparison", extension), async () => make(overlaid(), { origin: { sweeps: await Promise.all(this.sweeps.map(({ job }) => originOf(job))) } })]);
    const tables = this.sweeps.map(({ job, number: id }) => [`CSV of ${id}`, () => fileName(job, `${this.along}-phi`, "csv"), () => this.#table(this.sweeps[id - 1])]);
    return downloads([...files, ...tables]);
  }

  /** The flights of a sweep in view; of a density, all flights of its first direction from the service. */
  #table(sweep) {
    if (this.#isMap) return modeTable(this.#mapOf(sweep).plane);
    const { job, lines } = sweep;
    const [{ arrays, fixed, direction }] = lines;
    if (!arrays.density) return flightTable(lines, this.along, this.#visible());
    return requestBlob(`/v1/jobs/${job.id}/diagram?${query({ along: this.along, ...fixed, direction, format: "csv" })}`);
  }

  /** The first map of a sweep. */
  #mapOf(sweep) {
    const map = this.planes?.find((other) => other.sweep === sweep);
    if (!map) throw new Error(`There is no map of ${titleOf(sweep.job)}.`);
    return map;
  }

  #showError(error) {
    if (this.closed || (error && isHandledElsewhere(error))) return;
    this.problem.hidden = !error;
    this.problem.textContent = error?.message ?? "";
  }
}

/** All values of several increasing lists, each once. */
function merged(lists) {
  return [...new Set(lists.flatMap((values) => [...values]))].sort((a, b) => a - b);
}

const shortened = (name) => (name.length > 32 ? `${name.slice(0, 31)}…` : name);

/** The title of a mode map: the sweep, its ξ, its ramp. */
const titleOfMap = ({ sweep, direction, plane }) => `${shortened(titleOf(sweep.job))}, ${SYMBOL.xi} = ${number(plane.xi)}${sweep.directions.length > 1 ? `, ramp ${direction}` : ""}`;

/** The part of a plot's box that the map of a grid covers. */
function within(box, { gamma, omega }) {
  const { x0, x1, y0, y1 } = windowOf(gamma, omega, true);
  const [left, right] = [box.x.pixel(x0), box.x.pixel(x1)].map((x) => Math.min(Math.max(x, box.left), box.left + box.width));
  const [bottom, top] = [box.y.pixel(y0), box.y.pixel(y1)].map((y) => Math.min(Math.max(y, box.top), box.top + box.height));
  return { left, top, width: right - left, height: bottom - top };
}

/** Whether a point lies on the map of a grid. */
function covers({ gamma, omega }, { x, y }) {
  const { x0, x1, y0, y1 } = windowOf(gamma, omega, true);
  return x >= x0 && x <= x1 && y >= y0 && y <= y1;
}
