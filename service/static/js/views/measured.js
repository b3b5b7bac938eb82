// Measured points on a plot, as `job.plot(data=…)` has them: a CSV file dropped on the page, drawn above what is computed.

import { requestBlob } from "../lib/api.js";
import { announce, button, fileInput, fileName, h, problemLine, resultFiles } from "../lib/dom.js";
import { count, number, numberIn, plural } from "../lib/format.js";
import { AXES, SYMBOL, TWO_PI, initialValue, isSweep } from "../lib/physics.js";
import { polygon, polyline } from "../plot/drawing.js";
import { cellBorders } from "../plot/scale.js";

const COLUMNS = ["gamma", "omega", "xi", "flight_time", "flight_time_ms", "frequency", "error"];
const MOST_ROWS = 100_000;
const NEAR = 1e-6; // relative, of values that are the same
const SIZE = 4.5; // px, of half a marker
const RULE = "commas separate columns, points decimals";

/** The files that were dropped, until the page is left: {name, text, value, rows} by job and value. */
const kept = new Map();
/** Those of a shared file, [{name, text, value}, …]. */
const SHARED_FILES = JSON.parse(document.getElementById("measured")?.textContent ?? "[]");

/** Downloads of all that a study stores; of a sweep a page to share too, with what was dropped on its plots. */
export const wholeStudy = (job, formats, name = isSweep(job.spec) ? "sweep" : job.spec.protocol.kind) =>
  [...resultFiles(job, () => name, formats, () => `/v1/jobs/${job.id}/export?`), ...(name === "sweep" ? [sharedPage(job)] : [])];
const sharedPage = (job) => ["a page to share", () => fileName(job, "sweep", "html"), async () => {
  const page = await requestBlob(`/v1/jobs/${job.id}/export?format=html`);
  const files = [...kept].filter(([key]) => key.startsWith(job.id)).map(([, { name, text, value }]) => ({ name, text, value }));
  return files.length ? new Blob([page, `<script type="application/json" id="measured">${JSON.stringify(files).replaceAll("<", "\\u003c")}</script>`]) : page;
}];

/** The points on the plot of a view, of a `value`: "flight_time" in rad, or "gamma". Columns and rules are those of
 * service/client/measured.py. The view has the axis `along`, and computed(): a function from a value of it to those computed. */
export class MeasuredPoints {
  constructor(view, value) {
    Object.assign(this, { view, value, key: `${view.job.id} ${value}` });
    this.problem = problemLine();
    this.text = h("span", {});
    this.line = h("p", { className: "note measured", role: "status", hidden: true }, this.text, " ", button("remove", () => this.#keep(null), { className: "link" }));
    const about = `A CSV file whose columns are some of ${COLUMNS.join(", ")}, dropped on the page or chosen here: `;
    const choose = h("label", { className: "note" }, about, fileInput(".csv", (file) => this.take(file)));
    this.elements = [this.problem.element, this.line, h("details", { className: "paged" }, h("summary", {}, "Measured points"), choose)];
    const file = SHARED_FILES.find((shared) => shared.value === value);
    if (file && !kept.has(this.key)) this.take({ ...file, text: () => file.text });
  }

  async take(file) {
    try {
      const text = await file.text();
      this.#keep({ name: file.name, text, value: this.value, rows: tableOf(text, this.view.along, this.value) });
    } catch (error) {
      this.problem.show(new Error(`${file.name}: ${error.message}.`));
    }
  }

  #keep(table) {
    kept[table ? "set" : "delete"](this.key, table);
    this.problem.show(null);
    if (this.view.isLoaded) this.view.draw();
    announce(table ? this.text.textContent : "The measured points are removed.");
    if (!table) this.elements.at(-1).firstChild.focus(); // the button pressed is hidden
  }

  /** The points {x, y, error} over the axis of the view, without rows of other values than its fixed ones. */
  get points() {
    const { along, place, source: { grid } } = this.view;
    const fixed = this.#fixed.map((axis) => [axis, initialValue(grid[axis], place[axis])]);
    const rows = (kept.get(this.key)?.rows ?? []).filter((row) => fixed.every(([axis, value]) => !(Math.abs(row[axis] - value) > NEAR * value)));
    return rows.map((row) => ({ x: row[along], y: row[this.value], error: row.error }));
  }

  get #fixed() {
    return AXES.filter((axis) => axis !== this.view.along && axis !== this.value);
  }

  valuesIn = (low, high) => this.points.filter(({ x }) => x >= low && x <= high).map(({ y }) => y);

  update() {
    const { points, view } = this;
    this.line.hidden = !kept.has(this.key);
    if (this.line.hidden) return;
    const [borders, computedAt] = [cellBorders(view.lines?.[0].values ?? view.grid[view.along]), view.computed()]; // of a long line its window
    const distance = ({ x, y }) => Math.min(...computedAt(x).map((value) => Math.abs(value - y)));
    const distances = points.filter(({ x }) => x >= borders[0] && x <= borders.at(-1)).map(distance).filter(Number.isFinite).sort((a, b) => a - b);
    const median = (distances[(distances.length - 1) >> 1] + distances[distances.length >> 1]) / 2;
    const unit = this.value === "gamma" ? "" : " rad";
    const residual = distances.length ? `, median residual ${number(median, 2)}${unit}, largest ${number(distances.at(-1), 2)}${unit}` : "";
    const { name, rows } = kept.get(this.key);
    const others = rows.length - points.length;
    const elsewhere = others ? `; ${count(others)} of another ${this.#fixed.map((axis) => SYMBOL[axis]).join(" or ")} left out` : "";
    this.text.textContent = `Measured, ${name}: ${count(distances.length)} of ${plural(points.length, "point")} where computed ones are shown${residual}${elsewhere} ·`;
  }

  draw(ctx, box) {
    for (const { x, y, error } of this.points) {
      const [px, py] = [box.x.pixel(x), box.y.pixel(y)];
      if (error > 0) polyline(ctx, box.theme.cursor, 1, [[px, box.y.pixel(Math.max(y - error, box.y.low))], [px, box.y.pixel(y + error)]]);
      const corners = [[px, py - SIZE], [px + SIZE, py], [px, py + SIZE], [px - SIZE, py], [px, py - SIZE]];
      polygon(ctx, box.theme.surface, corners);
      polyline(ctx, box.theme.cursor, 1.4, corners);
    }
  }
}

/** The rows of a CSV text with both values: numbers by column, NaN where a cell is empty. Throws an Error naming column or row, from 1. */
function tableOf(text, along, value) {
  if (text.includes("\0")) throw new Error("is no text in UTF-8");
  const [names, ...rows] = text.match(/(?:#.*|"[^"]*"|[^\r\n])+/g)?.map((line) => line.replace(/#.*/, "")).filter((line) => line.trim())
    .map((line) => line.split(",").map((cell) => cell.trim().replace(/^"([^"]*)"$/, "$1").trim())) ?? [];
  while (names?.at(-1) === "") names.pop(); // below a comma too many
  if (!rows.length) throw new Error("has no rows below a line with the names of its columns");
  if (rows.length > MOST_ROWS) throw new Error(`has more than ${count(MOST_ROWS)} rows`);
  const unknown = names.find((name, i) => !COLUMNS.includes(name) || names.indexOf(name) < i);
  const wrong = COLUMNS.includes(unknown) ? "there twice" : "no column here";
  if (unknown !== undefined) throw new Error(`${unknown.slice(0, 40)} is ${wrong}; these are ${COLUMNS.join(", ")}, separated by commas`);
  const inMs = value === "flight_time" && names.includes("flight_time_ms");
  if (inMs && !names.includes("frequency")) throw new Error("flight_time_ms needs the plate's frequency in Hz, as a column");
  const missing = [along, inMs ? "flight_time_ms" : value].find((name) => !names.includes(name));
  if (missing) throw new Error(`needs the column ${missing}${missing === "flight_time" ? " or flight_time_ms" : ""}; it has ${names.join(", ")}`);
  const valueIn = (cell = "", name, row) => {
    const [value, rule] = [numberIn(cell), name === "frequency" ? "above 0" : "of 0 or more"];
    if (/^(-?nan?|<na>|nat|n\/a|null|none)?$/i.test(cell)) return NaN;
    if (Number.isFinite(value) && (value > 0 || (value === 0 && name !== "frequency"))) return value;
    throw new Error(`${name} of row ${row + 1} must be a number ${rule}, not '${cell.slice(0, 40)}'; ${RULE}`);
  };
  return rows.map((cells, i) => {
    if (cells.slice(names.length).some(Boolean)) throw new Error(`row ${i + 1} has more cells than there are columns; ${RULE}`);
    const row = Object.fromEntries(names.map((name, k) => [name, valueIn(cells[k], name, i)]));
    const radPerMs = (TWO_PI * row.frequency) / 1000;
    return inMs ? { ...row, flight_time: row.flight_time_ms * radPerMs, error: row.error * radPerMs } : row;
  }).filter((row) => Number.isFinite(row[along] + row[value]));
}
