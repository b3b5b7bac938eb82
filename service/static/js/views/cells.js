// Cells on a rectangular plane: drawing them, pointing at one, stepping from one to the next, their legend.

import { currentQuery, setQuery } from "../lib/address.js";
import { choice, h, keepFocus } from "../lib/dom.js";
import { share } from "../lib/format.js";
import { axisColumn, clamp, clampIndex, isClose, nearestIndex } from "../lib/physics.js";
import { classQuery, modeColour, theme } from "../plot/colours.js";
import { bitmap, circle, polyline, rgba32 } from "../plot/drawing.js";
import { cellExtent } from "../plot/scale.js";
import { PlotView } from "./plot-view.js";

/** The window of all cells around `columns` and `rows`; with `positive` none of it is below 0, for logarithmic axes. */
export function windowOf(columns, rows, positive = false) {
  const [[x0, x1], [y0, y1]] = [cellExtent(columns, positive), cellExtent(rows, positive)];
  return { x0, x1, y0, y1 };
}

/** A view of cells {column, row}: indices into the `columns` and `rows` that were loaded. */
export class PlaneView extends PlotView {
  isPositive = true; // the window is not below 0

  whole() {
    return windowOf(this.columns, this.rows, this.isPositive);
  }

  nearest(x, y) {
    const { x0, x1, y0, y1 } = windowOf(this.columns, this.rows, this.isPositive);
    const isInside = x >= x0 && x <= x1 && y >= y0 && y <= y1;
    return isInside ? { column: nearestIndex(this.columns, x), row: nearestIndex(this.rows, y) } : null;
  }

  step(current, right, up) {
    const { column, row } = current ?? { column: this.columns.length >> 1, row: this.rows.length >> 1 };
    return { column: clampIndex(column + right, this.columns.length), row: clampIndex(row + up, this.rows.length) };
  }

  at({ column, row }) {
    return [this.columns[column], this.rows[row]];
  }

  indicesInWindow() {
    const inside = (values, low, high) => [values.findIndex((value) => value >= low), values.findLastIndex((value) => value <= high) + 1];
    const { x0, x1, y0, y1 } = this.visible();
    const [[left, right], [bottom, top]] = [inside(this.columns, x0, x1), inside(this.rows, y0, y1)];
    const indices = new Uint32Array(Math.max(right - left, 0) * Math.max(top - bottom, 0)); // up to a million: no object for each
    let i = 0;
    for (let row = bottom; row < top; row++) for (let column = left; column < right; column++) indices[i++] = row * this.columns.length + column;
    return indices;
  }

  cellsInWindow() {
    return Array.from(this.indicesInWindow(), (i) => ({ column: i % this.columns.length, row: Math.floor(i / this.columns.length) }));
  }

  get direction() {
    const { dir } = currentQuery();
    return this.directions.includes(dir) ? dir : this.directions[0];
  }

  rampChoice = () => this.directions.length > 1 && choice("Ramp", this.directions, this.direction, (dir) => setQuery({ dir }));

  /** The index of a cell in what is stored row by row. */
  indexOf = ({ column, row }) => row * this.columns.length + column;

  classOf = (cell) => this.classes.ofCell[this.indexOf(cell)];

  columnsOfPlane() {
    const { gamma, omega } = this.grid;
    return [axisColumn("Γ", gamma, ({ column }) => this.columns[column]), axisColumn("Ω", omega, ({ row }) => this.rows[row]), ...this.common({ xi: this.xi })];
  }

  cellOf({ column, row }) {
    return { gamma: this.columns[column], omega: this.rows[row], xi: this.xi, direction: this.loadedDirection ?? this.directions[0] };
  }

  /** Where the selected cell, or start, is on this plane. */
  positionOf({ gamma, omega, xi, direction }) {
    return isClose(xi, this.xi) && direction === (this.loadedDirection ?? direction) && [gamma, omega];
  }

  drawCursor(ctx, box) {
    const selected = this.selected();
    const position = selected && this.positionOf(selected);
    if (position) drawRing(ctx, box, ...position, 9);
    if (this.current) drawRing(ctx, box, ...this.at(this.current), 6);
  }

  /** Each pixel has the colour of the nearest cell, `colourOf(cell)` as 32 bits, or what is `over(cell, x, y)`, unless that is null; `cell` is its index, x and y are in px. */
  drawCells(ctx, box, colourOf, over = null) {
    const { x0, x1, y0, y1 } = windowOf(this.columns, this.rows, this.isPositive);
    const [left, right] = [x0, x1].map((value) => clamp(box.x.pixel(value), box.left, box.left + box.width));
    const [bottom, top] = [y0, y1].map((value) => clamp(box.y.pixel(value), box.top, box.top + box.height));
    const [width, height] = [Math.round((right - left) * box.ratio), Math.round((bottom - top) * box.ratio)];
    if (!width || !height) return;
    const nearest = Int32Array.from({ length: width }, (_, i) => nearestIndex(this.columns, box.x.value(left + ((i + 0.5) * (right - left)) / width)));
    const fill = (pixels) => {
      for (let y = 0, start = 0, last = -1; y < height; y++, start += width) {
        const first = this.indexOf({ row: nearestIndex(this.rows, box.y.value(top + ((y + 0.5) * (bottom - top)) / height)), column: 0 });
        if (first === last) pixels.copyWithin(start, start - width, start);
        else for (let i = 0; i < width; i++) pixels[start + i] = colourOf(first + nearest[i]);
        last = over ? -1 : first;
        for (let i = 0; over && i < width; i++) pixels[start + i] = over(first + nearest[i], i / box.ratio, y / box.ratio) ?? pixels[start + i];
      }
    };
    bitmap(ctx, width, height, fill, left, top, right, bottom);
  }
}

/** A ring with an outline, visible on every colour. */
function drawRing(ctx, { x, y, theme }, column, row, radius) {
  circle(ctx, theme.surface, 4.5, x.pixel(column), y.pixel(row), radius);
  circle(ctx, theme.cursor, 2, x.pixel(column), y.pixel(row), radius);
}

const HATCH = 9; // px between the lines over hatched cells; each is two lines, so that it is visible on every colour
const HATCH_LINE = 1.6; // px, of either

/** Which line of the hatching is at (x, y), in px: 0, 1 beside it, -1 none. They rise, or else fall. */
export function hatchAt(x, y, rises = true) {
  const along = rises ? x + y : x - y + 1e6 * HATCH;
  const line = Math.floor((along % HATCH) / HATCH_LINE);
  return line < 2 ? line : -1;
}

export function hatchSymbol(ctx, x, y, theme, rises = true) {
  for (const left of [x, x + 8, x + 16]) polyline(ctx, theme.text, 1.6, [[left, y + (rises ? 6 : -6)], [left + 8, y - (rises ? 6 : -6)]]);
}

/** A legend of classes of cells (see modeClasses), as buttons that hide a class; the address holds those hidden. */
export class ClassLegend {
  constructor(view, label) {
    this.view = view;
    this.element = h("ul", { className: "legend", "aria-label": label });
  }

  get hidden() {
    return new Set((currentQuery().hide ?? "").split(",").filter(Boolean).map(Number));
  }

  /** The hidden classes as queries of the service name them; null without any. */
  get query() {
    return [...this.hidden].map(classQuery).filter(Boolean).join() || null;
  }

  /** The classes of the cells in the window, with their shares. */
  show({ present, ofCell }) {
    const { hidden, view } = this;
    const { dark } = theme();
    const toggle = (id) => {
      setQuery({ hide: [...this.hidden.symmetricDifference(new Set([id]))].join() || null });
      view.showLegend();
      view.draw();
    };
    const shares = sharesAt(view.indicesInWindow(), ofCell);
    const entries = present.filter(({ id }) => shares[id]).map(({ id, name }) => legendEntry(modeColour(id, dark), h("button", {
      type: "button", className: "link", "aria-pressed": String(!hidden.has(id)), title: "Hide or show", onclick: () => toggle(id),
    }, name), " ", h("small", {}, share(shares[id], 2))));
    keepFocus(this.element, () => this.element.replaceChildren(...entries));
  }

  /** The colours of the classes, as 32 bits; hidden ones have that of the surface. */
  colours({ surface, dark }) {
    const colours = new Uint32Array(256);
    for (const { id } of this.view.classes.present) colours[id] = rgba32(this.hidden.has(id) ? surface : modeColour(id, dark));
    return colours;
  }
}

/** The share of each value of `values`, small numbers, at these indices. */
export function sharesAt(indices, values) {
  const counts = new Float64Array(256);
  for (let i = 0; i < indices.length; i++) counts[values[indices[i]]]++;
  return counts.map((cells) => cells / indices.length);
}

export const legendEntry = (colour, ...texts) => h("li", {}, swatch(colour), h("div", {}, texts));

export const swatch = (colour) => h("span", { className: "swatch", "aria-hidden": "true", style: `background: ${colour}` });
