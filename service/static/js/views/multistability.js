// Attractors over a grid: the flights of all that coexist along Γ, and the map of where several do.

import { addressValue, setQuery } from "../lib/address.js";
import { query, requestBlob, requestDataset } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { number, plural, share } from "../lib/format.js";
import { TWO_PI, axisLabel, clampIndex, initialValue, isClose, isLog, nearestIndex } from "../lib/physics.js";
import { startName, startOf } from "../lib/starts.js";
import { COLOURED, branchColour, onThemeChange, theme } from "../plot/colours.js";
import { circle, disc, polyline, rgba32, verticalLine } from "../plot/drawing.js";
import { cellBorders, extent } from "../plot/scale.js";
import { drawCells, drawRing, hatchSymbol, legendEntry, nearestCell, nextCell, windowOf } from "./cells.js";
import { sliders } from "./controls.js";
import { PlotView } from "./plot-view.js";

const MAX_EVENTS = 12; // listed one by one
const MAX_LISTED = 6; // flights
const HATCH = 7; // px between the lines over cells with several attractors

/** What both views share: the plane at one ξ, the legend of its attractors, and an attractor seen to move. */
class AttractorView extends PlotView {
  plane = null;

  constructor(root, view, options) {
    super(view);
    this.place = Object.fromEntries(["omega", "xi"].map((axis) => [axis, initialValue(this.grid[axis], this.initial[axis])]));
    this.legend = h("ul", { className: "legend", "aria-label": "Attractors" });
    this.shares = h("p", { className: "note" });
    this.events = h("ul", { className: "events note", "aria-label": "Births, deaths and changes of mode" });
    this.build(root, {
      controls: h("div", { className: "controls" }, sliders(options.axes, this.grid, this.place, (axis, value) => this.#move(axis, value)), options.controls),
      below: h("div", {}, this.legend, this.shares, this.events), ...options,
    });
    onThemeChange(() => this.plane && this.#showLegend(), this.plot.closing.signal);
  }

  #move(axis, value) {
    this.place[axis] = value;
    setQuery({ [axis]: addressValue(value) });
    this.load();
  }

  async requestPlane(place, signal) {
    this.plane = read(await requestDataset(`/v1/jobs/${this.job.id}/multistability?${query(place)}`, { signal }));
    this.#showLegend();
    return { xi: this.plane.xi, complete: this.plane.complete };
  }

  #showLegend() {
    const { attractors } = this.plane;
    const { dark } = theme();
    const own = attractors.filter(({ id }) => id <= COLOURED);
    const others = attractors.length - own.length;
    this.legend.replaceChildren(
      ...own.map(({ id, label, cells }) => legendEntry(branchColour(id, dark), `${id}: mostly ${label} `, h("small", {}, plural(cells, "cell")))),
      ...(others ? [legendEntry(branchColour(COLOURED + 1, dark), plural(others, "more attractor"))] : []));
    const { several, several_by_drops: byDrops } = this.plane;
    this.shares.textContent = several === null ? "" : `Two attractors or more in ${share(several)} of the cells; drops reach them in ${share(byDrops)}.`;
  }

  /** The attractors of a legend below an exported picture. */
  get colours() {
    return this.plane.attractors.filter(({ id }) => id <= COLOURED).map(({ id, label }) => [`${id}: mostly ${label}`, (theme) => branchColour(id, theme.dark)]);
  }

  get noneComputed() {
    return this.plane.count.every((line) => line.every((n) => n < 0));
  }

  gammaScale() {
    const { x0, x1 } = this.visible();
    return { label: axisLabel("gamma"), low: x0, high: x1, log: isLog(this.job.spec.gamma) };
  }

  placeText({ id, label, fraction, longest_flight: longest }) {
    const reached = fraction ? `${share(fraction)} of the drops` : "reached from a neighbouring cell only";
    return `attractor ${id}, ${label}, ${reached}${longest ? `, flights up to ${number(longest, 4)} rad` : ""}`;
  }

  table() {
    return requestBlob(`/v1/jobs/${this.job.id}/multistability?${query({ ...this.tablePlace(), format: "csv" })}`);
  }
}

/** The diagram: the flights of all coexisting attractors. Cells are {cell, k}: indices into Γ and the cell's attractors. */
export class AttractorDiagram extends AttractorView {
  name = "attractors";

  constructor(root, view) {
    super(root, view, {
      axes: ["omega", "xi"], label: "Diagram of all attractors",
      hint: "Point at a flight to read its attractor, click to see it move, drag to zoom. Lines mark births and deaths.",
    });
  }

  async request(signal) {
    const { xi, complete } = await this.requestPlane(this.place, signal);
    this.#showEvents();
    return { omega: this.plane.omega[0], xi, complete };
  }

  tablePlace() {
    return this.place;
  }

  #showEvents() {
    const { events } = this.plane;
    const texts = events.slice(0, MAX_EVENTS).map((event) => h("li", {}, eventText(event)));
    const more = events.length - texts.length;
    this.events.replaceChildren(...texts, ...(more > 0 ? [h("li", {}, `and ${plural(more, "more event")}: see the JSON`)] : []));
  }

  whole() {
    const { gamma, cells } = this.plane;
    const highest = Math.max(0, ...cells[0].flat().map(({ longest_flight: longest }) => longest)) || TWO_PI;
    const [x0, x1] = extent(gamma[0], gamma.at(-1));
    return { x0, x1, y0: -0.02 * highest, y1: 1.06 * highest };
  }

  content() {
    if (!this.plane) return null;
    const { y0, y1 } = this.visible();
    const { omega, xi } = this.plane;
    return {
      title: `Ω = ${number(omega[0])},   ξ = ${number(xi)}`,
      x: this.gammaScale(),
      y: { label: "flight time φ (rad)", low: y0, high: y1, periods: true },
      colours: this.colours,
      message: this.noneComputed ? "Not computed yet" : null,
      layers: [(ctx, box) => this.#drawEvents(ctx, box), (ctx, box) => this.#drawFlights(ctx, box)],
      cursor: (ctx, box) => this.#drawCursor(ctx, box),
    };
  }

  #drawEvents(ctx, box) {
    for (const { kind, attractor, low, high } of this.plane.events) {
      if (kind !== "mode") verticalLine(ctx, box, box.x.pixel((low + high) / 2), branchColour(attractor, box.theme.dark), 1, kind === "birth" ? [5, 4] : [1, 3]);
    }
  }

  /** The attractors with most cells are drawn last. One dot stands for all flights within half a pixel; rest is a dot at 0. */
  #drawFlights(ctx, box) {
    const { gamma, cells } = this.plane;
    const inView = gamma.filter((value) => value >= box.x.low && value <= box.x.high).length;
    const radius = Math.min(2.6, Math.max(1.1, box.width / 3 / Math.max(inView, 1)));
    const places = cells[0].flatMap((cell, i) => cell.map((place) => ({ ...place, x: box.x.pixel(gamma[i]) })));
    for (const { id, x, flight_time: times } of places.sort((a, b) => b.id - a.id)) {
      const drawn = new Set((times.length ? times : [0]).map((time) => Math.round(2 * box.y.pixel(time)) / 2));
      for (const y of drawn) disc(ctx, branchColour(id, box.theme.dark), x, y, radius);
    }
  }

  #drawCursor(ctx, box) {
    const { gamma, cells } = this.plane;
    const at = this.current ?? this.#selectedCell();
    if (!at) return;
    const place = cells[0][at.cell]?.[at.k];
    if (!place) return;
    const x = box.x.pixel(gamma[at.cell]);
    verticalLine(ctx, box, x, box.theme.cursor);
    for (const time of place.flight_time.length ? place.flight_time : [0]) circle(ctx, box.theme.cursor, 1.5, x, box.y.pixel(time), 4.5);
  }

  /** The attractor that is seen to move, if it is on this line. */
  #selectedCell() {
    const cell = this.selected();
    const start = cell && startOf(cell.direction);
    if (start?.kind !== "attractor" || !isClose(cell.omega, this.plane.omega[0]) || !isClose(cell.xi, this.plane.xi)) return null;
    return { cell: nearestIndex(this.plane.gamma, cell.gamma), k: start.number - 1 };
  }

  /** The attractor with the flight nearest to (x, y), of the cell at x. */
  nearest(x, y) {
    if (!this.plane) return null;
    const cell = nearestIndex(this.plane.gamma, x);
    const distance = ({ flight_time: times }) => Math.min(...(times.length ? times : [0]).map((time) => Math.abs(time - y)));
    const distances = this.plane.cells[0][cell].map(distance);
    return { cell, k: Math.max(0, distances.indexOf(Math.min(...distances))) };
  }

  /** Up and down go through the attractors of the cell. */
  step(current, right, up) {
    if (!this.plane) return null;
    const { gamma, cells } = this.plane;
    const from = current ?? { cell: gamma.length >> 1, k: 0 };
    const cell = clampIndex(from.cell + right, gamma.length);
    return { cell, k: clampIndex(from.k + up, Math.max(cells[0][cell].length, 1)) };
  }

  centre() {
    return this.current ? this.plane.gamma[this.current.cell] : undefined;
  }

  cellOf({ cell, k }) {
    const { gamma, omega, xi, cells } = this.plane;
    return cells[0][cell][k] ? { gamma: gamma[cell], omega: omega[0], xi, direction: startName("attractor", k + 1) } : null;
  }

  describe({ cell, k }) {
    const { gamma, cells, count } = this.plane;
    const place = cells[0][cell][k];
    const parts = [`Γ = ${number(gamma[cell])}`, count[0][cell] < 0 ? "not computed yet" : plural(count[0][cell], "attractor")];
    if (!place) return parts.join(" · ");
    const times = [...new Set(place.flight_time.map((time) => number(time, 4)))];
    parts.push(this.placeText(place));
    if (times.length && times.length <= MAX_LISTED) parts.push(`flight times ${times.join(", ")} rad`);
    return parts.join(" · ");
  }
}

/** "Γ 0.54 to 0.56: attractor 2, (1,1), is born; below, its place has attractor 1" */
function eventText({ kind, attractor, low, high, below, above, other }) {
  const where = `Γ ${number(low)} to ${number(high)}: attractor ${attractor}`;
  if (kind === "mode") return `${where} changes from ${below} to ${above}`;
  const ends = other ? `; it leads to attractor ${other}` : "";
  return kind === "birth" ? `${where}, ${above}, is born${ends}` : `${where}, ${below}, ends${ends}`;
}

/** The map: the attractor that most drops reach, hatched where several coexist. Cells are {column, row}. */
export class AttractorMap extends AttractorView {
  name = "attractor-map";

  constructor(root, view) {
    const shows = h("input", { type: "checkbox", checked: true, onchange: () => this.plot.draw() });
    super(root, view, {
      axes: ["xi"], label: "Map of attractors", ratio: 0.6,
      controls: h("label", { className: "option" }, shows, " Hatch cells with several attractors"),
      hint: "Point at a cell to read its attractors, click to see the first one move, drag to zoom.",
    });
    this.shows = shows;
  }

  async request(signal) {
    return this.requestPlane({ xi: this.place.xi }, signal);
  }

  tablePlace() {
    return { xi: this.place.xi };
  }

  whole() {
    return windowOf(this.plane.gamma, this.plane.omega, true);
  }

  content() {
    if (!this.plane) return null;
    const { y0, y1 } = this.visible();
    return {
      title: `ξ = ${number(this.plane.xi)}`,
      x: this.gammaScale(),
      y: { label: axisLabel("omega"), low: y0, high: y1, log: isLog(this.job.spec.omega) },
      colours: this.colours,
      legend: this.shows?.checked !== false && this.plane.several > 0 ? [["several attractors", hatchSymbol]] : [],
      message: this.noneComputed ? "No cell is computed yet" : null,
      layers: [(ctx, box) => this.#drawCells(ctx, box), (ctx, box) => this.shows?.checked !== false && this.#drawHatch(ctx, box)],
      cursor: (ctx, box) => this.#drawCursor(ctx, box),
    };
  }

  #drawCells(ctx, box) {
    const { gamma, omega, cells } = this.plane;
    const empty = rgba32(box.theme.surface);
    const colours = cells.map((line) => line.map(([first]) => (first ? rgba32(branchColour(first.id, box.theme.dark)) : empty)));
    drawCells(ctx, box, gamma, omega, (row, column) => colours[row][column]);
  }

  /** Lines in the colour of the second attractor over the cells with several, at least one over each. */
  #drawHatch(ctx, box) {
    const { gamma, omega, cells } = this.plane;
    const [x, y] = [cellBorders(gamma), cellBorders(omega)].map((borders) => borders.map((value) => Math.max(value, 1e-9)));
    cells.forEach((line, i) => line.forEach((cell, j) => {
      if (cell.length < 2) return;
      const [left, right, top, bottom] = [box.x.pixel(x[j]), box.x.pixel(x[j + 1]), box.y.pixel(y[i + 1]), box.y.pixel(y[i])];
      const first = Math.ceil((left + top) / HATCH) * HATCH;
      const sums = first < right + bottom ? range(first, right + bottom, HATCH) : [(left + right + top + bottom) / 2];
      const colours = cell.map(({ id }) => branchColour(id, box.theme.dark));
      for (const sum of sums) {
        const ends = [[Math.max(left, sum - bottom), Math.min(bottom, sum - left)], [Math.min(right, sum - top), Math.max(top, sum - right)]];
        polyline(ctx, colours[1] === colours[0] ? box.theme.text : colours[1], HATCH / 2.4, ends);
      }
    }));
  }

  #drawCursor(ctx, box) {
    const selected = this.selected();
    if (selected && isClose(selected.xi, this.plane.xi)) drawRing(ctx, box, selected.gamma, selected.omega, 9);
    if (this.current) drawRing(ctx, box, this.plane.gamma[this.current.column], this.plane.omega[this.current.row], 6);
  }

  nearest(x, y) {
    return this.plane ? nearestCell(this.plane.gamma, this.plane.omega, x, y) : null;
  }

  step(current, right, up) {
    return this.plane ? nextCell(this.plane.gamma, this.plane.omega, current, right, up) : null;
  }

  centre() {
    return this.current ? this.plane.gamma[this.current.column] : undefined;
  }

  cellOf({ column, row }) {
    const { gamma, omega, xi, cells } = this.plane;
    return cells[row][column].length ? { gamma: gamma[column], omega: omega[row], xi, direction: startName("attractor", 1) } : null;
  }

  describe({ column, row }) {
    const { gamma, omega, cells, count } = this.plane;
    const parts = [`Γ = ${number(gamma[column])}`, `Ω = ${number(omega[row])}`];
    if (count[row][column] < 0) parts.push("not computed yet");
    return [...parts, ...cells[row][column].map((place) => this.placeText(place))].join(" · ");
  }
}

/** The plane from its Dataset: `cells` are the attractors of each cell, in rows of Ω, with the flights of a line. */
function read({ attrs, ...found }) {
  const list = (name) => Array.from(found[name].data);
  const rows = ({ data, shape }) => Array.from({ length: shape[0] }, (_, i) => Array.from(data.slice(i * shape[1], (i + 1) * shape[1])));
  const { id, label, fraction, longest_flight: longest, flight_time: flights } = found;
  const [, columns, places] = id.shape;
  const place = (i, j, k) => {
    const at = (i * columns + j) * places + k;
    const times = flights?.data.slice(at * flights.shape[3], (at + 1) * flights.shape[3]).filter(Number.isFinite);
    return { id: id.data[at], label: label.data[i][j][k], fraction: fraction.data[at], longest_flight: longest.data[at], flight_time: Array.from(times ?? []) };
  };
  const cell = (i, j) => Array.from({ length: places }, (_, k) => place(i, j, k)).filter((each) => each.id);
  const [kind, attractor, low, high, below, above, other] = ["kind", "attractor", "gamma_below", "gamma_above", "below", "above", "leads_to"].map((name) => list(`event_${name}`));
  return {
    ...attrs, xi: found.xi.data, omega: list("omega"), gamma: list("gamma"), count: rows(found.count),
    cells: list("omega").map((_, i) => list("gamma").map((_, j) => cell(i, j))),
    attractors: list("attractor").map((id, i) => ({ id, label: found.attractor_label.data[i], cells: found.cells.data[i] })),
    events: kind.map((_, i) => ({ kind: kind[i], attractor: attractor[i], low: low[i], high: high[i], below: below[i], above: above[i], other: other[i] })),
  };
}

const range = (first, end, step) => Array.from({ length: Math.ceil((end - first) / step) }, (_, i) => first + i * step);
