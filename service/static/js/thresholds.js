// Where bouncing begins on the way up and ends on the way down, per Ω, beside Eq. 25.

import { note, noted } from "./address.js";
import { askJson, query } from "./api.js";
import { h, newest, say } from "./dom.js";
import { csv, downloads, fileName, netcdf } from "./downloads.js";
import { number } from "./format.js";
import { gestures, zoomed } from "./gestures.js";
import { SYMBOL, isLog, nearest, threshold } from "./physics.js";
import { Plot, stroke } from "./plot.js";
import { spread } from "./scale.js";
import { sliders } from "./sliders.js";
import { colourOf } from "./theme.js";
import { askWindow, noteWindow } from "./zoom.js";

export class Thresholds {
  constructor(root, view) {
    Object.assign(this, view);
    const asked = noted();
    this.xi = this.grid.xi[nearest(this.grid.xi, Number(asked.xi ?? this.grid.xi[0]))];
    this.window = askWindow(asked);
    this.at = null;
    this.load = newest(() => this.#load());
    this.readout = h("p", { className: "readout" }, HINT);
    const figure = h("figure", {});
    const moved = (_, value) => {
      this.xi = value;
      note({ xi: Number(value.toPrecision(10)) });
      this.load();
    };
    root.replaceChildren(h("div", { className: "controls" }, sliders(["xi"], this.grid, { xi: this.xi }, moved)),
      figure, this.readout, this.#downloads());
    this.plot = new Plot(figure, {
      label: "Thresholds against the plate's frequency. Arrow keys step, Enter shows the cell in motion, plus and minus zoom, 0 shows all.",
      content: () => this.#content(),
    });
    gestures(this.plot, {
      hover: (x) => this.#point(this.found ? nearest(this.found.omega, x) : null),
      leave: () => this.#point(null),
      pick: (x, y) => this.#choose(nearest(this.found.omega, x), y),
      choose: () => this.at !== null && this.#choose(this.at, this.found.up[this.at] ?? this.found.down[this.at]),
      step: (right) => this.#step(right),
      zoom: (window) => this.#zoom(window),
      closer: (factor) => this.#zoom(zoomed(this.#window(), this.#whole(), factor, this.at === null ? undefined : this.found.omega[this.at])),
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

  async #load() {
    try {
      this.found = await askJson(`/v1/jobs/${this.job.id}/threshold?${query({ xi: this.xi })}`);
    } catch (error) {
      this.fail(error);
      return;
    }
    this.plot.draw();
    this.plot.element.dataset.shows = JSON.stringify({ xi: this.found.xi });
  }

  #whole() {
    const { omega, up, down } = this.found;
    const [x0, x1] = spread(omega[0], omega[omega.length - 1]);
    const simulated = [...up, ...down].filter((value) => value !== null);
    const highest = Math.max(...(simulated.length ? simulated : [threshold(x0, this.found.xi), 1]));
    return { x0, x1, y0: 0, y1: 1.12 * highest };
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
    if (!this.found) return null;
    const { x0, x1, y0, y1 } = this.#window();
    return {
      x: { label: SYMBOL.omega, low: x0, high: x1, log: isLog(this.job.spec.omega) },
      y: { label: "threshold Γ", low: y0, high: y1 },
      title: `ξ = ${number(this.found.xi)}`,
      key: this.#key(),
      layers: [(pen, box) => this.#draw(pen, box)],
      cursor: (pen, box) => {
        if (this.at === null) return;
        const x = box.x.place(this.found.omega[this.at]);
        stroke(pen, box.theme.cursor, 1, [[x, box.top], [x, box.top + box.height]]);
      },
    };
  }

  #draw(pen, box) {
    const n = Math.round(box.width / 2);
    const curve = Array.from({ length: n + 1 }, (_, i) => {
      const x = box.left + (i * box.width) / n;
      return [x, box.y.place(threshold(box.x.value(x), this.found.xi))];
    });
    stroke(pen, box.theme.onset, 1.6, curve, [7, 4]);
    for (const [way, , direction] of this.#ways()) {
      drawMarks(pen, box, this.found.omega, this.found[way], colourOf(direction, box.theme), way);
    }
  }

  /** What was simulated: [array, name, direction]. */
  #ways() {
    const first = this.directions[0] === "rest" ? ["up", "from rest", "rest"] : ["up", "ramp up", "up"];
    return [first, ["down", "ramp down", "down"]].filter(([way]) => this.found[way].some((value) => value !== null));
  }

  #key() {
    const line = (pen, x, y, colour, dash, width) => stroke(pen, colour, width, [[x, y], [x + 24, y]], dash);
    return [
      ["Eq. 25", (pen, x, y, theme) => line(pen, x, y, theme.onset, [7, 4], 1.6)],
      ...this.#ways().map(([way, name, direction]) => [name, (pen, x, y, theme) => {
        const colour = colourOf(direction, theme);
        line(pen, x, y, colour, [], 1.2);
        mark(pen, [x + 12, y], 3.4, colour, way, theme.paper);
      }]),
    ];
  }

  #point(at) {
    this.at = at;
    this.readout.textContent = at === null ? HINT : this.#describe(at);
    this.plot.drawCursor();
  }

  #step(right) {
    if (!this.found) return;
    const n = this.found.omega.length;
    this.#point(this.at === null ? n >> 1 : Math.min(Math.max(this.at + right, 0), n - 1));
    say(this.readout.textContent);
  }

  #describe(at) {
    const { omega, analytic, up, down } = this.found;
    const parts = [`Ω = ${number(omega[at])}`, `Eq. 25: Γ = ${number(analytic[at], 4)}`];
    if (up[at] !== null) parts.push(`${this.directions[0] === "rest" ? "from rest" : "up"}: ${number(up[at], 4)}`);
    if (down[at] !== null) parts.push(`down: ${number(down[at], 4)}`);
    return parts.join(" · ");
  }

  #choose(at, y) {
    if (y === null || y === undefined) return;
    const { omega, xi, down } = this.found;
    const falling = down[at] !== null && Math.abs(down[at] - y) < Math.abs((this.found.up[at] ?? 1e9) - y);
    const direction = falling ? "down" : this.directions[0];
    const gamma = this.grid.gamma[nearest(this.grid.gamma, y)];
    this.choose({ gamma, omega: omega[at], xi, direction });
  }

  #downloads() {
    const name = (kind) => () => fileName(this.job, "thresholds", kind);
    const rows = () => this.found.omega.map((omega, i) => [omega, this.found.xi, this.found.analytic[i], this.found.up[i], this.found.down[i]]);
    return downloads([
      ["PNG", name("png"), () => this.plot.png()],
      ["SVG", name("svg"), () => this.plot.svg()],
      ["CSV", name("csv"), () => csv(["omega", "xi", "eq_25", "up", "down"], rows())],
      ["NetCDF", () => fileName(this.job, "sweep", "nc"), netcdf(this.job)],
    ]);
  }
}

/** Discs on the way up, hollow squares on the way down: told apart without their colours too. */
function drawMarks(pen, box, omega, values, colour, way) {
  let run = [];
  const runs = [run];
  values.forEach((value, i) => {
    if (value === null) runs.push((run = []));
    else run.push([box.x.place(omega[i]), box.y.place(value)]);
  });
  const size = Math.min(3.4, Math.max(1.6, 260 / omega.length));
  for (const points of runs) {
    if (points.length > 1) stroke(pen, colour, 1.2, points);
    for (const point of points) mark(pen, point, size, colour, way, box.theme.paper);
  }
}

function mark(pen, [x, y], size, colour, way, paper) {
  if (way === "up") {
    pen.fillStyle = colour;
    pen.beginPath();
    pen.arc(x, y, size, 0, 2 * Math.PI);
    pen.fill();
    return;
  }
  pen.fillStyle = paper;
  pen.fillRect(x - size, y - size, 2 * size, 2 * size);
  stroke(pen, colour, 1.6, [[x - size, y - size], [x + size, y - size], [x + size, y + size], [x - size, y + size], [x - size, y - size]]);
}

const HINT = "Point at a frequency to read it, click to see a cell move, drag to zoom, double-click to see all.";
