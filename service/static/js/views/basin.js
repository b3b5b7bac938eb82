// The basins of one cell: which attractor each start of the plane reaches.

import { addressValue, setQuery } from "../lib/address.js";
import { query, requestJson } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { csv } from "../lib/downloads.js";
import { number } from "../lib/format.js";
import { AXES, clampIndex, initialValue, nearestIndex, outcomeText } from "../lib/physics.js";
import { startName, startOf } from "../lib/starts.js";
import { theme } from "../plot/colours.js";
import { bitmap, circle, rgba32 } from "../plot/drawing.js";
import { cellBorders } from "../plot/scale.js";
import { sliders } from "./controls.js";
import { PlotView } from "./plot-view.js";

const HINT = "Point at a start to read it, click to see it move, drag to zoom.";
// As in the service's pictures (Okabe and Ito), repeated beyond.
const COLOURS = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#666666"];
const LABELS = {
  drop: { x: "phase of the plate when let go (rad)", y: "height above the plate / A" },
  contact: { x: "velocity of the elongation × Ω / A", y: "elongation beyond the static one / A" },
};

/** Cells are {column, row}: indices into the columns and rows of the plane of starts. */
export class Basin extends PlotView {
  name = "basin";

  constructor(root, view) {
    super(view);
    this.place = Object.fromEntries(AXES.map((axis) => [axis, initialValue(this.grid[axis], this.initial[axis])]));
    this.legend = h("ul", { className: "legend", "aria-label": "Attractors and the shares of the starts that reach them" });
    this.entropies = h("p", { className: "note" });
    this.build(root, {
      controls: h("div", { className: "controls" }, sliders(AXES, this.grid, this.place, (axis, value) => this.#move(axis, value))),
      label: "Plane of starts", hint: HINT, ratio: 0.6, below: h("div", {}, this.legend, this.entropies),
    });
  }

  #move(axis, value) {
    this.place[axis] = value;
    setQuery({ [axis]: addressValue(value) });
    this.load();
  }

  async request(signal) {
    this.basin = await requestJson(`/v1/jobs/${this.job.id}/basins?${query(this.place)}`, { signal });
    this.#showLegend();
    const { gamma, omega, xi } = this.basin;
    return { gamma, omega, xi, complete: this.basin.complete };
  }

  #showLegend() {
    const { attractors, undecided, basin_entropy: entropy, boundary_entropy: boundary } = this.basin;
    const entry = (colour, text, share) => {
      const swatch = h("span", { className: "swatch", "aria-hidden": "true" });
      swatch.style.background = colour;
      return h("li", {}, swatch, text, " ", h("small", {}, percentage(share)));
    };
    this.legend.replaceChildren(
      ...attractors.map((attractor) => entry(colourOf(attractor.id), attractorText(attractor), attractor.fraction)),
      ...(undecided ? [entry(theme().surface, "undecided", undecided)] : []));
    const texts = [["basin entropy", entropy], ["boundary basin entropy", boundary]].filter(([, value]) => value !== null);
    this.entropies.textContent = texts.map(([name, value]) => `${name} ${number(value, 4)}`).join(", ");
  }

  whole() {
    const [x, y] = [cellBorders(this.basin.columns), cellBorders(this.basin.rows)];
    return { x0: x[0], x1: x.at(-1), y0: y[0], y1: y.at(-1) };
  }

  content() {
    if (!this.basin) return null;
    const { gamma, omega, xi, plane, attractors } = this.basin;
    const { x0, x1, y0, y1 } = this.visible();
    return {
      x: { label: LABELS[plane].x, low: x0, high: x1 },
      y: { label: LABELS[plane].y, low: y0, high: y1 },
      title: `Γ = ${number(gamma)}, Ω = ${number(omega)}, ξ = ${number(xi)}`,
      colours: attractors.map((attractor) => [`${attractorText(attractor)} ${percentage(attractor.fraction)}`, () => colourOf(attractor.id)]),
      message: this.basin.complete ? null : "This cell is not computed yet",
      layers: [(ctx, box) => this.#drawStarts(ctx, box)],
      cursor: (ctx, box) => this.#drawCursor(ctx, box),
    };
  }

  /** Each pixel has the colour of the nearest start. */
  #drawStarts(ctx, box) {
    const { columns, rows, map } = this.basin;
    const [width, height] = [Math.round(box.width * box.ratio), Math.round(box.height * box.ratio)];
    const nearest = Int32Array.from({ length: width }, (_, i) => nearestIndex(columns, box.x.value(box.left + ((i + 0.5) * box.width) / width)));
    const undecided = rgba32(box.theme.surface);
    const colours = COLOURS.map((colour) => rgba32(colour));
    const fill = (pixels) => {
      for (let row = 0; row < height; row++) {
        const ids = map[nearestIndex(rows, box.y.value(box.top + ((row + 0.5) * box.height) / height))];
        for (let i = 0; i < width; i++) {
          const id = ids[nearest[i]];
          pixels[row * width + i] = id ? colours[(id - 1) % COLOURS.length] : undecided;
        }
      }
    };
    bitmap(ctx, width, height, fill, box.left, box.top, box.left + box.width, box.top + box.height);
  }

  #drawCursor(ctx, box) {
    const start = this.selected() && startOf(this.selected().direction);
    if (start && start.kind === this.basin.plane) this.#drawRing(ctx, box, start.phase ?? start.velocity, start.height ?? start.elongation, 9);
    if (this.current) this.#drawRing(ctx, box, this.basin.columns[this.current.column], this.basin.rows[this.current.row], 6);
  }

  #drawRing(ctx, { x, y, theme: colours }, column, row, radius) {
    circle(ctx, colours.surface, 4.5, x.pixel(column), y.pixel(row), radius);
    circle(ctx, colours.cursor, 2, x.pixel(column), y.pixel(row), radius);
  }

  nearest(x, y) {
    return this.basin ? { column: nearestIndex(this.basin.columns, x), row: nearestIndex(this.basin.rows, y) } : null;
  }

  step(current, right, up) {
    if (!this.basin) return null;
    const { columns, rows } = this.basin;
    const { column, row } = current ?? { column: columns.length >> 1, row: rows.length >> 1 };
    return { column: clampIndex(column + right, columns.length), row: clampIndex(row + up, rows.length) };
  }

  centre() {
    return this.current ? this.basin.columns[this.current.column] : undefined;
  }

  cellOf({ column, row }) {
    const { gamma, omega, xi, plane, columns, rows } = this.basin;
    return { gamma, omega, xi, direction: startName(plane, rows[row], columns[column]) };
  }

  describe({ column, row }) {
    const { plane, columns, rows, map, attractors } = this.basin;
    const [across, along] = plane === "drop" ? ["height", "phase"] : ["elongation", "velocity × Ω"];
    const attractor = attractors.find(({ id }) => id === map[row][column]);
    return [`${across} ${number(rows[row])}`, `${along} ${number(columns[column])}`, attractor ? `reaches ${attractorText(attractor)}` : "undecided"].join(" · ");
  }

  table() {
    const { columns, rows, map, plane } = this.basin;
    const names = plane === "drop" ? ["height", "phase"] : ["elongation", "velocity"];
    return csv([...names, "attractor"], rows.flatMap((row, i) => columns.map((column, j) => [row, column, map[i][j]])));
  }
}

/** "(3, 4), flights up to 7.956 rad, λ₁ −0.31" */
function attractorText({ outcome, label, bounces, periods, longest_flight: longest, lyapunov }) {
  const name = outcomeText(outcome, bounces, periods);
  const parts = [label.startsWith("(") || label === "rest" ? name : label];
  if (longest) parts.push(`flights up to ${number(longest, 4)} rad`);
  if (lyapunov?.length && lyapunov[0] !== null) parts.push(`λ₁ ${number(lyapunov[0], 3)}`);
  return parts.join(", ");
}

const colourOf = (id) => COLOURS[(id - 1) % COLOURS.length];
const percentage = (share) => `${share > 0 && share < 0.001 ? "<0.1" : number(100 * share, 3)} %`;
