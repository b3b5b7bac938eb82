// The mode map: the outcome of every cell of a (Γ, Ω) plane, with the threshold of Eq. 25.

import { currentQuery, setQuery } from "../lib/address.js";
import { query, shared } from "../lib/api.js";
import { checkBox, choice, h } from "../lib/dom.js";
import { share } from "../lib/format.js";
import { HYSTERESIS, OUTCOME, cellColumns, certifies, hasSpring, nearestIndex, threshold } from "../lib/physics.js";
import { modeClasses } from "../plot/colours.js";
import { CURVE_DASH, legendLine, polyline, rgba32 } from "../plot/drawing.js";
import { ClassLegend, PlaneView, hatchAt, hatchSymbol, sharesAt, windowOf } from "./cells.js";
import { minFlightInput, minFlightOf, sliders } from "./controls.js";
import { UNFINISHED, titleOf } from "./progress.js";

const COLOURS = [["mode", "modes"], ["multiplier", "margin of stability |μ|"]];
const HINT = "Point at a cell to read it, press to show its trajectory, drag or turn the wheel to zoom. Modes are (bounces, plate periods).";

export class Modes extends PlaneView {
  name = "modes";
  windowed = ["gamma", "omega"];
  marks = () => [this.showsComputed.control.checked && "the marks of computed cells"];

  constructor(root, view) {
    super(view);
    this.isAdaptive = Boolean(this.job.spec.refine);
    this.isTwoWay = this.directions.length > 1;
    const isFirst = (has) => this.compared.find(has) === this.source; // a control acts on the maps of all compared sweeps
    const canHatch = isFirst(({ directions }) => directions.length > 1);
    const setColour = (color) => setQuery({ color: color === "mode" ? null : color });
    const setHatch = ({ target }) => setQuery({ hatch: target.checked ? null : 0 });
    this.showsComputed = checkBox("Show which cells were computed", { onchange: () => this.plot.draw() });
    this.legend = new ClassLegend(this, "Modes: (bounces, plate periods)");
    this.note = h("p", { className: "note", role: "status" });
    this.build(root, {
      controls: [sliders(this, ["xi"]),
        canHatch && this.rampChoice(),
        isFirst(({ job }) => certifies(job.spec)) && choice("Colour", COLOURS, this.color, setColour, { "data-service": true })],
      label: `Mode map of ${titleOf(this.job)}`, hint: HINT,
      shown: [this.legend.element, this.note, h("div", { className: "controls" },
        canHatch && checkBox("Hatch where up and down differ", { checked: this.showsHysteresis, onchange: setHatch }),
        this.isAdaptive && this.showsComputed,
        !this.isAdaptive && !this.isFollower && minFlightInput(this.job))],
    });
  }

  get showsHysteresis() {
    return this.isTwoWay && currentQuery().hatch !== "0";
  }

  get color() {
    return certifies(this.job.spec) && currentQuery().color === "multiplier" ? "multiplier" : "mode";
  }

  #path(parameters) {
    const { xi } = this.source.grid;
    const plane = { xi: xi[nearestIndex(xi, this.place.xi)], direction: this.direction };
    return `/v1/jobs/${this.job.id}/modes?${query({ ...plane, min_flight: this.isAdaptive ? null : minFlightOf(this.job), hysteresis: this.showsHysteresis || null, color: this.color === "mode" ? null : this.color, ...parameters })}`;
  }

  /** The whole map; of a map with more cells than are sent, the zoomed window in more detail. */
  paths() {
    return [this.#path(this.isThinned ? this.windowOn("gamma", "omega") : {})];
  }

  /** What is shown: the cells of the window, in a picture without hidden modes. */
  filePath() {
    return this.#path({ ...this.windowOn("gamma", "omega"), log: this.log, hide: this.legend.query });
  }

  read([result]) {
    const { attrs, dims, ...variables } = result;
    Object.assign(this, { attrs, cells: Object.fromEntries(Object.entries(variables).map(([name, { data }]) => [name, data])) });
    [this.columns, this.rows, this.xi, this.loadedDirection] = ["gamma", "omega", "xi", "direction"].map((name) => this.cells[name]);
    this.classes = modeClasses(this.cells);
    this.isPreview = !attrs.complete && UNFINISHED.has(this.job.state);
    this.painted = this.isPreview ? nearestComputed(this.cells.outcome, this.columns.length).map((cell) => this.classes.ofCell[cell]) : this.classes.ofCell;
  }

  showLegend() {
    super.showLegend();
    const { every, computed_share: computed } = this.attrs;
    const thinned = every > 1 ? `Shown: 1 in ${every} Γ and Ω. ${shared ? "" : "Zoom in for more detail. "}` : "";
    const adaptive = `Adaptive map: ${share(computed, 2)} of the cells were computed; the others have the mode of their block${this.color === "mode" ? "" : " and |μ| of a computed neighbour"}. `
      + `Filling gives up to ${hasSpring(this.job) ? "0.7 %" : "half"} of a map’s cells another mode.`;
    this.note.textContent = thinned + (!this.isAdaptive ? this.#hysteresisText() : this.isPreview ? "" : adaptive);
  }

  get #isEmpty() {
    return this.classes.present.every(({ id }) => id === OUTCOME.missing);
  }

  #hysteresisText() {
    const { hysteresis } = this.cells;
    if (!hysteresis || this.#isEmpty) return "";
    const parts = sharesAt(this.indicesInWindow(), hysteresis);
    const [mode, flights] = [parts[HYSTERESIS.mode], parts[HYSTERESIS.flights]];
    if (!mode && !flights) return "Up and down agree in every cell shown that both have reached.";
    const kinds = [[mode, "to other modes (hatched /)"], [flights, "to other flights of one mode (hatched \\)"]].filter(([part]) => part);
    const shares = kinds.map(([part, text]) => `${text} in ${share(part, 2)}`).join(", ");
    return `Hysteresis: going up and down lead ${shares} of the cells shown.`;
  }

  whole = () => windowOf(this.source.grid.gamma, this.source.grid.omega, true);

  content() {
    const { x0, x1, y0, y1 } = this.visible();
    const isCrossed = Array.from({ length: 2001 }, (_, i) => threshold(y0 + (i * (y1 - y0)) / 2000, this.xi)).some((gamma) => gamma >= x0 && gamma <= x1);
    return {
      ...this.scales(this.axisOf("gamma"), this.axisOf("omega")),
      title: `${this.prefix}${this.textOf({ xi: this.xi })}${this.isTwoWay ? `, ramp ${this.loadedDirection}` : ""}`,
      legend: [
        ...(this.isPreview ? [["not computed yet: the colour of the nearest cell"]] : []),
        ...[["mode", "up and down differ"], ["flights", "up and down differ in flights alone"]].filter(([kind]) => this.cells.hysteresis?.includes(HYSTERESIS[kind]))
          .map(([kind, name]) => [name, (...at) => hatchSymbol(...at, kind === "mode")]),
        ...(hasSpring(this.job) && isCrossed ? [["threshold, Eq. 25", (ctx, x, y, theme) => legendLine(ctx, theme.text, 1.8, x, y, CURVE_DASH)]] : []),
      ],
      message: this.#isEmpty ? "No cell is computed yet" : null,
      layers: [(ctx, box) => this.#drawModes(ctx, box), (ctx, box) => hasSpring(this.job) && drawThresholdCurve(ctx, box, this.xi)],
    };
  }

  #drawModes(ctx, box) {
    const { painted, cells: { computed, hysteresis } } = this;
    const colours = this.legend.colours(box.theme);
    const hatch = [rgba32(box.theme.text), rgba32(box.theme.surface)];
    const mark = rgba32(box.theme.cursor);
    const isMarked = this.showsComputed.control.checked;
    const over = (cell, x, y) => {
      const line = hysteresis?.[cell] ? hatchAt(x, y, hysteresis[cell] === HYSTERESIS.mode) : -1;
      return hatch[line] ?? (isMarked && computed[cell] ? mark : null);
    };
    this.drawCells(ctx, box, (cell) => colours[painted[cell]], hysteresis || isMarked ? over : null);
  }

  columnsOfTable() {
    const { hysteresis } = this.cells;
    const other = this.directions.find((direction) => direction !== this.loadedDirection);
    return [
      ...this.columnsOfPlane(), ...(this.loadedDirection === "rest" ? [] : [["ramp", () => this.loadedDirection, true]]), ...cellColumns(this.cells, (cell) => [this.cells, this.indexOf(cell)]),
      ...(hysteresis ? [[`ramped ${other}`, (cell) => ["", "another mode", "other flights"][hysteresis[this.indexOf(cell)]]]] : []),
    ];
  }
}

/** For each cell of a running sweep itself, or while it is not computed the nearest one that is: at its Γ, else at the nearest Γ with one. */
function nearestComputed(outcome, columns) {
  const nearest = Int32Array.from(outcome, (value, cell) => (value === OUTCOME.missing ? -1 : cell));
  const spread = (cell, from) => {
    const isNearer = nearest[cell] < 0 || Math.abs(nearest[from] - cell) < Math.abs(nearest[cell] - cell);
    if (nearest[from] >= 0 && isNearer) nearest[cell] = nearest[from];
  };
  for (let cell = columns; cell < nearest.length; cell++) spread(cell, cell - columns);
  for (let cell = nearest.length - columns - 1; cell >= 0; cell--) spread(cell, cell + columns);
  const begun = Array.from({ length: columns }, (_, column) => column).filter((column) => nearest[column] >= 0);
  if (!begun.length) return nearest.map((_, cell) => cell);
  const source = Array.from({ length: columns }, (_, column) => begun[nearestIndex(begun, column)] - column);
  return nearest.map((_, cell) => nearest[cell + source[cell % columns]]);
}

function drawThresholdCurve(ctx, box, xi) {
  const ys = Array.from({ length: box.height / 2 + 2 }, (_, i) => box.top + 2 * i);
  const points = ys.map((y) => [box.x.pixel(threshold(box.y.value(y), xi)), y]);
  polyline(ctx, box.theme.surface, 4, points);
  polyline(ctx, box.theme.text, 1.8, points, CURVE_DASH);
}
