// The mode map: what became of every cell in (Γ, Ω), with Γ_th over it.

import { note } from "../lib/address.js";
import { askPacked, query } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { csv } from "../lib/downloads.js";
import { number, ordinal, plural } from "../lib/format.js";
import { classes, colour } from "../plot/colours.js";
import { circle, packed, picture, stroke } from "../plot/drawing.js";
import { OUTCOME, SYMBOL, isLog, modeText, nearest, same, startOf, threshold } from "../lib/physics.js";
import { PlotView, within } from "./plot-view.js";
import { edges } from "../plot/scale.js";
import { sliders } from "./sliders.js";
import { onThemeChange, theme } from "../plot/theme.js";

const HINT = "Point at a cell to read it, click to see it move, drag to zoom. The dashed line is the threshold of Eq. 25.";

export class Modes extends PlotView {
  name = "modes";
  thinned = false; // whether the whole map has more cells than are sent

  constructor(root, view) {
    super(view);
    this.xi = startOf(this.grid.xi, this.asked.xi);
    this.direction = this.directions.includes(this.asked.dir) ? this.asked.dir : this.directions[0];
    this.legend = h("ul", { className: "legend", "aria-label": "Modes: bounces, plate periods" });
    this.left = h("p", { className: "note", hidden: true }); // what is left out
    this.build(root, {
      controls: this.#controls(), label: "Mode map", hint: HINT, ratio: 0.6,
      below: h("div", {}, this.left, this.legend),
    });
    onThemeChange(() => this.plane && this.#explain(), this.plot.ending.signal);
  }

  #controls() {
    const moved = (_, value) => {
      this.xi = value;
      note({ xi: Number(value.toPrecision(10)) });
      this.load();
    };
    const turned = (event) => {
      this.direction = event.target.value;
      note({ dir: this.direction });
      this.load();
    };
    const ramps = this.directions.map((one) => h("option", { value: one, selected: one === this.direction }, one));
    return h("div", { className: "controls" }, sliders(["xi"], this.grid, { xi: this.xi }, moved),
      this.directions.length > 1 && h("label", { className: "pick" }, "Ramp ", h("select", { onchange: turned }, ramps)));
  }

  /** The whole map, or where it has too many cells and is zoomed to, more of what is seen. */
  async ask(signal) {
    const { x0: left, x1: right, y0: bottom, y1: top } = (this.thinned && this.window) || {};
    const asked = query({ xi: this.xi, direction: this.direction, left, right, bottom, top });
    this.plane = await askPacked(`/v1/jobs/${this.job.id}/plane?${asked}`, { signal });
    this.axes = this.plane.arrays; // gamma and omega: of the cells that came
    this.classes = classes(this.plane.arrays);
    this.#explain();
    if (this.window && this.thinned && left === undefined) return this.ask(signal); // only now is it known that there are so many
    return { xi: this.plane.xi, direction: this.plane.direction };
  }

  zoom(window) {
    super.zoom(window);
    if (this.thinned) this.load();
  }

  /** Which colour is what, and which cells are left out. */
  #explain() {
    const total = this.classes.of.length;
    this.legend.replaceChildren(...this.classes.found.map(({ kind, name, cells }) => {
      const swatch = h("span", { className: "swatch", "aria-hidden": "true" });
      swatch.style.background = colour(kind, theme().dark);
      return h("li", {}, swatch, name, " ", h("small", {}, share(cells, total)));
    }));
    const steps = [[this.plane.every_gamma, SYMBOL.gamma], [this.plane.every_omega, SYMBOL.omega]].filter(([every]) => every > 1);
    this.thinned ||= steps.length > 0;
    this.left.hidden = !steps.length;
    this.left.textContent = `Shown: every ${steps.map(([every, symbol]) => `${ordinal(every)} ${symbol}`).join(" and every ")}. Zoom in for more.`;
  }

  whole() {
    const [x, y] = [edges(this.grid.gamma), edges(this.grid.omega)];
    // A logarithmic axis must not begin at or below nothing.
    const low = (borders, values) => (borders[0] > 0 ? borders[0] : values[0]);
    return { x0: low(x, this.grid.gamma), x1: x.at(-1), y0: low(y, this.grid.omega), y1: y.at(-1) };
  }

  content() {
    if (!this.plane) return null;
    const { x0, x1, y0, y1 } = this.shown();
    const { found } = this.classes;
    return {
      x: { label: SYMBOL.gamma, low: x0, high: x1, log: isLog(this.job.spec.gamma) },
      y: { label: SYMBOL.omega, low: y0, high: y1, log: isLog(this.job.spec.omega) },
      title: `ξ = ${number(this.plane.xi)}${this.directions.length > 1 ? `, ramp ${this.plane.direction}` : ""}`,
      key: [["threshold, Eq. 25", (pen, x, y, theme) => stroke(pen, theme.ink, 1.8, [[x, y], [x + 24, y]], [7, 4])]],
      colours: found.map(({ kind, name }) => [name, (theme) => colour(kind, theme.dark)]),
      message: found.length === 1 && found[0].kind === OUTCOME.missing ? "No cell is computed yet" : null,
      layers: [(pen, box) => this.#drawCells(pen, box), (pen, box) => this.#drawOnset(pen, box)],
      cursor: (pen, box) => this.#drawCursor(pen, box),
    };
  }

  /** Every pixel takes the colour of the cell nearest to it. */
  #drawCells(pen, box) {
    const { gamma, omega } = this.axes;
    const [width, height] = [Math.round(box.width * box.dots), Math.round(box.height * box.dots)];
    const columns = Int32Array.from({ length: width }, (_, i) => nearest(gamma, box.x.value(box.left + ((i + 0.5) * box.width) / width)));
    const shades = new Uint32Array(256);
    for (const { kind } of this.classes.found) shades[kind] = packed(colour(kind, box.theme.dark));
    const fill = (pixels) => {
      for (let row = 0; row < height; row++) {
        const first = nearest(omega, box.y.value(box.top + ((row + 0.5) * box.height) / height)) * gamma.length;
        for (let i = 0; i < width; i++) pixels[row * width + i] = shades[this.classes.of[first + columns[i]]];
      }
    };
    picture(pen, width, height, fill, box.left, box.top, box.left + box.width, box.top + box.height);
  }

  #drawOnset(pen, box) {
    const n = Math.max(2, Math.round(box.height / 2));
    const points = Array.from({ length: n }, (_, i) => {
      const y = box.top + (i * box.height) / (n - 1);
      return [box.x.place(threshold(box.y.value(y), this.plane.xi)), y];
    });
    stroke(pen, box.theme.paper, 4, points);
    stroke(pen, box.theme.ink, 1.8, points, [7, 4]);
  }

  #drawCursor(pen, box) {
    const cell = this.chosen();
    if (cell && cell.direction === this.plane.direction && same(cell.xi, this.plane.xi)) ring(pen, box, cell.gamma, cell.omega, 9);
    if (this.at) ring(pen, box, this.axes.gamma[this.at.column], this.axes.omega[this.at.row], 6);
  }

  nearest(x, y) {
    return this.plane ? { column: nearest(this.axes.gamma, x), row: nearest(this.axes.omega, y) } : null;
  }

  step(at, right, up) {
    if (!this.plane) return null;
    const { gamma, omega } = this.axes;
    const { column, row } = at ?? { column: gamma.length >> 1, row: omega.length >> 1 };
    return { column: within(column + right, gamma.length), row: within(row + up, omega.length) };
  }

  middle() {
    return this.at ? this.axes.gamma[this.at.column] : undefined;
  }

  cellOf({ column, row }) {
    return { gamma: this.axes.gamma[column], omega: this.axes.omega[row], xi: this.plane.xi, direction: this.plane.direction };
  }

  describe({ column, row }) {
    const { gamma, omega, outcome, bounces, periods } = this.plane.arrays;
    const cell = row * gamma.length + column;
    const parts = [`Γ = ${number(gamma[column])}`, `Ω = ${number(omega[row])}`, modeText(outcome[cell], bounces[cell], periods[cell])];
    if (outcome[cell] === OUTCOME.periodic) parts.push(`${plural(bounces[cell], "bounce")} in ${plural(periods[cell], "plate period")}`);
    return parts.join(" · ");
  }

  table() {
    const { gamma, omega, outcome, bounces, periods } = this.plane.arrays;
    const row = (_, i) => [gamma[i % gamma.length], omega[Math.floor(i / gamma.length)], this.plane.xi, outcome[i], bounces[i], periods[i]];
    return csv(["gamma", "omega", "xi", "outcome", "bounces", "periods"], Array.from(outcome, row));
  }
}

/** A ring that shows on every colour. */
function ring(pen, { x, y, theme }, gamma, omega, radius) {
  circle(pen, theme.paper, 4.5, x.place(gamma), y.place(omega), radius);
  circle(pen, theme.cursor, 2, x.place(gamma), y.place(omega), radius);
}

const share = (cells, total) => `${cells / total < 0.001 ? "<0.1" : number((100 * cells) / total, 2)} %`;
