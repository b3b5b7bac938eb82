// The difference of two sweeps: where their mode maps differ, as a map and a sentence.

import { query } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { number, share } from "../lib/format.js";
import { OUTCOME, modeText, nearestIndex } from "../lib/physics.js";
import { modeClasses, modeColour, theme } from "../plot/colours.js";
import { rgba32 } from "../plot/drawing.js";
import { ClassLegend, PlaneView } from "../views/cells.js";
import { sliders } from "../views/controls.js";

/** The cells of the first sweep; each is compared with the nearest one of the second. */
export class Difference extends PlaneView {
  name = "difference";

  constructor(root, view) {
    super(view);
    this.sentence = h("p", { className: "sentence", role: "status" });
    this.legend = new ClassLegend(this, "Modes of the second sweep");
    this.build(root, { controls: h("div", { className: "controls" }, sliders(this, ["xi"]), this.sentence), label: "Where the modes differ", shown: [this.legend.element], hint: "Cells that differ have the colour that they have in the second sweep." });
  }

  paths() {
    const of = (name) => this.sources.map(({ job, grid, directions: [direction] }) => `/v1/jobs/${job.id}/${name}?${query({ xi: grid.xi[nearestIndex(grid.xi, this.place.xi)], ...(name === "modes" ? { direction } : { predict: "none" }) })}`);
    return [...of("modes"), ...of("threshold")];
  }

  filePath({ job }) {
    return this.paths().find((path) => path.includes(job.id));
  }

  read([first, second, ...thresholds]) {
    const [a, b] = [first, second].map((result) => Object.fromEntries(["outcome", "label", "bounces", "periods"].map((name) => [name, result[name]?.data])));
    Object.assign(this, { first: a, second: b, columns: first.gamma.data, rows: first.omega.data, xi: first.xi.data });
    const [columns, rows] = [["columns", "gamma"], ["rows", "omega"]].map(([own, axis]) => Array.from(this[own], (value) => nearestIndex(second[axis].data, value)));
    this.other = rows.flatMap((row) => columns.map((column) => row * second.gamma.data.length + column));
    this.classes = modeClasses(b);
    const isKnown = (cell) => a.outcome[cell] !== OUTCOME.missing && b.outcome[this.other[cell]] !== OUTCOME.missing;
    const known = this.other.map((_, cell) => cell).filter(isKnown);
    this.differs = Uint8Array.from(this.other, (_, cell) => isKnown(cell) && modeText(a, cell) !== modeText(b, this.other[cell]));
    const same = known.filter((cell) => !this.differs[cell]).length;
    this.sentence.textContent = known.length ? `${share(same / known.length, 4)} of the cells have the same mode; ${moved(thresholds)}.` : "No cell of both is computed yet.";
  }

  content() {
    return {
      ...this.scales(this.axisOf("gamma"), this.axisOf("omega")),
      title: `ξ = ${number(this.xi)}`,
      layers: [(ctx, box) => this.#paint(ctx, box)],
      cursor: (ctx, box) => this.drawCursor(ctx, box),
    };
  }

  #paint(ctx, box) {
    const colours = new Map(this.classes.present.map(({ id }) => [id, rgba32(modeColour(id, box.theme.dark))]));
    const same = rgba32(box.theme.surface);
    const { hidden } = this.legend;
    this.drawCells(ctx, box, (cell) => {
      const id = this.classes.ofCell[this.other[cell]];
      return this.differs[cell] && !hidden.has(id) ? colours.get(id) : same;
    });
  }

  showLegend() {
    this.legend.show(this.classes, theme().dark);
  }

  isHidden(cell) {
    const index = this.indexOf(cell);
    return !this.differs[index] || this.legend.hidden.has(this.classes.ofCell[this.other[index]]);
  }

  columnsOfTable() {
    return [...this.columnsOfPlane(), ["first", (cell) => modeText(this.first, this.indexOf(cell))], ["second", (cell) => modeText(this.second, this.other[this.indexOf(cell)])]];
  }

  cellOf({ column, row }) {
    return { gamma: this.columns[column], omega: this.rows[row], xi: this.xi, direction: this.directions[0] };
  }
}

/** By how much the thresholds of two sweeps move, at the Ω of both. */
function moved([first, second]) {
  const away = ["up", "down"].flatMap((way) => Array.from(first.omega.data, (omega, i) => {
    const j = nearestIndex(second.omega.data, omega);
    return Math.abs(second.omega.data[j] - omega) < 1e-9 ? Math.abs(first[way].data[i] - second[way].data[j]) : NaN;
  })).filter(Number.isFinite);
  const most = Math.max(...away);
  return !away.length ? "there is no threshold in both" : most ? `no threshold moves by more than ${number(most, 2)}` : "no threshold moves";
}
