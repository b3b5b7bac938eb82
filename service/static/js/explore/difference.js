// The difference of two sweeps: where their mode maps differ, as a map and a sentence.

import { query } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { axisText, modeText, nearestIndex } from "../lib/physics.js";
import { modeClasses } from "../plot/colours.js";
import { rgba32 } from "../plot/drawing.js";
import { ClassLegend, PlaneView } from "../views/cells.js";
import { sliders } from "../views/controls.js";

const HINT = "Cells that differ have the colour that they have in the second sweep; shares are of these cells.";
const OTHER_MODE = 1; // of `differs`

/** The cells of the first sweep; each is compared with the nearest one of the second. */
export class Difference extends PlaneView {
  name = "difference";

  constructor(root, view) {
    super(view);
    this.sentence = h("p", { className: "sentence", role: "status" });
    this.legend = new ClassLegend(this, "Modes in the second sweep, with their shares of the cells that differ");
    this.build(root, { controls: [sliders(this, ["xi"]), this.rampChoice()], label: "Where the modes differ", shown: [this.sentence, this.legend.element], hint: HINT });
  }

  paths = () => [this.filePath()];

  filePath() {
    const [{ job, grid }, other] = this.sources;
    return `/v1/jobs/${job.id}/difference?${query({ other: other.job.id, xi: grid.xi[nearestIndex(grid.xi, this.place.xi)], direction: this.direction })}`;
  }

  read([result]) {
    const cellsOf = (prefix) => Object.fromEntries(["outcome", "label", "bounces", "periods"].map((name) => [name, result[prefix + name]?.data]));
    [this.columns, this.rows, this.xi, this.loadedDirection, this.differs] = ["gamma", "omega", "xi", "direction", "differs"].map((name) => result[name].data);
    Object.assign(this, { first: cellsOf(""), second: cellsOf("other_"), classes: modeClasses(cellsOf("other_")) });
    const both = (value, other, text) => [...new Set([value, other])].map(text).join(" and ");
    const directions = both(this.loadedDirection, result.attrs.other_direction, (direction) => (direction === "rest" ? "from rest" : `ramp ${direction}`));
    this.title = `ξ = ${both(this.xi, result.attrs.other_xi, (xi) => axisText(xi, this.grid.xi))}, ${directions}`;
    this.sentence.textContent = result.attrs.sentence;
  }

  content() {
    const draw = (ctx, box) => {
      const [colours, same] = [this.legend.colours(box.theme), rgba32(box.theme.surface)];
      this.drawCells(ctx, box, (cell) => (this.differs[cell] === OTHER_MODE ? colours[this.classes.ofCell[cell]] : same));
    };
    return { ...this.scales(this.axisOf("gamma"), this.axisOf("omega")), title: this.title, layers: [draw] };
  }

  indicesInWindow() {
    return super.indicesInWindow().filter((cell) => this.differs[cell] === OTHER_MODE);
  }

  columnsOfTable = () => [...this.columnsOfPlane(), ...["first", "second"].map((name) => [name, (cell) => modeText(this[name], this.indexOf(cell))])];
}
