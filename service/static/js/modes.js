// The mode map: what became of every cell in (Γ, Ω), with Γ_th over it.

import { note, noted } from "./address.js";
import { askPacked, query } from "./api.js";
import { h, newest, say } from "./dom.js";
import { csv, downloads, fileName, netcdf } from "./downloads.js";
import { count, number, plural } from "./format.js";
import { gestures, zoomed } from "./gestures.js";
import { colour, kinds, nameOf, partsOf } from "./palette.js";
import { SYMBOL, isLog, modeText, nearest, same, threshold } from "./physics.js";
import { Plot, stroke } from "./plot.js";
import { edges } from "./scale.js";
import { sliders } from "./sliders.js";
import { rgb } from "./theme.js";
import { askWindow, noteWindow } from "./zoom.js";

const LEGEND = 14; // entries; the rest is summed up

export class Modes {
  constructor(root, view) {
    Object.assign(this, view);
    const asked = noted();
    this.xi = this.grid.xi[nearest(this.grid.xi, Number(asked.xi ?? this.grid.xi[0]))];
    this.direction = this.directions.includes(asked.dir) ? asked.dir : this.directions[0];
    this.window = askWindow(asked);
    this.at = null;
    this.load = newest(() => this.#load());
    this.legend = h("ul", { className: "legend", "aria-label": "Modes" });
    this.readout = h("p", { className: "readout" }, HINT);
    const figure = h("figure", {});
    root.replaceChildren(this.#controls(), figure, this.legend, this.readout, this.#downloads());
    this.plot = new Plot(figure, {
      label: "Mode map. Arrow keys step from cell to cell, Enter shows the cell in motion, plus and minus zoom, 0 shows all.",
      content: () => this.#content(),
      ratio: 0.6,
    });
    gestures(this.plot, {
      hover: (x, y) => this.#point(this.#nearest(x, y)),
      leave: () => this.#point(null),
      pick: (x, y) => this.#choose(this.#nearest(x, y)),
      choose: () => this.#choose(this.at),
      step: (right, up) => this.#step(right, up),
      zoom: (window) => this.#zoom(window),
      closer: (factor) => this.#zoom(zoomed(this.#window(), this.#whole(), factor, this.at ? this.grid.gamma[this.at.column] : undefined)),
    });
    this.load();
  }

  close() {
    this.plot.close();
  }

  update(job) {
    this.job = job;
    this.load();
  }

  #controls() {
    const moved = (_, value) => {
      this.xi = value;
      note({ xi: Number(value.toPrecision(10)) });
      this.load();
    };
    const direction = this.directions.length > 1 && h("label", { className: "pick" }, "Ramp ",
      h("select", {
        onchange: (event) => {
          this.direction = event.target.value;
          note({ dir: this.direction });
          this.load();
        },
      }, this.directions.map((one) => h("option", { value: one, selected: one === this.direction }, one))));
    return h("div", { className: "controls" }, sliders(["xi"], this.grid, { xi: this.xi }, moved), direction);
  }

  async #load() {
    try {
      this.plane = await askPacked(`/v1/jobs/${this.job.id}/plane?${query({ xi: this.xi, direction: this.direction })}`);
    } catch (error) {
      this.fail(error);
      return;
    }
    this.#describeKinds();
    this.plot.draw();
    this.plot.element.dataset.shows = JSON.stringify({ xi: this.plane.xi, direction: this.plane.direction });
  }

  #describeKinds() {
    const all = kinds(this.plane.arrays);
    this.entries = [];
    const dark = matchMedia("(prefers-color-scheme: dark)").matches;
    const few = all.length <= LEGEND ? all : [...all].sort((one, two) => two[1] - one[1]).slice(0, LEGEND - 1).sort(([one], [two]) => one - two);
    const rest = all.filter((one) => !few.includes(one)).reduce((sum, [, cells]) => sum + cells, 0);
    const total = this.plane.arrays.outcome.length;
    this.legend.replaceChildren(...few.map(([key, cells]) => {
      const swatch = h("span", { className: "swatch", "aria-hidden": "true" });
      swatch.style.background = colour(...partsOf(key), dark);
      this.entries.push([nameOf(key), key]);
      return h("li", {}, swatch, nameOf(key), " ", h("small", {}, share(cells, total)));
    }));
    if (rest) this.legend.append(h("li", {}, `${count(all.length - few.length)} other modes `, h("small", {}, share(rest, total))));
  }

  #whole() {
    const [x, y] = [edges(this.grid.gamma), edges(this.grid.omega)];
    // A logarithmic axis must not begin at or below nothing.
    const low = (borders, values) => (borders[0] > 0 ? borders[0] : values[0]);
    return { x0: low(x, this.grid.gamma), x1: x.at(-1), y0: low(y, this.grid.omega), y1: y.at(-1) };
  }

  #window() {
    return this.window ?? this.#whole();
  }

  #zoom(window) {
    this.window = window;
    noteWindow(window);
    this.plot.redraw();
  }

  #content() {
    if (!this.plane) return null;
    const { x0, x1, y0, y1 } = this.#window();
    return {
      x: { label: SYMBOL.gamma, low: x0, high: x1, log: isLog(this.job.spec.gamma) },
      y: { label: SYMBOL.omega, low: y0, high: y1, log: isLog(this.job.spec.omega) },
      title: `ξ = ${number(this.plane.xi)}${this.directions.length > 1 ? `, ramp ${this.plane.direction}` : ""}`,
      key: [["threshold, Eq. 25", (pen, x, y, theme) => stroke(pen, theme.ink, 1.8, [[x, y], [x + 24, y]], [7, 4])]],
      colours: this.entries.map(([name, key]) => [name, (theme) => colour(...partsOf(key), theme.dark)]),
      layers: [(pen, box) => this.#drawCells(pen, box), (pen, box) => this.#drawOnset(pen, box)],
      cursor: (pen, box) => this.#drawCursor(pen, box),
    };
  }

  /** Every pixel takes the colour of the cell nearest to it. */
  #drawCells(pen, box) {
    const { outcome, bounces, periods } = this.plane.arrays;
    const [width, height] = [Math.round(box.width), Math.round(box.height)];
    const columns = Int32Array.from({ length: width }, (_, i) => nearest(this.grid.gamma, box.x.value(box.left + ((i + 0.5) * box.width) / width)));
    const canvas = h("canvas", { width, height });
    const sheet = canvas.getContext("2d");
    const image = sheet.createImageData(width, height);
    const pixels = new Uint32Array(image.data.buffer);
    const shades = new Map();
    for (let row = 0; row < height; row++) {
      const first = nearest(this.grid.omega, box.y.value(box.top + ((row + 0.5) * box.height) / height)) * this.grid.gamma.length;
      for (let i = 0; i < width; i++) {
        const cell = first + columns[i];
        const key = outcome[cell] * 2 ** 20 + Math.min(periods[cell], 999) * 1024 + Math.min(bounces[cell], 1023);
        let shade = shades.get(key);
        if (shade === undefined) {
          const [r, g, b] = rgb(colour(outcome[cell], bounces[cell], periods[cell], box.theme.dark));
          shade = ((255 << 24) | (b << 16) | (g << 8) | r) >>> 0;
          shades.set(key, shade);
        }
        pixels[row * width + i] = shade;
      }
    }
    sheet.putImageData(image, 0, 0);
    pen.imageSmoothingEnabled = false;
    pen.drawImage(canvas, box.left, box.top, box.width, box.height);
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
    if (this.at) ring(pen, box, this.grid.gamma[this.at.column], this.grid.omega[this.at.row], 6);
  }

  #nearest(x, y) {
    return this.plane ? { column: nearest(this.grid.gamma, x), row: nearest(this.grid.omega, y) } : null;
  }

  #point(at) {
    this.at = at;
    this.readout.textContent = at ? this.#describe(at) : HINT;
    this.plot.drawCursor();
  }

  #step(right, up) {
    const { gamma, omega } = this.grid;
    const { column, row } = this.at ?? { column: gamma.length >> 1, row: omega.length >> 1 };
    const within = (value, n) => Math.min(Math.max(value, 0), n - 1);
    this.#point({ column: within(column + right, gamma.length), row: within(row + up, omega.length) });
    say(this.readout.textContent);
  }

  #choose(at) {
    if (!at) return;
    this.#point(at);
    this.choose({ gamma: this.grid.gamma[at.column], omega: this.grid.omega[at.row], xi: this.plane.xi, direction: this.plane.direction });
  }

  #describe({ column, row }) {
    const cell = row * this.grid.gamma.length + column;
    const { outcome, bounces, periods } = this.plane.arrays;
    const parts = [`Γ = ${number(this.grid.gamma[column])}`, `Ω = ${number(this.grid.omega[row])}`, modeText(outcome[cell], bounces[cell], periods[cell])];
    if (outcome[cell] === 1) parts.push(`${plural(bounces[cell], "bounce")} in ${plural(periods[cell], "plate period")}`);
    return parts.join(" · ");
  }

  #downloads() {
    const name = (kind) => () => fileName(this.job, "modes", kind);
    return downloads([
      ["PNG", name("png"), () => this.plot.png()],
      ["SVG", name("svg"), () => this.plot.svg()],
      ["CSV", name("csv"), () => this.#table()],
      ["NetCDF", () => fileName(this.job, "sweep", "nc"), netcdf(this.job)],
    ]);
  }

  #table() {
    const { outcome, bounces, periods } = this.plane.arrays;
    const { gamma, omega } = this.grid;
    const row = (_, i) => [gamma[i % gamma.length], omega[Math.floor(i / gamma.length)], this.plane.xi, outcome[i], bounces[i], periods[i]];
    return csv(["gamma", "omega", "xi", "outcome", "bounces", "periods"], Array.from(outcome, row));
  }
}

/** A ring that shows on every colour. */
function ring(pen, box, gamma, omega, radius) {
  for (const [colour, width] of [[box.theme.paper, 4.5], [box.theme.cursor, 2]]) {
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    pen.beginPath();
    pen.arc(box.x.place(gamma), box.y.place(omega), radius, 0, 2 * Math.PI);
    pen.stroke();
  }
}

const HINT = "Point at a cell to read it, click to see it move, drag to zoom. The dashed line is the threshold of Eq. 25.";

const share = (cells, total) => `${cells / total < 0.001 ? "<0.1" : number((100 * cells) / total, 2)} %`;
