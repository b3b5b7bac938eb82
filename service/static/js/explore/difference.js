// The difference of two sweeps: where their mode maps differ, as a map and a sentence.

import { query } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { axisText, modeText, nearestIndex } from "../lib/physics.js";
import { modeClasses, modeColour } from "../plot/colours.js";
import { rgba32 } from "../plot/drawing.js";
import { ClassLegend, PlaneView } from "../views/cells.js";
import { sliders } from "../views/controls.js";

const HINT = "Cells that differ have the colour that they have in the second sweep.";
const OTHER_MODE = 1; // of `differs`

/** The cells of the first sweep; each is compared with the nearest one of the second. */
export class Difference extends PlaneView {
  name = "difference";

  constructor(root, view) {
    super(view);
    this.sentence = h("p", { className: "sentence", role: "status" });
    this.legend = new ClassLegend(this, "Modes of the second sweep");
    this.build(root, { controls: h("div", { className: "controls" }, sliders(this, ["xi"]), this.sentence), label: "Where the modes differ", shown: [this.legend.element], hint: HINT });
  }

  paths() {
    const [{ job, grid }, other] = this.sources;
    return [`/v1/jobs/${job.id}/difference?${query({ other: other.job.id, xi: grid.xi[nearestIndex(grid.xi, this.place.xi)] })}`];
  }

  filePath() {
    return this.paths()[0];
  }

  read([result]) {
    const cellsOf = (prefix) => Object.fromEntries(["outcome", "label", "bounces", "periods"].map((name) => [name, result[prefix + name]?.data]));
    [this.columns, this.rows, this.xi, this.differs] = ["gamma", "omega", "xi", "differs"].map((name) => result[name].data);
    Object.assign(this, { first: cellsOf(""), second: cellsOf("other_"), classes: modeClasses(cellsOf("other_")) });
    this.title = `ξ = ${[...new Set([this.xi, result.attrs.other_xi])].map((xi) => axisText(xi, this.grid.xi)).join(" and ")}`;
    this.sentence.textContent = result.attrs.sentence;
  }

  content() {
    return {
      ...this.scales(this.axisOf("gamma"), this.axisOf("omega")),
      title: this.title,
      layers: [(ctx, box) => this.#paint(ctx, box)],
      cursor: (ctx, box) => this.drawCursor(ctx, box),
    };
  }

  #paint(ctx, box) {
    const colours = new Map(this.classes.present.map(({ id }) => [id, rgba32(modeColour(id, box.theme.dark))]));
    const same = rgba32(box.theme.surface);
    const { hidden } = this.legend;
    this.drawCells(ctx, box, (cell) => {
      const id = this.classes.ofCell[cell];
      return this.differs[cell] === OTHER_MODE && !hidden.has(id) ? colours.get(id) : same;
    });
  }

  isHidden(cell) {
    const index = this.indexOf(cell);
    return this.differs[index] !== OTHER_MODE || this.legend.hidden.has(this.classes.ofCell[index]);
  }

  columnsOfTable() {
    return [...this.columnsOfPlane(), ...["first", "second"].map((name) => [name, (cell) => modeText(this[name], this.indexOf(cell))])];
  }
}
