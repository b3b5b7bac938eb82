// The explorer: flight times along one axis, the others moved by sliders, up and down over each other.

import { note } from "../lib/address.js";
import { blobOf, query } from "../lib/api.js";
import { controls } from "./controls.js";
import { drawCell, drawChosen, drawOnset, emptiness, head } from "./diagram-drawing.js";
import { tableOf, wordsOn } from "./diagram-words.js";
import { debounced, h } from "../lib/dom.js";
import { drawFlights, flightsOf } from "../plot/flights.js";
import { lineOf } from "./line-data.js";
import { SYMBOL, TURN, isLog, nearest, same, startOf } from "../lib/physics.js";
import { PlotView, within } from "./plot-view.js";
import { dots } from "../plot/plot.js";
import { spread } from "../plot/scale.js";
import { colourOf } from "../plot/theme.js";

const MOST = 250_000; // flights that come as points; more come as density
const AHEAD = [1, 2, 3, -1]; // steps of the slider that are fetched before it gets there
const HINT = "Point at a cell to read it, click to see it move, drag to zoom, double-click to see all.";

export class Diagram extends PlotView {
  lines = null; // one for each ramp shown; null before the first are there
  whither = null; // the slider that moved last: {axis, sign}

  constructor(root, view) {
    super(view);
    const { grid, directions, asked } = this;
    const axes = Object.keys(SYMBOL);
    this.axes = axes.filter((axis) => grid[axis].length > 1);
    this.along = this.axes.includes(asked.along) ? asked.along : longest(grid);
    this.fixed = Object.fromEntries(axes.map((axis) => [axis, startOf(grid[axis], asked[axis])]));
    this.least = Number(asked.min) || 0;
    this.chosenRamps = directions.filter((one) => !asked.show || asked.show.split(",").includes(one));
    this.fetchAhead = debounced(40, () => this.#fetchAhead());
    this.controls = h("div", {});
    this.#control();
    this.build(root, { controls: this.controls, label: "Bifurcation diagram", hint: HINT });
  }

  get name() {
    return `${this.along}-phi`;
  }

  close() {
    super.close();
    this.fetchAhead.cancel();
    this.ahead?.abort();
  }

  #control() {
    this.controls.replaceChildren(controls(this, {
      turn: (along) => {
        const cell = this.lines && this.#chosenHere();
        if (cell) this.fixed[this.along] = cell[this.along]; // the other diagram through the same cell
        Object.assign(this, { along, lines: null, at: null, whither: null });
        note({ along });
        this.#control();
        this.zoom(null);
        this.load();
      },
      move: (axis, value) => {
        this.whither = { axis, sign: Math.sign(value - this.fixed[axis]) || 1 };
        this.fixed[axis] = value;
        note({ [axis]: Number(value.toPrecision(10)) });
        this.load();
      },
      show: (ramps) => {
        this.chosenRamps = ramps;
        note({ show: ramps.length === this.directions.length ? null : ramps.join() || "none" });
        this.load();
      },
      least: (least) => {
        this.least = least;
        note({ min: least || null });
        this.load();
      },
    }));
  }

  /** What the service is asked for, but for the direction. */
  #asked(fixed = this.fixed) {
    const still = Object.fromEntries(Object.entries(fixed).filter(([axis]) => axis !== this.along));
    return { along: this.along, ...still, min_flight: this.least || null };
  }

  /** The lines of all ramps shown, of `fixed`; counted within `window` if they are so dense. */
  #fetch(fixed, window, options) {
    const { x0: left, x1: right, y0: bottom, y1: top } = window ?? {};
    const room = this.plot.element;
    const asked = {
      ...this.#asked(fixed), most: MOST, log: isLog(this.job.spec[this.along]) || null, left, right, bottom, top,
      width: Math.min(2000, Math.max(200, Math.round((room.clientWidth - 92) * dots()))),
      height: Math.min(1000, Math.max(200, Math.round((room.clientHeight - 80) * dots()))),
    };
    return Promise.all(this.chosenRamps.map((direction) => lineOf(this.job, { ...asked, direction }, window, options)));
  }

  async ask(signal) {
    this.fetchAhead.cancel();
    this.ahead?.abort();
    const { along } = this;
    const window = this.#isDense() ? this.window : null;
    const lines = await this.#fetch(this.fixed, window, { signal });
    if (along !== this.along) throw new DOMException("the axis was changed", "AbortError");
    this.lines = lines;
    this.at = this.at && lines.length ? this.#cell(lines[0], this.at.cell) : null;
    if (this.window && !window && this.#isDense()) return this.ask(signal); // only now is it known that there are so many
    if (this.whither && this.job.state === "done") this.fetchAhead();
    return { along, ...lines[0]?.fixed };
  }

  /** What the slider will want next, while nobody waits for anything. */
  async #fetchAhead() {
    const { axis, sign } = this.whither;
    const values = this.grid[axis];
    const here = nearest(values, this.fixed[axis]);
    const window = this.#isDense() ? this.window : null;
    this.ahead = new AbortController();
    try {
      for (const step of AHEAD) {
        const value = values[within(here + sign * step, values.length)];
        await this.#fetch({ ...this.fixed, [axis]: value }, window, { signal: this.ahead.signal, priority: "low" });
      }
    } catch {
      // It will be asked for again, and told of, when somebody wants it.
    }
  }

  #isDense() {
    return Boolean(this.lines?.some((line) => line.arrays.density));
  }

  whole() {
    const values = this.grid[this.along];
    const highest = Math.max(...this.lines.map((line) => line.highest), 0) || TURN;
    const [x0, x1] = spread(values[0], values[values.length - 1]);
    return { x0, x1, y0: 0, y1: 1.06 * highest };
  }

  zoom(window) {
    super.zoom(window);
    if (this.#isDense()) this.load();
  }

  content() {
    if (!this.lines) return null;
    const { x0, x1, y0, y1 } = this.shown();
    const { lines } = this;
    return {
      ...(lines.length ? head(lines, (direction, theme) => this.#colour(direction, theme)) : {}),
      x: { label: SYMBOL[this.along], low: x0, high: x1, log: isLog(this.job.spec[this.along]) },
      y: { label: "flight time φ (rad)", low: y0, high: y1, turns: true },
      message: emptiness(lines),
      layers: [
        (pen, box) => this.along === "gamma" && lines.length && drawOnset(pen, box, lines[0].fixed),
        (pen, box) => drawFlights(pen, box, lines, ({ direction }) => this.#colour(direction, box.theme)),
      ],
      cursor: (pen, box) => {
        const cell = this.#chosenHere();
        if (cell) drawChosen(pen, box, cell[this.along], this.#colour(cell.direction, box.theme));
        if (this.at) drawCell(pen, box, this.at);
      },
    };
  }

  /** A sweep of one ramp is drawn in black, as in the paper. */
  #colour(direction, theme) {
    return colourOf(this.directions.length > 1 ? direction : "rest", theme);
  }

  /** The cell in motion, if it lies on a line that is shown. */
  #chosenHere() {
    const cell = this.chosen();
    const on = ({ direction, fixed }) => direction === cell.direction && Object.entries(fixed).every(([axis, value]) => same(value, cell[axis]));
    return cell && this.lines.some(on) ? cell : null;
  }

  #cell(line, cell) {
    return { line, cell: within(cell, line.arrays.values.length) };
  }

  /** The cell at x; of several directions the one with a flight nearest to y. */
  nearest(x, y) {
    const off = ({ line, cell }) => Math.min(...(flightsOf(line, cell) ?? []).map((time) => Math.abs(time - y)), 1e9);
    const cells = (this.lines ?? []).map((line) => this.#cell(line, nearest(line.arrays.values, x)));
    return cells.sort((one, two) => off(one) - off(two))[0] ?? null;
  }

  step(at, right, up) {
    if (!this.lines?.length) return null;
    if (!at) return this.#cell(this.lines[0], this.lines[0].arrays.values.length >> 1);
    return this.#cell(up ? (this.lines.find((one) => one !== at.line) ?? at.line) : at.line, at.cell + right);
  }

  middle() {
    return this.at?.line.arrays.values[this.at.cell];
  }

  cellOf({ line, cell }) {
    return { ...line.fixed, [this.along]: line.arrays.values[cell], direction: line.direction };
  }

  describe(at) {
    return wordsOn(at, this.along, this.lines.length > 1);
  }

  /** The flights that are shown; those that came as density, from the service. */
  table() {
    if (this.#isDense()) return blobOf(`/v1/jobs/${this.job.id}/diagram?${query({ ...this.#asked(), format: "csv" })}`);
    return tableOf(this.lines, this.along, this.shown());
  }
}

/** The axis with most values makes the best picture; of equals Γ. */
function longest(grid) {
  return Object.keys(SYMBOL).reduce((best, axis) => (grid[axis].length > grid[best].length ? axis : best));
}
