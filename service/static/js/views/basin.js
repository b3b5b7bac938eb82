// The basins of one cell: which attractor each start of the plane reaches.

import { partsOf, query } from "../lib/api.js";
import { h, keepFocus } from "../lib/dom.js";
import { number, share } from "../lib/format.js";
import { AXES, axisColumn, exponentText, outcomeText, startName, startOf } from "../lib/physics.js";
import { attractorColour, theme } from "../plot/colours.js";
import { rgba32 } from "../plot/drawing.js";
import { PlaneView, legendEntry } from "./cells.js";
import { sliders } from "./controls.js";

const HINT = "Point at a start to read it, press to see it move, drag or turn the wheel to zoom.";
const AXES_OF = { // of the planes of starts: across and along, in a plot and in the readout
  drop: [["phase of the plate when let go (rad)", "phase"], ["height above the plate / A", "height"]],
  contact: [["velocity of the elongation × Ω / A", "velocity × Ω"], ["elongation beyond the static one / A", "elongation"]],
};

export class Basin extends PlaneView {
  name = "basin";
  isPositive = false;

  constructor(root, view) {
    super(view);
    this.legend = h("ul", { className: "legend", "aria-label": "Attractors and the shares of the starts that reach them" });
    this.entropies = h("p", { className: "note" });
    this.build(root, { controls: sliders(this, AXES), label: "Plane of starts", hint: HINT, shown: [this.legend, this.entropies] });
  }

  filePath = () => `/v1/jobs/${this.job.id}/basins?${query(this.place)}`;

  read([result]) {
    this.basin = result;
    this.attractors = partsOf(result, "attractor");
    this.cell = Object.fromEntries(AXES.map((axis) => [axis, result[axis].data]));
    [this.columns, this.rows, this.map] = ["column", "row", "attractor_of_start"].map((name) => result[name].data);
  }

  showLegend() {
    const [undecided, entropy, boundary] = ["undecided", "basin_entropy", "boundary_entropy"].map((name) => this.basin[name].data);
    const entry = (attractor) => legendEntry(attractorColour(attractor.attractor, theme().dark), h("button", {
      type: "button", className: "link", title: "See the attractor move",
      onclick: () => this.onSelect({ ...this.cell, direction: startName("attractor", attractor.attractor) }),
    }, attractorText(attractor)), " ", h("small", {}, share(attractor.fraction)));
    const others = undecided ? [legendEntry(theme().surface, "undecided ", h("small", {}, share(undecided)))] : [];
    keepFocus(this.legend, () => this.legend.replaceChildren(...this.attractors.map(entry), ...others));
    const texts = [["basin entropy", entropy], ["boundary basin entropy", boundary]].filter(([, value]) => value !== null);
    this.entropies.textContent = texts.map(([name, value]) => `${name} ${number(value, 4)}`).join(", ");
  }

  content() {
    const { plane, complete } = this.basin.attrs;
    const [[across], [along]] = AXES_OF[plane];
    const draw = (ctx, box) => {
      const colours = [rgba32(box.theme.surface), ...this.attractors.map(({ attractor }) => rgba32(attractorColour(attractor, box.theme.dark)))];
      this.drawCells(ctx, box, (cell) => colours[this.map[cell]]);
    };
    return {
      ...this.scales({ label: across }, { label: along }),
      title: this.textOf(this.cell),
      message: complete ? null : "This cell is not computed yet",
      layers: [draw],
    };
  }

  positionOf({ direction }) {
    const start = startOf(direction);
    return start?.kind === this.basin.attrs.plane && [start.phase ?? start.velocity, start.height ?? start.elongation];
  }

  cellOf = ({ column, row }) => ({ ...this.cell, direction: startName(this.basin.attrs.plane, this.rows[row], this.columns[column]) });

  columnsOfTable() {
    const [[, across], [, along]] = AXES_OF[this.basin.attrs.plane];
    const reached = (cell) => {
      const attractor = this.attractors[this.map[this.indexOf(cell)] - 1];
      return attractor ? attractorText(attractor) : "no attractor: undecided";
    };
    return [...this.common(this.cell), axisColumn(across, this.columns, ({ column }) => this.columns[column]), axisColumn(along, this.rows, ({ row }) => this.rows[row]), ["reaches", reached]];
  }
}

/** "(3, 4), flights up to 7.956 rad, λ₁ −0.31 ± 0.02" */
function attractorText({ outcome, label, bounces, periods, longest_flight: longest, lyapunov: exponents, lyapunov_error: error }) {
  const parts = [label.startsWith("(") || label === "rest" ? outcomeText(outcome, bounces, periods) : label];
  if (longest) parts.push(`flights up to ${number(longest, 4)} rad`);
  if (Number.isFinite(exponents?.[0])) parts.push(`λ₁ ${exponentText(exponents[0], error)}`);
  return parts.join(", ");
}
