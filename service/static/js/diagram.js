// The explorer: flight times along one axis, the others moved by sliders, up and down over each other.

import { note, noted } from "./address.js";
import { blobOf, query } from "./api.js";
import { h, newest, say } from "./dom.js";
import { csv, downloads, fileName, netcdf } from "./downloads.js";
import { drawFlights, flightsOf } from "./flights.js";
import { number, plural } from "./format.js";
import { gestures, zoomed } from "./gestures.js";
import { lineOf } from "./lines.js";
import { SYMBOL, TURN, isLog, modeText, nearest, threshold } from "./physics.js";
import { Plot, stroke } from "./plot.js";
import { spread } from "./scale.js";
import { sliders } from "./sliders.js";
import { colourOf } from "./theme.js";
import { askWindow, noteWindow } from "./zoom.js";

const MOST = 250_000; // flights that come as points; more come as density

export class Diagram {
  constructor(root, view) {
    Object.assign(this, view); // {job, grid, directions, choose, fail}
    const asked = noted();
    this.axes = ["gamma", "omega", "xi"].filter((axis) => this.grid[axis].length > 1);
    this.along = this.axes.includes(asked.along) ? asked.along : (this.axes[0] ?? "gamma");
    this.fixed = Object.fromEntries(["gamma", "omega", "xi"].map((axis) => [axis, startOf(this.grid[axis], asked[axis])]));
    this.least = Number(asked.min) || 0;
    this.shown = this.directions.filter((one) => !asked.show || asked.show.split(",").includes(one));
    this.window = askWindow(asked);
    this.lines = [];
    this.at = null; // {line, cell}: under the cursor
    this.load = newest(() => this.#load());
    this.root = root;
    this.#build();
    this.load();
  }

  close() {
    this.plot.close();
  }

  update(job) {
    this.job = job;
    this.load();
  }

  #build() {
    this.controls = h("div", { className: "controls" });
    this.#controls();
    this.readout = h("p", { className: "readout" }, HINT);
    const figure = h("figure", {});
    this.root.replaceChildren(this.controls, figure, this.readout, this.#downloads());
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
      closer: (factor) => this.#zoom(zoomed(this.#window(), this.#whole(), factor, this.#value())),
    });
  }

  #controls() {
    const along = this.axes.length > 1 && h("label", { className: "pick" }, "Diagram ",
      h("select", { onchange: (event) => this.#turn(event.target.value), "aria-label": "Axis of the diagram" },
        this.axes.map((axis) => h("option", { value: axis, selected: axis === this.along }, `${SYMBOL[axis]}–φ`))));
    const others = ["gamma", "omega", "xi"].filter((axis) => axis !== this.along);
    const shown = this.directions.length > 1 && h("fieldset", { className: "directions" },
      h("legend", {}, "Ramp"), this.directions.map((one) => this.#direction(one)));
    const least = h("label", { className: "pick" }, "Hide flights under ",
      h("input", {
        type: "number", min: 0, step: "any", value: this.least || "", placeholder: "0", size: 5,
        onchange: (event) => {
          this.least = Math.max(0, Number(event.target.value) || 0);
          note({ min: this.least || null });
          this.load();
        },
      }), " rad");
    this.controls.replaceChildren(...[along, sliders(others, this.grid, this.fixed, (axis, value) => this.#move(axis, value)), shown, least].filter(Boolean));
  }

  #direction(one) {
    return h("label", { className: `key ${one}` },
      h("input", {
        type: "checkbox", checked: this.shown.includes(one),
        onchange: (event) => {
          this.shown = this.directions.filter((other) => (other === one ? event.target.checked : this.shown.includes(other)));
          note({ show: this.shown.length === this.directions.length ? null : this.shown.join(",") || "none" });
          this.load();
        },
      }), ` ${one}`);
  }

  #turn(along) {
    this.along = along;
    note({ along });
    this.#controls();
    this.lines = [];
    this.#zoom(null);
    this.load();
  }

  #move(axis, value) {
    this.fixed[axis] = value;
    note({ [axis]: number7(value) });
    this.load();
  }

  async #load() {
    const fixed = Object.fromEntries(Object.entries(this.fixed).filter(([axis]) => axis !== this.along));
    const dense = this.window && this.lines.some((line) => line.arrays.density);
    const window = dense ? { left: this.window.x0, right: this.window.x1, bottom: this.window.y0, top: this.window.y1 } : {};
    const asked = {
      along: this.along, ...fixed, min_flight: this.least || null, most: MOST, log: isLog(this.job.spec[this.along]) || null,
      width: Math.min(2000, Math.max(200, this.plot.element.clientWidth - 92)), height: 420, ...window,
    };
    try {
      const seen = dense ? this.window : null;
      this.lines = await Promise.all(this.shown.map((direction) => lineOf(this.job, { ...asked, direction }, seen)));
    } catch (error) {
      this.fail(error);
      return;
    }
    this.at = this.at && this.lines.length ? this.#at(this.lines[0], this.at.cell) : null;
    this.plot.draw();
    this.plot.element.dataset.shows = JSON.stringify({ along: this.along, ...this.lines[0]?.fixed });
    if (!dense && this.window && this.lines.some((line) => line.arrays.density)) await this.#load();
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
    if (this.lines.some((line) => line.arrays.density)) this.load();
  }

  #content() {
    if (!this.lines.length) return null;
    const { x0, x1, y0, y1 } = this.#window();
    return {
      x: { label: SYMBOL[this.along], low: x0, high: x1, log: isLog(this.job.spec[this.along]) },
      y: { label: "flight time φ (rad)", low: y0, high: y1, turns: true },
      layers: [
        (pen, box) => this.#drawOnset(pen, box),
        (pen, box) => this.lines.forEach((line) => drawFlights(pen, box, line, colourOf(line.direction, box.theme))),
        (pen, box) => this.#drawTitle(pen, box),
      ],
      cursor: (pen, box) => this.#drawCursor(pen, box),
    };
  }

  /** Γ_th of Eq. 25, where a spring at rest begins to bounce. */
  #drawOnset(pen, box) {
    if (this.along !== "gamma") return;
    const { omega, xi } = this.lines[0].fixed;
    const x = box.x.place(threshold(omega, xi));
    if (!(x >= box.left && x <= box.left + box.width)) return;
    stroke(pen, box.theme.onset, 1.2, [[x, box.top], [x, box.top + box.height]], [5, 4]);
    pen.fillStyle = box.theme.onset;
    pen.font = `italic 14px ${box.theme.serif}`;
    pen.textAlign = "left";
    pen.textBaseline = "top";
    pen.fillText("Γ", x + 5, box.top + 8);
    pen.font = `10px ${box.theme.serif}`;
    pen.fillText("th", x + 14, box.top + 15);
  }

  #drawTitle(pen, box) {
    const fixed = Object.entries(this.lines[0].fixed).map(([axis, value]) => `${SYMBOL[axis]} = ${number(value)}`);
    pen.fillStyle = box.theme.ink;
    pen.font = `14px ${box.theme.serif}`;
    pen.textAlign = "right";
    pen.textBaseline = "top";
    pen.fillText(fixed.join(",   "), box.left + box.width - 10, box.top + 8);
    if (this.lines.length > 1) {
      this.lines.forEach(({ direction }, i) => {
        pen.fillStyle = colourOf(direction, box.theme);
        pen.fillText(direction === "up" ? "▲ up" : "▼ down", box.left + box.width - 10 - 60 * (this.lines.length - 1 - i), box.top + 28);
      });
    }
  }

  #drawCursor(pen, box) {
    if (!this.at) return;
    const { line, cell } = this.at;
    const x = box.x.place(line.arrays.values[cell]);
    stroke(pen, box.theme.cursor, 1, [[x, box.top], [x, box.top + box.height]]);
    for (const time of flightsOf(line, cell)?.slice(0, 200) ?? []) {
      pen.strokeStyle = box.theme.cursor;
      pen.lineWidth = 1.5;
      pen.beginPath();
      pen.arc(x, box.y.place(time), 4.5, 0, 2 * Math.PI);
      pen.stroke();
    }
  }

  #at(line, cell) {
    return { line, cell: Math.min(Math.max(cell, 0), line.arrays.values.length - 1) };
  }

  /** The cell at x; of several directions the one with a flight nearest to y. */
  #nearest(x, y) {
    const found = this.lines.map((line) => this.#at(line, nearest(line.arrays.values, x)));
    const off = ({ line, cell }) => Math.min(...(flightsOf(line, cell) ?? []).map((time) => Math.abs(time - y)), 1e9);
    return found.sort((one, two) => off(one) - off(two))[0] ?? null;
  }

  #value() {
    return this.at ? this.at.line.arrays.values[this.at.cell] : undefined;
  }

  #point(at) {
    if (at?.cell === this.at?.cell && at?.line === this.at?.line) return;
    this.at = at;
    this.readout.textContent = at ? this.#describe(at) : HINT;
    this.plot.drawCursor();
  }

  #step(right, up) {
    if (!this.lines.length) return;
    const { line, cell } = this.at ?? this.#at(this.lines[0], 0);
    const other = up ? (this.lines.find((one) => one !== line) ?? line) : line;
    this.#point(this.at ? this.#at(other, cell + right) : this.#at(line, this.grid[this.along].length >> 1));
    say(this.readout.textContent);
  }

  #choose(at) {
    if (!at) return;
    this.#point(at);
    const { line, cell } = at;
    this.choose({ ...line.fixed, [this.along]: line.arrays.values[cell], direction: line.direction });
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

  /** The flights that are shown; those of a line that came as density, from the service. */
  #table() {
    const fixed = Object.fromEntries(Object.entries(this.fixed).filter(([axis]) => axis !== this.along));
    if (this.lines.some((line) => line.arrays.density)) {
      return blobOf(`/v1/jobs/${this.job.id}/diagram?${query({ along: this.along, ...fixed, min_flight: this.least || null, format: "csv" })}`);
    }
    const { x0, x1, y0, y1 } = this.#window();
    const rows = [];
    for (const { arrays, starts, direction, fixed: still } of this.lines) {
      arrays.values.forEach((value, i) => {
        const here = { ...still, [this.along]: value };
        if (value < x0 || value > x1) return;
        for (let j = starts[i]; j < starts[i + 1]; j++) {
          const time = arrays.flight_time[j];
          if (time < y0 || time > y1) continue;
          rows.push([direction, here.gamma, here.omega, here.xi, time, arrays.bounces[i], arrays.periods[i]]);
        }
      });
    }
    return csv(["direction", "gamma", "omega", "xi", "flight_time_rad", "bounces", "periods"], rows);
  }
}

const HINT = "Point at a cell to read it, click to see it move, drag to zoom, double-click to see all.";

const number7 = (value) => Number(value.toPrecision(10));

function startOf(values, asked) {
  const wanted = asked === undefined ? NaN : Number(asked);
  return values[Number.isFinite(wanted) ? nearest(values, wanted) : values.length >> 1];
}
