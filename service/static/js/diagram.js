// The explorer: flight times along one axis, the others moved by sliders, up and down over each other.

import { note, noted } from "./address.js";
import { blobOf, query } from "./api.js";
import { controls } from "./diagram-controls.js";
import { drawCell, drawChosen, drawOnset, head } from "./diagram-drawing.js";
import { h, newest, say } from "./dom.js";
import { csv, downloads, fileName, netcdf } from "./downloads.js";
import { drawFlights, flightsOf } from "./flights.js";
import { number, plural } from "./format.js";
import { gestures, zoomed } from "./gestures.js";
import { lineOf } from "./lines.js";
import { SYMBOL, TURN, isLog, modeText, nearest, same } from "./physics.js";
import { Plot } from "./plot.js";
import { spread } from "./scale.js";
import { colourOf } from "./theme.js";
import { askWindow, noteWindow } from "./zoom.js";

const MOST = 250_000; // flights that come as points; more come as density
const HINT = "Point at a cell to read it, click to see it move, drag to zoom, double-click to see all.";

export class Diagram {
  constructor(root, { job, grid, directions, choose, chosen, fail }) {
    Object.assign(this, { job, grid, directions, fail, chosen, shows: choose });
    const asked = noted();
    const axes = Object.keys(SYMBOL);
    this.axes = axes.filter((axis) => grid[axis].length > 1);
    this.along = this.axes.includes(asked.along) ? asked.along : (this.axes[0] ?? "gamma");
    this.fixed = Object.fromEntries(axes.map((axis) => [axis, startOf(grid[axis], asked[axis])]));
    this.least = Number(asked.min) || 0;
    this.shown = directions.filter((one) => !asked.show || asked.show.split(",").includes(one));
    this.window = askWindow(asked);
    this.lines = [];
    this.at = null; // {line, cell} under the cursor
    this.load = newest(() => this.#load());
    this.controls = h("div", {});
    this.readout = h("p", { className: "readout" }, HINT);
    const figure = h("figure", {});
    root.replaceChildren(this.controls, figure, this.readout, this.#downloads());
    this.plot = new Plot(figure, {
      label: "Bifurcation diagram. Arrow keys step from cell to cell, Enter shows the cell in motion, plus and minus zoom, 0 shows all.",
      content: () => this.#content(),
    });
    gestures(this.plot, {
      hover: (x, y) => this.#point(this.#nearest(x, y)),
      leave: () => this.#point(null),
      pick: (x, y) => this.#choose(this.#nearest(x, y)),
      choose: () => this.#choose(this.at),
      step: (right, up) => this.#step(right, up),
      zoom: (window) => this.#zoom(window),
      closer: (factor) => this.#zoom(zoomed(this.#window(), this.#whole(), factor, this.at?.line.arrays.values[this.at.cell])),
    });
    this.#control();
    this.load();
  }

  close() {
    this.plot.close();
  }

  update(job) {
    this.job = job;
    this.load();
  }

  #control() {
    this.controls.replaceChildren(controls(this, {
      turn: (along) => {
        Object.assign(this, { along, lines: [], at: null });
        note({ along });
        this.#control();
        this.#zoom(null);
        this.load();
      },
      move: (axis, value) => {
        this.fixed[axis] = value;
        note({ [axis]: Number(value.toPrecision(10)) });
        this.load();
      },
      show: (directions) => {
        this.shown = directions;
        note({ show: directions.length === this.directions.length ? null : directions.join() || "none" });
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
  #asked() {
    const still = Object.fromEntries(Object.entries(this.fixed).filter(([axis]) => axis !== this.along));
    return { along: this.along, ...still, min_flight: this.least || null };
  }

  async #load() {
    const dense = this.window !== null && this.#isDense();
    const { x0: left, x1: right, y0: bottom, y1: top } = dense ? this.window : {};
    const asked = {
      ...this.#asked(), most: MOST, log: isLog(this.job.spec[this.along]) || null, left, right, bottom, top,
      width: Math.min(2000, Math.max(200, this.plot.element.clientWidth - 92)), height: 420,
    };
    try {
      this.lines = await Promise.all(this.shown.map((direction) => lineOf(this.job, { ...asked, direction }, dense ? this.window : null)));
    } catch (error) {
      this.fail(error);
      return;
    }
    this.at = this.at && this.lines.length ? this.#cell(this.lines[0], this.at.cell) : null;
    this.plot.draw();
    this.plot.element.dataset.shows = JSON.stringify({ along: this.along, ...this.lines[0]?.fixed });
    if (this.window && !dense && this.#isDense()) await this.#load(); // only now is it known that there are so many
  }

  #isDense() {
    return this.lines.some((line) => line.arrays.density);
  }

  #whole() {
    const values = this.grid[this.along];
    const highest = Math.max(...this.lines.map((line) => line.highest), 0) || TURN;
    const [x0, x1] = spread(values[0], values[values.length - 1]);
    return { x0, x1, y0: 0, y1: 1.06 * highest };
  }

  #window() {
    return this.window ?? this.#whole();
  }

  #zoom(window) {
    this.window = window;
    noteWindow(window);
    this.plot.redraw();
    if (this.#isDense()) this.load();
  }

  #content() {
    if (!this.lines.length) return null;
    const { x0, x1, y0, y1 } = this.#window();
    return {
      ...head(this.lines),
      x: { label: SYMBOL[this.along], low: x0, high: x1, log: isLog(this.job.spec[this.along]) },
      y: { label: "flight time φ (rad)", low: y0, high: y1, turns: true },
      layers: [
        (pen, box) => this.along === "gamma" && drawOnset(pen, box, this.lines[0].fixed),
        (pen, box) => drawFlights(pen, box, this.lines, ({ direction }) => colourOf(direction, box.theme)),
      ],
      cursor: (pen, box) => {
        const cell = this.#chosenHere();
        if (cell) drawChosen(pen, box, cell[this.along], colourOf(cell.direction, box.theme));
        pen.strokeStyle = box.theme.cursor;
        if (this.at) drawCell(pen, box, this.at);
      },
    };
  }

  /** The cell in motion, if it lies on a line that is shown. */
  #chosenHere() {
    const cell = this.chosen();
    const on = ({ direction, fixed }) => direction === cell.direction && Object.entries(fixed).every(([axis, value]) => same(value, cell[axis]));
    return cell && this.lines.some(on) ? cell : null;
  }

  #cell(line, cell) {
    return { line, cell: Math.min(Math.max(cell, 0), line.arrays.values.length - 1) };
  }

  /** The cell at x; of several directions the one with a flight nearest to y. */
  #nearest(x, y) {
    const off = ({ line, cell }) => Math.min(...(flightsOf(line, cell) ?? []).map((time) => Math.abs(time - y)), 1e9);
    const cells = this.lines.map((line) => this.#cell(line, nearest(line.arrays.values, x)));
    return cells.sort((one, two) => off(one) - off(two))[0] ?? null;
  }

  #point(at) {
    if (at?.cell === this.at?.cell && at?.line === this.at?.line) return;
    this.at = at;
    this.readout.textContent = at ? this.#describe(at) : HINT;
    this.plot.drawCursor();
  }

  #step(right, up) {
    if (!this.lines.length) return;
    if (!this.at) this.#point(this.#cell(this.lines[0], this.grid[this.along].length >> 1));
    else {
      const { line, cell } = this.at;
      this.#point(this.#cell(up ? (this.lines.find((one) => one !== line) ?? line) : line, cell + right));
    }
    say(this.readout.textContent);
  }

  #choose(at) {
    if (!at) return;
    this.#point(at);
    const { line, cell } = at;
    this.shows({ ...line.fixed, [this.along]: line.arrays.values[cell], direction: line.direction });
  }

  #describe({ line, cell }) {
    const { values, outcome, bounces, periods, shown } = line.arrays;
    const parts = [`${SYMBOL[this.along]} = ${number(values[cell])}`];
    if (this.lines.length > 1) parts.push(`ramp ${line.direction}`);
    parts.push(modeText(outcome[cell], bounces[cell], periods[cell]));
    if (outcome[cell] === 1) parts.push(`${plural(bounces[cell], "bounce")} in ${plural(periods[cell], "plate period")}`);
    const times = flightsOf(line, cell);
    if (times?.length && times.length <= 6) parts.push(`flights of ${times.map((one) => number(one, 4)).join(", ")} rad`);
    else if (shown[cell]) parts.push(`${plural(shown[cell], "flight")} stored`);
    return parts.join(" · ");
  }

  #downloads() {
    const name = (kind) => () => fileName(this.job, `${this.along}-phi`, kind);
    return downloads([
      ["PNG", name("png"), () => this.plot.png()],
      ["SVG", name("svg"), () => this.plot.svg()],
      ["CSV", name("csv"), () => this.#table()],
      ["NetCDF", () => fileName(this.job, "sweep", "nc"), netcdf(this.job)],
    ]);
  }

  /** The flights that are shown; those that came as density, from the service. */
  #table() {
    if (this.#isDense()) return blobOf(`/v1/jobs/${this.job.id}/diagram?${query({ ...this.#asked(), format: "csv" })}`);
    const { x0, x1, y0, y1 } = this.#window();
    const rows = [];
    for (const { arrays, starts, direction, fixed } of this.lines) {
      arrays.values.forEach((value, i) => {
        if (value < x0 || value > x1) return;
        const { gamma, omega, xi } = { ...fixed, [this.along]: value };
        for (const time of arrays.flight_time.subarray(starts[i], starts[i + 1])) {
          if (time >= y0 && time <= y1) rows.push([direction, gamma, omega, xi, time, arrays.bounces[i], arrays.periods[i]]);
        }
      });
    }
    return csv(["direction", "gamma", "omega", "xi", "flight_time_rad", "bounces", "periods"], rows);
  }
}

/** The value of an axis nearest to the one asked for, or the middle one. */
function startOf(values, asked) {
  const wanted = asked === undefined ? NaN : Number(asked);
  return values[Number.isFinite(wanted) ? nearest(values, wanted) : values.length >> 1];
}
