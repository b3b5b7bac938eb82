// Where bouncing begins on the way up and ends on the way down, per Ω, beside Eq. 25.

import { note } from "../lib/address.js";
import { askJson, query } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { csv } from "../lib/downloads.js";
import { number } from "../lib/format.js";
import { disc, stroke, upright } from "../plot/drawing.js";
import { SYMBOL, isLog, nearest, startOf, threshold } from "../lib/physics.js";
import { PlotView, within } from "./plot-view.js";
import { spread } from "../plot/scale.js";
import { sliders } from "./sliders.js";
import { colourOf } from "../plot/theme.js";

const DASH = [7, 4];
const HINT = "Point at a frequency to read it, click to see a cell move, drag to zoom, double-click to see all.";

export class Thresholds extends PlotView {
  name = "thresholds";

  constructor(root, view) {
    super(view);
    this.xi = startOf(this.grid.xi, this.asked.xi);
    const moved = (_, value) => {
      this.xi = value;
      note({ xi: Number(value.toPrecision(10)) });
      this.load();
    };
    const controls = h("div", { className: "controls" }, sliders(["xi"], this.grid, { xi: this.xi }, moved));
    this.build(root, { controls, label: "Thresholds against the plate's frequency", hint: HINT });
  }

  async ask(signal) {
    this.found = await askJson(`/v1/jobs/${this.job.id}/threshold?${query({ xi: this.xi })}`, { signal });
    return { xi: this.found.xi };
  }

  whole() {
    const { omega } = this.found;
    const [x0, x1] = spread(omega[0], omega[omega.length - 1]);
    const simulated = this.#simulated();
    const highest = Math.max(...(simulated.length ? simulated : [threshold(x0, this.found.xi), 1]));
    return { x0, x1, y0: 0, y1: 1.12 * highest };
  }

  #simulated() {
    return [...this.found.up, ...this.found.down].filter((value) => value !== null);
  }

  content() {
    if (!this.found) return null;
    const { x0, x1, y0, y1 } = this.shown();
    return {
      x: { label: SYMBOL.omega, low: x0, high: x1, log: isLog(this.job.spec.omega) },
      y: { label: "threshold Γ", low: y0, high: y1 },
      title: `ξ = ${number(this.found.xi)}`,
      key: this.#key(),
      message: this.#simulated().length ? null : this.found.complete ? "Nothing bounces here" : "No cell that bounces yet",
      layers: [(pen, box) => this.#draw(pen, box)],
      cursor: (pen, box) => this.at && upright(pen, box, box.x.place(this.found.omega[this.at.place]), box.theme.cursor),
    };
  }

  #draw(pen, box) {
    const n = Math.round(box.width / 2);
    const curve = Array.from({ length: n + 1 }, (_, i) => {
      const x = box.left + (i * box.width) / n;
      return [x, box.y.place(threshold(box.x.value(x), this.found.xi))];
    });
    stroke(pen, box.theme.onset, 1.6, curve, DASH);
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
    const line = (pen, x, y, colour, width, dash) => stroke(pen, colour, width, [[x, y], [x + 24, y]], dash);
    return [
      ["Eq. 25", (pen, x, y, theme) => line(pen, x, y, theme.onset, 1.6, DASH)],
      ...this.#ways().map(([way, name, direction]) => [name, (pen, x, y, theme) => {
        const colour = colourOf(direction, theme);
        line(pen, x, y, colour, 1.2);
        mark(pen, [x + 12, y], 3.4, colour, way, theme.paper);
      }]),
    ];
  }

  nearest(x, y) {
    return this.found ? { place: nearest(this.found.omega, x), y } : null;
  }

  step(at, right) {
    if (!this.found) return null;
    const n = this.found.omega.length;
    return { place: at ? within(at.place + right, n) : n >> 1 };
  }

  middle() {
    return this.at ? this.found.omega[this.at.place] : undefined;
  }

  describe({ place }) {
    const { omega, analytic, up, down } = this.found;
    const parts = [`Ω = ${number(omega[place])}`, `Eq. 25: Γ = ${number(analytic[place], 4)}`];
    if (up[place] !== null) parts.push(`${this.directions[0] === "rest" ? "from rest" : "up"}: ${this.#value(up[place])}`);
    if (down[place] !== null) parts.push(`down: ${this.#value(down[place])}`);
    return parts.join(" · ");
  }

  /** A threshold; below the lowest Γ that was computed nobody knows. */
  #value(gamma) {
    return gamma > this.grid.gamma[0] ? number(gamma, 4) : `${number(gamma, 4)} or less, where the sweep begins`;
  }

  /** The cell at the height pointed at; from the keyboard, the first that bounces. */
  cellOf({ place, y }) {
    const { omega, xi, up, down } = this.found;
    const height = y ?? up[place] ?? down[place];
    if (height === null) return null;
    const falling = down[place] !== null && Math.abs(down[place] - height) < Math.abs((up[place] ?? Infinity) - height);
    const direction = falling ? "down" : this.directions[0];
    return { gamma: this.grid.gamma[nearest(this.grid.gamma, height)], omega: omega[place], xi, direction };
  }

  table() {
    const { omega, xi, analytic, up, down } = this.found;
    return csv(["omega", "xi", "eq_25", "up", "down"], omega.map((value, i) => [value, xi, analytic[i], up[i], down[i]]));
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
    disc(pen, colour, x, y, size);
    return;
  }
  pen.fillStyle = paper;
  pen.fillRect(x - size, y - size, 2 * size, 2 * size);
  stroke(pen, colour, 1.6, [[x - size, y - size], [x + size, y - size], [x + size, y + size], [x - size, y + size], [x - size, y - size]]);
}
