// Two or more sweeps in one diagram, or side by side: the same axes, one window, one cursor.

import { addressValue, currentQuery, link, setQuery, setWindow, windowIn } from "../lib/address.js";
import { isHandledElsewhere, query, requestBlob, requestJson } from "../lib/api.js";
import { announce, gestures, h, latest } from "../lib/dom.js";
import { downloads, fileName, originOf } from "../lib/downloads.js";
import { number } from "../lib/format.js";
import { AXES, SYMBOL, TWO_PI, axisLabel, axisValues, clampIndex, directionsOf, initialValue, isLog, isSweep, nearestIndex } from "../lib/physics.js";
import { branchColour, theme } from "../plot/colours.js";
import { disc } from "../plot/drawing.js";
import { pngOf, svgOf } from "../plot/export.js";
import { drawFlights } from "../plot/flights.js";
import { listenToInput, magnified } from "../plot/input.js";
import { Plot } from "../plot/plot.js";
import { extent } from "../plot/scale.js";
import { legendEntry } from "../views/cells.js";
import { sliders } from "../views/controls.js";
import { describeCell, drawCurrent, emptyMessage, flightTable } from "../views/diagram-content.js";
import { requestLine } from "../views/line-data.js";
import { summary, titleOf } from "../views/progress.js";

const MAX_SWEEPS = 6; // more cannot be told apart by colour
const MAX_POINTS = 100_000; // flights of a sweep's line that are sent as points; longer ones are sent as density
const HINT = "Point at the diagram to read all sweeps there, drag to zoom, double-click to reset the zoom.";
const KEYS = "Arrow keys step through the cells of the first sweep, plus and minus zoom, 0 resets the zoom.";

export class Compare {
  lines = null; // of each sweep, one per direction
  x = null; // where the pointer is
  plots = [];

  constructor(root, { query: parameters }) {
    document.title = "Comparison · Bouncing spring";
    this.ids = [...new Set((parameters.jobs ?? "").split(",").filter(Boolean))];
    this.layout = parameters.layout === "side" ? "side" : "overlay";
    this.window = windowIn(parameters);
    this.controls = h("div", { className: "controls" });
    this.problem = h("p", { className: "problem", role: "alert", hidden: true });
    this.figures = h("div", { className: "figures" });
    this.legend = h("ul", { className: "compared", "aria-label": "Sweeps" });
    this.readout = h("ul", { className: "readout", "aria-label": "Cells at the pointer" }, h("li", {}, gestures(HINT)));
    this.panel = h("section", { className: "panel" }, this.controls, this.problem, this.figures, this.legend, this.readout);
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
      h("label", { className: "option" }, "Layout ", h("select", { onchange: (event) => this.#setLayout(event.target.value) }, option("overlay", "overlaid", this.layout), option("side", "side by side", this.layout))),
      ...(this.axes.length > 1 ? [h("label", { className: "option" }, "Diagram ", h("select", { "aria-label": "Axis of the diagram", onchange: (event) => this.#setAxis(event.target.value) }, this.axes.map((axis) => option(axis, `${SYMBOL[axis]}–φ`, this.along))))] : []),
      sliders(this.axes.filter((axis) => axis !== this.along), this.grid, this.fixed, (axis, value) => {
        this.fixed[axis] = value;
        setQuery({ [axis]: addressValue(value) });
        this.load();
      }) || "");
  }

  #setLayout(layout) {
    this.layout = layout;
    setQuery({ layout: layout === "side" ? layout : null });
    this.#buildPlots();
    this.#draw();
  }

  #setAxis(along) {
    Object.assign(this, { along, lines: null, x: null });
    setQuery({ along });
    this.#buildControls();
    this.#zoom(null);
    this.load();
  }

  #buildPlots() {
    this.plots.forEach((plot) => plot.close());
    const groups = this.layout === "side" ? this.sweeps.map((sweep) => [sweep]) : [this.sweeps];
    this.figures.className = `figures ${this.layout}`;
    const figures = groups.map(() => h("figure", {}));
    this.figures.replaceChildren(...figures);
    this.plots = groups.map((sweeps, i) => {
      const names = sweeps.map(({ job }) => titleOf(job)).join(", ");
      const plot = new Plot(figures[i], { label: `Bifurcation diagrams of ${names}. ${KEYS}`, content: () => this.#content(sweeps), minHeight: 260 });
      listenToInput(plot, {
        hover: (x) => this.#point(x),
        leave: () => this.#point(null),
        select: (x) => this.#point(x),
        selectCurrent: () => {},
        step: (right) => this.#step(right),
        zoom: (window) => this.#zoom(window),
        magnify: (factor) => this.#zoom(magnified(this.#visible(), this.#whole(), factor, this.x ?? undefined)),
      });
      return plot;
    });
  }

  async #load(signal) {
    if (!this.sweeps) return;
    const { along } = this;
    this.plots.forEach((plot) => plot.element.setAttribute("aria-busy", "true"));
    try {
      const lines = await Promise.all(this.sweeps.map((sweep) => this.#requestLines(sweep, along, signal)));
      if (this.closed || along !== this.along) return;
      this.lines = lines;
      this.sweeps.forEach((sweep, i) => {
        sweep.lines = lines[i];
        sweep.note.textContent = Object.entries(lines[i][0].fixed).map(([axis, value]) => `${SYMBOL[axis]} = ${number(value)}`).join(", ");
      });
      this.#draw();
      this.plots.forEach((plot) => { plot.element.dataset.shown = JSON.stringify({ along, ...this.fixed, layout: this.layout }); });
    } catch (error) {
      this.#showError(error);
    } finally {
      this.plots.forEach((plot) => plot.element.removeAttribute("aria-busy"));
    }
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
        if (this.x === null) return;
        for (const line of lines) drawCurrent(ctx, box, { line, cell: nearestIndex(line.arrays.values, this.x) });
      },
    };
  }

  #whole() {
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

  #point(x) {
    this.x = x;
    this.plots.forEach((plot) => plot.drawCursor());
    this.#describe();
  }

  #step(right) {
    if (!this.lines) return;
    const { values } = this.lines[0][0].arrays;
    const index = this.x === null ? values.length >> 1 : clampIndex(nearestIndex(values, this.x) + right, values.length);
    this.#point(values[index]);
    announce([...this.readout.children].map((child) => child.textContent).join(". "));
  }

  /** What every sweep has at the pointer. */
  #describe() {
    const items = this.x === null || !this.lines ? [h("li", {}, gestures(HINT))] : this.sweeps.flatMap(({ job, number: id, lines }) => lines.map((line) =>
      legendEntry(branchColour(id, theme().dark), `${titleOf(job)}: `, describeCell({ line, cell: nearestIndex(line.arrays.values, this.x) }, this.along, lines.length > 1))));
    this.readout.replaceChildren(...items);
  }

  #downloads() {
    const [first] = this.sweeps;
    const overlaid = () => Object.create(this.plots[0], { content: { value: () => this.#content(this.sweeps) } }); // in either layout
    const files = [["PNG", "png", pngOf], ["SVG", "svg", svgOf]].map(([label, extension, make]) =>
      [label, () => fileName(first.job, "comparison", extension), async () => make(overlaid(), { origin: { sweeps: await Promise.all(this.sweeps.map(({ job }) => originOf(job))) } })]);
    const tables = this.sweeps.map(({ job, number: id }) => [`CSV of ${id}`, () => fileName(job, `${this.along}-phi`, "csv"), () => this.#table(this.sweeps[id - 1])]);
    return downloads([...files, ...tables]);
  }

  /** The flights of a sweep in view; of a density, all flights of its first direction from the service. */
  #table({ job, lines }) {
    const [{ arrays, fixed, direction }] = lines;
    if (!arrays.density) return flightTable(lines, this.along, this.#visible());
    return requestBlob(`/v1/jobs/${job.id}/diagram?${query({ along: this.along, ...fixed, direction, format: "csv" })}`);
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
