// Attractors over a grid: the flights of all that coexist along Γ, and the map of where several do.

import { partsOf, query } from "../lib/api.js";
import { checkBox, h } from "../lib/dom.js";
import { number, plural, share } from "../lib/format.js";
import { TWO_PI, axisColumn, axisText, clampIndex, inSymbols, isClose, nearestIndex, startName, startOf } from "../lib/physics.js";
import { COLOURED, numberedColour, theme } from "../plot/colours.js";
import { rgba32, verticalLine } from "../plot/drawing.js";
import { drawCell, flightsText, markCell } from "../plot/flights.js";
import { cellExtent } from "../plot/scale.js";
import { PlaneView, hatchAt, hatchSymbol, legendEntry } from "./cells.js";
import { sliders } from "./controls.js";
import { FLIGHT_AXIS } from "./plot-view.js";

const modeOf = ({ kind, below, above }) => inSymbols({ mode: `${below} to ${above}`, birth: above }[kind] ?? below);
const eventColumns = (values) => [
  ["Γ", ({ gamma_below: low, gamma_above: high }) => `${axisText(low, values)}–${axisText(high, values)}`],
  ["event", (event, whole) => (whole ? event.kind : `${event.kind === "mode" ? "" : `${event.kind} of `}${modeOf(event)}`)],
  ["attractor", ({ attractor }) => String(attractor)],
  ["mode", modeOf, true],
  ["leads to", ({ leads_to: other }) => (other ? String(other) : "")],
];

/** What both views share: the plane at one ξ, the legend of its attractors, and an attractor seen to move. */
class AttractorView extends PlaneView {
  constructor(root, view, { axes, controls, ...options }) {
    super(view);
    this.axes = axes;
    this.legend = h("ul", { className: "legend", "aria-label": "Attractors" });
    this.shares = h("p", { className: "note" });
    this.build(root, { controls: [sliders(this, axes), controls], shown: [this.legend, this.shares], ...options });
  }

  filePath = () => `/v1/jobs/${this.job.id}/multistability?${query(Object.fromEntries(this.axes.map((axis) => [axis, this.place[axis]])))}`;

  read([result]) {
    this.plane = result;
    [this.columns, this.rows, this.xi, this.count] = ["gamma", "omega", "xi", "count"].map((name) => result[name].data);
    this.attractors = partsOf(result, "attractor").map(({ attractor: id, label }) => ({ id, label: inSymbols(label) }));
    [this.cells, this.spring] = [cellsOf(result), { omega: this.rows[0], xi: this.xi }];
    this.message = this.count.every((n) => n < 0) ? "Not computed yet" : null;
  }

  /** The attractors of a cell, those of most drops first. */
  attractorsOf = ({ column, row = 0 }) => this.cells[this.indexOf({ column, row })];

  cellOf({ column, row = 0, k = 0 }) {
    return this.attractorsOf({ column, row })[k] ? { ...super.cellOf({ column, row }), direction: startName("attractor", k + 1) } : null;
  }

  showLegend() {
    const colourless = this.attractors.filter(({ id }) => id > COLOURED);
    const others = colourless.length > 1 ? colourless : [];
    const entry = (name, attractors) => {
      const ids = new Set(attractors.map(({ id }) => id));
      const cells = this.cells.filter((cell) => cell.some(({ id }) => ids.has(id)));
      return legendEntry(numberedColour(attractors[0].id, theme().dark), `${name} `, h("small", {}, plural(cells.length, "cell")));
    };
    const listed = this.attractors.filter((attractor) => !others.includes(attractor));
    this.legend.replaceChildren(...listed.map((attractor) => entry(`${attractor.id}: mostly ${attractor.label}`, [attractor])),
      ...(others.length ? [entry(`${others.length} others`, others)] : []));
    const { several, several_by_drops: byDrops } = this.plane.attrs;
    this.shares.textContent = (several ?? null) === null ? "" : `Two attractors or more in ${share(several)} of the cells; drops reach them in ${share(byDrops)}.`;
  }
}

/** The diagram: the flights of all coexisting attractors. Cells are {column, k}: indices into Γ and the cell's attractors. */
export class AttractorDiagram extends AttractorView {
  name = "attractors";

  constructor(root, view) {
    const events = () => [[...eventColumns(this.grid.gamma), ...this.common(this.spring)], partsOf(this.plane, "event")];
    super(root, view, {
      events: ["Births, ends, changes of mode", events], axes: ["omega", "xi"], label: "Diagram of all attractors",
      hint: "Point at a flight to read its attractor, press to see it move, drag or turn the wheel to zoom. Dashed lines mark births, dotted ones deaths.",
    });
  }

  whole() {
    const highest = Math.max(0, ...this.cells.flat().map(({ longest_flight: longest }) => longest)) || TWO_PI;
    const [x0, x1] = cellExtent(this.columns);
    return { x0, x1, y0: -0.02 * highest, y1: 1.06 * highest };
  }

  content() {
    return {
      ...this.scales(this.axisOf("gamma"), FLIGHT_AXIS),
      title: this.textOf(this.spring),
      message: this.message,
      layers: [(ctx, box) => this.#drawEvents(ctx, box), (ctx, box) => this.#drawFlights(ctx, box)],
    };
  }

  #drawEvents(ctx, box) {
    for (const { kind, attractor: id, gamma_below: low, gamma_above: high } of partsOf(this.plane, "event")) {
      if (kind !== "mode") verticalLine(ctx, box, box.x.pixel((low + high) / 2), numberedColour(id, box.theme.dark), 1, kind === "birth" ? [5, 4] : [1, 3]);
    }
  }

  /** The attractors with most cells are drawn last; rest is a dot at 0. */
  #drawFlights(ctx, box) {
    const inView = this.columns.filter((value) => value >= box.x.low && value <= box.x.high).length;
    const radius = Math.min(2.6, Math.max(1.1, box.width / 3 / Math.max(inView, 1)));
    const attractors = this.cells.flatMap((cell, i) => cell.map((attractor) => ({ ...attractor, gamma: this.columns[i] })));
    attractors.sort((a, b) => b.id - a.id).forEach(({ id, gamma, times }) => drawCell(ctx, box, gamma, times, numberedColour(id, box.theme.dark), radius));
  }

  drawCursor(ctx, box) {
    const cell = this.current ?? this.#selectedCell();
    const attractor = cell && this.attractorsOf(cell)[cell.k];
    if (attractor) markCell(ctx, box, this.columns[cell.column], attractor.times);
  }

  #selectedCell() {
    const cell = this.selected();
    const start = cell && startOf(cell.direction);
    if (start?.kind !== "attractor" || !isClose(cell.omega, this.rows[0]) || !isClose(cell.xi, this.xi)) return null;
    return { column: nearestIndex(this.columns, cell.gamma), k: start.number - 1 };
  }

  cellsShown() {
    return Array.from(this.columns.keys()).filter((column) => this.isVisible(this.columns[column])).flatMap((column) => this.attractorsOf({ column }).map((_, k) => ({ column, k })));
  }

  columnsOfTable() {
    const column = (title, text, otherwise = () => "") => [title, (cell, whole) => {
      const attractor = this.attractorsOf(cell)[cell.k];
      return attractor ? text(attractor, whole) : otherwise(cell);
    }];
    return [
      axisColumn("Γ", this.grid.gamma, (cell) => this.columns[cell.column]), ...this.common(this.spring),
      column("attractor", ({ id }) => String(id)),
      column("mode", ({ label }) => label, (cell) => (this.count[cell.column] < 0 ? "not computed yet" : "")),
      column("share of drops", ({ fraction }) => (fraction ? share(fraction) : "none, from a neighbouring cell")),
      column("flight times (rad)", ({ times }, whole) => flightsText(times, whole)),
    ];
  }

  nearest(x, y) {
    const column = nearestIndex(this.columns, x);
    const distances = this.attractorsOf({ column }).map(({ times }) => Math.min(...times.map((time) => Math.abs(time - y))));
    return { column, k: Math.max(0, distances.indexOf(Math.min(...distances))) };
  }

  step(current, right, up) {
    const from = current ?? { column: this.columns.length >> 1, k: 0 };
    const column = clampIndex(from.column + right, this.columns.length);
    return { column, k: clampIndex(from.k + up, Math.max(this.attractorsOf({ column }).length, 1)) };
  }

  at = ({ column, k }) => [this.columns[column], this.attractorsOf({ column })[k]?.times[0]];
}

/** The map: the attractor that most drops reach, hatched where several coexist. */
export class AttractorMap extends AttractorView {
  name = "attractor-map";

  constructor(root, view) {
    const hatches = checkBox("Hatch cells with several attractors", { checked: true, onchange: () => this.plot.draw() });
    super(root, view, {
      axes: ["xi"], label: "Map of attractors", controls: hatches,
      hint: "Point at a cell to read its attractors, press to see the first one move, drag or turn the wheel to zoom.",
    });
    this.hatches = hatches;
  }

  content() {
    const isHatched = this.hatches.control.checked && this.plane.attrs.several > 0;
    return {
      title: this.textOf({ xi: this.xi }),
      ...this.scales(this.axisOf("gamma"), this.axisOf("omega")),
      legend: isHatched ? [["several attractors", hatchSymbol]] : [],
      message: this.message,
      layers: [(ctx, box) => this.#drawAttractors(ctx, box, isHatched)],
    };
  }

  /** The colour of the first attractor; over cells with several, lines in that of the second one. */
  #drawAttractors(ctx, box, isHatched) {
    const { surface, text, dark } = box.theme;
    const colourOf = ({ id }) => numberedColour(id, dark);
    const colours = this.cells.map(([first]) => rgba32(first ? colourOf(first) : surface));
    const lines = this.cells.map(([first, second]) => second && rgba32(colourOf(second) === colourOf(first) ? text : colourOf(second)));
    this.drawCells(ctx, box, (cell) => colours[cell], isHatched ? (cell, x, y) => (hatchAt(x, y) < 0 ? null : lines[cell]) : null);
  }

  columnsOfTable() {
    const isMissing = (cell) => this.count[this.indexOf(cell)] < 0;
    return [...this.columnsOfPlane(), ["with", (cell) => (isMissing(cell) ? "not computed yet" : this.attractorsOf(cell).map(attractorText).join(" · "))]];
  }
}

function attractorText({ id, label, fraction, longest_flight: longest }) {
  const reached = fraction ? `${share(fraction)} of the drops` : "reached from a neighbouring cell only";
  return `attractor ${id}, ${label}, ${reached}${longest ? `, flights up to ${number(longest, 4)} rad` : ""}`;
}

/** The attractors of every cell, in rows of Ω, with the flights of a line: `times`, of rest 0. */
function cellsOf({ id, label, fraction, longest_flight: longest, flight_time: flights, dims }) {
  const labels = label.data.flat(2).map(inSymbols);
  const timesOf = (i) => Array.from(flights?.data.subarray(i * dims.flight, (i + 1) * dims.flight).filter(Number.isFinite) ?? []);
  const attractorAt = (i) => {
    const times = timesOf(i);
    return { id: id.data[i], label: labels[i], fraction: fraction.data[i], longest_flight: longest.data[i], times: times.length ? times : [0] };
  };
  return Array.from({ length: dims.omega * dims.gamma }, (_, cell) =>
    Array.from({ length: dims.place }, (_, k) => attractorAt(cell * dims.place + k)).filter((attractor) => attractor.id));
}
