// The mode map: the outcome of every cell of a (Γ, Ω) plane, with the threshold of Eq. 25.

import { addressValue, navigate, setQuery } from "../lib/address.js";
import { isHandledElsewhere, query, requestArrays, requestJson } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { number, ordinal } from "../lib/format.js";
import { HYSTERESIS, OUTCOME, SYMBOL, axisLabel, initialValue, isClose, isLog } from "../lib/physics.js";
import { modeClasses, modeColour, onThemeChange, theme } from "../plot/colours.js";
import { drawRing, hatchSymbol, legendEntry, nearestCell, nextCell, windowOf } from "./cells.js";
import { minFlightInput, minFlightOf, sliders } from "./controls.js";
import { describeMode, drawModes, drawThresholdCurve, modeTable, thresholdLegend } from "./mode-map.js";
import { PlotView } from "./plot-view.js";

const HINT = "Point at a cell to read it, click to show its trajectory, drag to zoom. Modes are (bounces, plate periods).";

/** Cells are {column, row}: indices into the Γ and Ω that were loaded. */
export class Modes extends PlotView {
  name = "modes";
  isThinned = false; // whether the whole map has more cells than are sent

  constructor(root, view) {
    super(view);
    this.xi = initialValue(this.grid.xi, this.initial.xi);
    this.direction = this.directions.includes(this.initial.dir) ? this.initial.dir : this.directions[0];
    this.isAdaptive = Boolean(this.job.spec.refine);
    this.minFlight = this.isAdaptive ? this.job.spec.micro_flight : minFlightOf(this.initial, this.job);
    this.isTwoWay = this.directions.length > 1;
    this.showsHysteresis = h("input", { type: "checkbox", checked: true, onchange: () => this.load() });
    this.showsComputed = h("input", { type: "checkbox", onchange: () => this.plot.draw() });
    this.refineButton = this.job.spec.protocol.kind === "rest" && h("button", {
      type: "button", className: "quiet", onclick: () => this.#refineWindow(),
      title: "Start an adaptive sweep of the visible window, on a grid four times as fine",
    }, "Refine this window");
    this.legend = h("ul", { className: "legend", "aria-label": "Modes: (bounces, plate periods)" });
    this.thinning = h("p", { className: "note", hidden: true });
    this.refined = h("p", { className: "note", role: "status", hidden: true });
    this.build(root, {
      controls: this.#controls(), label: "Mode map", hint: HINT, ratio: 0.6,
      below: h("div", {}, this.thinning, this.refined, this.legend),
    });
    onThemeChange(() => this.plane && this.#showLegend(), this.plot.closing.signal);
  }

  #controls() {
    const onMove = (_, value) => {
      this.xi = value;
      setQuery({ xi: addressValue(value) });
      this.load();
    };
    const onDirection = (event) => {
      this.direction = event.target.value;
      setQuery({ dir: this.direction });
      this.load();
    };
    const onMinFlight = (minFlight) => {
      this.minFlight = minFlight;
      setQuery({ min: minFlight === this.job.spec.micro_flight ? null : minFlight });
      this.load();
    };
    const options = this.directions.map((direction) => h("option", { value: direction, selected: direction === this.direction }, direction));
    return h("div", { className: "controls" }, sliders(["xi"], this.grid, { xi: this.xi }, onMove),
      this.isTwoWay && h("label", { className: "option" }, "Ramp ", h("select", { onchange: onDirection }, options)),
      this.isTwoWay && h("label", { className: "option" }, this.showsHysteresis, " Hatch where up and down differ"),
      !this.isAdaptive && minFlightInput(this.minFlight, onMinFlight),
      this.isAdaptive && h("label", { className: "option" }, this.showsComputed, " Show which cells were computed"),
      this.refineButton);
  }

  /** Start an adaptive sweep of the visible window on a finer grid, and show it. */
  async #refineWindow() {
    const { x0, x1, y0, y1 } = this.visible();
    const ends = (axis, low, high) => (this.grid[axis].length > 1 ? [low, high] : null);
    const body = { gamma: ends("gamma", x0, x1), omega: ends("omega", y0, y1), xi: this.xi, by: this.job.spec.refine?.by ?? "mode" };
    this.refineButton.disabled = true;
    try {
      const job = await requestJson(`/v1/jobs/${this.job.id}/refine`, { method: "POST", body });
      navigate(["job", job.id, "modes"]);
    } catch (error) {
      if (isHandledElsewhere(error)) return;
      this.refined.hidden = false;
      this.refined.textContent = error.message;
    } finally {
      this.refineButton.disabled = false;
    }
  }

  /** The whole map; of a map with more cells than are sent, the zoomed window in more detail. */
  async request(signal) {
    const { x0: left, x1: right, y0: bottom, y1: top } = (this.isThinned && this.window) || {};
    const hysteresis = this.isTwoWay && this.showsHysteresis.checked;
    const parameters = query({ xi: this.xi, direction: this.direction, min_flight: this.minFlight, hysteresis: hysteresis || null, left, right, bottom, top });
    this.plane = await requestArrays(`/v1/jobs/${this.job.id}/plane?${parameters}`, { signal });
    this.axes = this.plane.arrays; // gamma and omega: of the cells that were sent
    this.classes = modeClasses(this.plane.arrays);
    this.#showLegend();
    if (this.window && this.isThinned && left === undefined) return this.request(signal); // the response was thinned
    return { xi: this.plane.xi, direction: this.plane.direction };
  }

  zoom(window) {
    super.zoom(window);
    if (this.isThinned) this.load();
  }

  /** The colours of the modes, and which cells are left out. */
  #showLegend() {
    const total = this.classes.ofCell.length;
    this.legend.replaceChildren(...this.classes.present.map(({ id, name, cells }) =>
      legendEntry(modeColour(id, theme().dark), name, " ", h("small", {}, percentage(cells, total)))));
    const steps = [[this.plane.every_gamma, SYMBOL.gamma], [this.plane.every_omega, SYMBOL.omega]].filter(([every]) => every > 1);
    this.isThinned ||= steps.length > 0;
    const note = this.isAdaptive ? this.#computedText() : this.#hysteresisText();
    this.refined.hidden = !note;
    this.refined.textContent = note;
    this.thinning.hidden = !steps.length;
    this.thinning.textContent = `Shown: every ${steps.map(([every, symbol]) => `${ordinal(every)} ${symbol}`).join(" and every ")}. Zoom in for more detail.`;
  }

  /** How many of the cells shown were computed. */
  #computedText() {
    const { computed, outcome } = this.plane.arrays;
    const done = outcome.reduce((sum, value) => sum + (value !== OUTCOME.missing), 0);
    const cells = computed.reduce((sum, value) => sum + value, 0);
    return `Adaptive map: ${percentage(cells, Math.max(done, 1))} of the cells shown were computed; the others have the mode of their block.`;
  }

  /** In how many of the cells shown up and down differ. */
  #hysteresisText() {
    const { hysteresis } = this.plane.arrays;
    if (!hysteresis) return "";
    const differ = (kind) => hysteresis.reduce((sum, value) => sum + (value === kind), 0);
    const [mode, flights] = [differ(HYSTERESIS.mode), differ(HYSTERESIS.flights)];
    if (!mode && !flights) return "Up and down agree in every cell shown that both have reached.";
    const parts = [[mode, "to other modes (hatched /)"], [flights, "to other flights of one mode (hatched \\)"]].filter(([cells]) => cells);
    return `Hysteresis: going up and down lead ${parts.map(([cells, to]) => `${to} in ${percentage(cells, hysteresis.length)}`).join(", ")} of the cells shown.`;
  }

  whole() {
    return windowOf(this.grid.gamma, this.grid.omega, true);
  }

  content() {
    if (!this.plane) return null;
    const { x0, x1, y0, y1 } = this.visible();
    const { present } = this.classes;
    return {
      x: { label: axisLabel("gamma"), low: x0, high: x1, log: isLog(this.job.spec.gamma) },
      y: { label: axisLabel("omega"), low: y0, high: y1, log: isLog(this.job.spec.omega) },
      title: `ξ = ${number(this.plane.xi)}${this.directions.length > 1 ? `, ramp ${this.plane.direction}` : ""}`,
      legend: [
        ...(this.plane.arrays.hysteresis?.some(Boolean) ? [["up and down differ", hatchSymbol]] : []),
        thresholdLegend,
      ],
      colours: present.map(({ id, name }) => [name, (theme) => modeColour(id, theme.dark)]),
      message: present.length === 1 && present[0].id === OUTCOME.missing ? "No cell is computed yet" : null,
      layers: [
        (ctx, box) => drawModes(ctx, box, this.plane, this.classes, { marksComputed: this.isAdaptive && this.showsComputed.checked }),
        (ctx, box) => drawThresholdCurve(ctx, box, this.plane.xi),
      ],
      cursor: (ctx, box) => this.#drawCursor(ctx, box),
    };
  }

  #drawCursor(ctx, box) {
    const selected = this.selected();
    if (selected && selected.direction === this.plane.direction && isClose(selected.xi, this.plane.xi)) drawRing(ctx, box, selected.gamma, selected.omega, 9);
    if (this.current) drawRing(ctx, box, this.axes.gamma[this.current.column], this.axes.omega[this.current.row], 6);
  }

  nearest(x, y) {
    return this.plane ? nearestCell(this.axes.gamma, this.axes.omega, x, y) : null;
  }

  step(current, right, up) {
    return this.plane ? nextCell(this.axes.gamma, this.axes.omega, current, right, up) : null;
  }

  centre() {
    return this.current ? this.axes.gamma[this.current.column] : undefined;
  }

  cellOf({ column, row }) {
    return { gamma: this.axes.gamma[column], omega: this.axes.omega[row], xi: this.plane.xi, direction: this.plane.direction };
  }

  describe({ column, row }) {
    const { gamma, outcome } = this.plane.arrays;
    const cell = row * gamma.length + column;
    const parts = describeMode(this.plane, { column, row });
    const differs = this.plane.arrays.hysteresis?.[cell];
    if (differs) parts.push(`ramped ${this.directions.find((direction) => direction !== this.plane.direction)}, ${differs === HYSTERESIS.mode ? "another mode" : "other flights"}`);
    if (this.isAdaptive && outcome[cell] !== OUTCOME.missing) parts.push(this.plane.arrays.computed[cell] ? "computed" : "taken from its block");
    return parts.join(" · ");
  }

  /** As `bounce modes` writes it. */
  table() {
    return modeTable(this.plane);
  }
}

const percentage = (cells, total) => `${cells / total < 0.001 ? "<0.1" : number((100 * cells) / total, 2)} %`;
