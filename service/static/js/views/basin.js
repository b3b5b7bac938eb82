// The basins of one cell: which attractor each start of the plane reaches.

import { addressValue, setQuery } from "../lib/address.js";
import { query, requestDataset } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { csv } from "../lib/downloads.js";
import { number, share } from "../lib/format.js";
import { AXES, initialValue, outcomeText } from "../lib/physics.js";
import { startName, startOf } from "../lib/starts.js";
import { attractorColour, theme } from "../plot/colours.js";
import { rgba32 } from "../plot/drawing.js";
import { drawCells, drawRing, legendEntry, nearestCell, nextCell, windowOf } from "./cells.js";
import { sliders } from "./controls.js";
import { PlotView } from "./plot-view.js";

const HINT = "Point at a start to read it, click to see it move, drag to zoom.";
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
    this.basin = read(await requestDataset(`/v1/jobs/${this.job.id}/basins?${query(this.place)}`, { signal }));
    this.#showLegend();
    const { gamma, omega, xi, complete } = this.basin;
    return { gamma, omega, xi, complete };
  }

  #showLegend() {
    const { attractors, undecided, entropy, boundary } = this.basin;
    const { gamma, omega, xi } = this.basin;
    const attractor = ({ id, fraction, ...about }) => legendEntry(attractorColour(id),
      h("button", {
        type: "button", className: "link", title: "See the attractor move",
        onclick: () => this.onSelect({ gamma, omega, xi, direction: startName("attractor", id) }),
      }, attractorText(about)), " ", h("small", {}, share(fraction)));
    this.legend.replaceChildren(
      ...attractors.map(attractor),
      ...(undecided ? [legendEntry(theme().surface, "undecided ", h("small", {}, share(undecided)))] : []));
    const texts = [["basin entropy", entropy], ["boundary basin entropy", boundary]].filter(([, value]) => value !== null);
    this.entropies.textContent = texts.map(([name, value]) => `${name} ${number(value, 4)}`).join(", ");
  }

  whole() {
    return windowOf(this.basin.columns, this.basin.rows);
  }

  content() {
    if (!this.basin) return null;
    const { gamma, omega, xi, plane, attractors } = this.basin;
    const { x0, x1, y0, y1 } = this.visible();
    return {
      x: { label: LABELS[plane].x, low: x0, high: x1 },
      y: { label: LABELS[plane].y, low: y0, high: y1 },
      title: `Γ = ${number(gamma)}, Ω = ${number(omega)}, ξ = ${number(xi)}`,
      colours: attractors.map((attractor) => [`${attractorText(attractor)} ${share(attractor.fraction)}`, () => attractorColour(attractor.id)]),
      message: this.basin.complete ? null : "This cell is not computed yet",
      layers: [(ctx, box) => this.#drawStarts(ctx, box)],
      cursor: (ctx, box) => this.#drawCursor(ctx, box),
    };
  }

  #drawStarts(ctx, box) {
    const { attractors, columns, rows, map } = this.basin;
    const colours = [rgba32(box.theme.surface), ...attractors.map(({ id }) => rgba32(attractorColour(id)))];
    drawCells(ctx, box, columns, rows, (row, column) => colours[map(row, column)]);
  }

  #drawCursor(ctx, box) {
    const start = this.selected() && startOf(this.selected().direction);
    if (start && start.kind === this.basin.plane) drawRing(ctx, box, start.phase ?? start.velocity, start.height ?? start.elongation, 9);
    if (this.current) drawRing(ctx, box, this.basin.columns[this.current.column], this.basin.rows[this.current.row], 6);
  }

  nearest(x, y) {
    return this.basin ? nearestCell(this.basin.columns, this.basin.rows, x, y) : null;
  }

  step(current, right, up) {
    return this.basin ? nextCell(this.basin.columns, this.basin.rows, current, right, up) : null;
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
    const attractor = attractors[map(row, column) - 1];
    return [`${across} ${number(rows[row])}`, `${along} ${number(columns[column])}`, attractor ? `reaches ${attractorText(attractor)}` : "undecided"].join(" · ");
  }

  table() {
    const { columns, rows, map, plane } = this.basin;
    const names = plane === "drop" ? ["height", "phase"] : ["elongation", "velocity"];
    return csv([...names, "attractor"], rows.flatMap((row, i) => columns.map((column, j) => [row, column, map(i, j)])));
  }
}

/** The basin of one cell from its Dataset; `map(row, column)` is the attractor of a start, from 1; 0: undecided. */
function read({ attrs, row, column, ...found }) {
  const scalar = (name) => found[name].data;
  const of = (name, i) => found[`attractor_${name}`].data[i];
  const { data, shape: [, width] } = found.attractor_of_start;
  const exponents = found.attractor_lyapunov;
  return {
    gamma: scalar("gamma"), omega: scalar("omega"), xi: scalar("xi"), plane: attrs.plane, complete: attrs.complete,
    rows: Array.from(row.data), columns: Array.from(column.data), map: (i, j) => data[i * width + j],
    undecided: scalar("undecided"), entropy: scalar("basin_entropy"), boundary: scalar("boundary_entropy"),
    attractors: Array.from(found.attractor.data, (id, i) => ({
      id, fraction: of("fraction", i), label: of("label", i), outcome: of("outcome", i), bounces: of("bounces", i),
      periods: of("periods", i), longest: of("longest_flight", i), exponent: exponents?.data[i * exponents.shape[1]] ?? NaN,
    })),
  };
}

/** "(3, 4), flights up to 7.956 rad, λ₁ −0.31" */
function attractorText({ outcome, label, bounces, periods, longest, exponent }) {
  const name = outcomeText(outcome, bounces, periods);
  const parts = [label.startsWith("(") || label === "rest" ? name : label];
  if (longest) parts.push(`flights up to ${number(longest, 4)} rad`);
  if (Number.isFinite(exponent)) parts.push(`λ₁ ${number(exponent, 3)}`);
  return parts.join(", ");
}

