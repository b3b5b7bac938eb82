// One spring, explored without a sweep: Γ, Ω and ξ by sliders; thresholds and cycles in closed form, motion, return map.

import { currentQuery, link, setQuery } from "../lib/address.js";
import { isHandledElsewhere, query, requestDataset } from "../lib/api.js";
import { h, latest } from "../lib/dom.js";
import { number } from "../lib/format.js";
import { SYMBOL, axisLabel, isClose, meaningOf, threshold } from "../lib/physics.js";
import { disc, verticalLine } from "../plot/drawing.js";
import { listenToInput } from "../plot/input.js";
import { Plot } from "../plot/plot.js";
import { Player } from "../motion/player.js";
import { Portraits } from "../motion/portraits.js";
import { ComputingNote, MAP_PERIODS, MAP_SAMPLES, PERIODS, SAMPLES, describe, requestTrajectory } from "../motion/trajectory.js";
import { branchLegend, branchesPath, drawBranches, readBranches } from "../views/closed-form.js";
import { drawThreshold } from "../views/diagram.js";

const RANGES = { gamma: { min: 0.1, max: 8, step: 0.01 }, omega: { min: 0.1, max: 2, step: 0.005 }, xi: { min: 0, max: 1, step: 0.005 } };
const START = { gamma: 2.3, omega: 0.5, xi: 0.26 }; // Fig. 2b
const MODEL = { kind: "rigid" };
const MAX_FLIGHT = 6.6 * Math.PI; // rad, of the plot: cycles of up to three plate periods

export class Explore {
  branches = null;
  flights = []; // of the motion shown

  constructor(root) {
    document.title = "Explore · Bouncing spring";
    this.values = this.#valuesOf(currentQuery());
    this.sliders = Object.fromEntries(Object.keys(RANGES).map((axis) => [axis, this.#slider(axis)]));
    this.words = h("p", { className: "readout closed", role: "status" });
    this.readout = h("p", { className: "readout" });
    this.problem = h("p", { className: "problem", role: "alert", hidden: true });
    this.computing = new ComputingNote();
    this.sweep = h("a", {}, "New sweep around this spring");
    const diagram = h("figure", {});
    const portraits = h("section", { "aria-label": "Return map and phase portrait" });
    const motion = h("section", { "aria-label": "Motion" });
    root.replaceChildren(
      h("h1", { tabindex: "-1" }, "Explore a spring"),
      h("div", { className: "sliders explore" }, Object.values(this.sliders).map(({ element }) => element)),
      this.words, this.problem,
      h("div", { className: "explored" },
        h("section", { "aria-label": "Cycles in closed form" }, diagram, h("p", { className: "note" }, "Cycles of one bounce on an ideal plate, in closed form; dots: the flights of the motion shown. Choose a Γ by pointing."), h("p", {}, this.sweep)),
        motion), portraits);
    this.plot = new Plot(diagram, { label: "Flight times of the cycles over Γ. Left and right arrow keys change Γ.", content: () => this.#content(), ratio: 0.62 });
    listenToInput(this.plot, {
      hover: () => {}, leave: () => {}, selectCurrent: () => {}, zoom: () => {}, magnify: () => {},
      select: (x) => this.#set("gamma", x),
      step: (right) => this.#set("gamma", this.values.gamma + right * RANGES.gamma.step),
    });
    this.player = new Player(motion);
    motion.append(this.computing.element, this.readout);
    this.portraits = new Portraits(portraits);
    this.loadClosedForm = latest((signal) => this.#loadClosedForm(signal));
    this.loadMotion = latest(() => this.#loadMotion()); // not aborted: the service would compute it nevertheless
    this.#changed(["omega"]);
  }

  handles({ path }) {
    return path[0] === "explore";
  }

  show() {
    const values = this.#valuesOf(currentQuery());
    for (const axis of Object.keys(RANGES)) if (values[axis] !== this.values[axis]) this.#set(axis, values[axis]);
  }

  refresh() {
    this.#changed(["omega"]);
  }

  close() {
    this.closed = true;
    this.computing.hide();
    this.plot.close();
    this.player.close();
    this.portraits.close();
  }

  #valuesOf(parameters) {
    const value = (axis) => {
      const given = Number(parameters[axis] || NaN);
      return Number.isFinite(given) ? limited(axis, given) : START[axis];
    };
    return Object.fromEntries(Object.keys(RANGES).map((axis) => [axis, value(axis)]));
  }

  #slider(axis) {
    const id = `explore-${axis}`;
    const output = h("output", { for: id });
    const input = h("input", { id, type: "range", ...RANGES[axis], title: meaningOf(axis), oninput: () => this.#set(axis, input.valueAsNumber) });
    const show = () => {
      const text = number(this.values[axis]);
      input.value = String(this.values[axis]);
      output.textContent = text;
      input.setAttribute("aria-valuetext", `${SYMBOL[axis]} = ${text}`);
    };
    show();
    return { show, element: h("div", { className: "slider" }, h("label", { for: id }, h("i", {}, SYMBOL[axis]), " ="), output, input) };
  }

  #set(axis, value) {
    this.values[axis] = limited(axis, value);
    this.sliders[axis].show();
    setQuery({ [axis]: this.values[axis] });
    this.#changed([axis]);
  }

  /** Eq. 25 is computed here, at once; the rest comes from the service. */
  #changed(axes) {
    if (axes.some((axis) => axis !== "gamma")) {
      this.closedForm = null;
      this.loadClosedForm();
    }
    this.sweep.href = link(["new"], this.values);
    this.#describe();
    this.plot.redraw();
    this.loadMotion();
  }

  async #loadClosedForm(signal) {
    const { omega, xi } = this.values;
    try {
      const [branches, thresholds] = await Promise.all([
        requestDataset(branchesPath({ omega, xi }, RANGES.gamma.max), { signal }),
        requestDataset(`/v1/threshold?${query({ omega, xi })}`, { signal }),
      ]);
      if (this.closed) return;
      this.#showError(null);
      this.branches = readBranches(branches);
      if (isClose(omega, this.values.omega) && isClose(xi, this.values.xi)) this.closedForm = thresholds;
      this.#describe();
      this.plot.draw();
      this.plot.element.dataset.shown = JSON.stringify({ omega, xi });
    } catch (error) {
      this.#showError(error);
    }
  }

  async #loadMotion() {
    const { gamma, omega, xi } = this.values;
    if (!this.player.heights) this.computing.show();
    try {
      const body = { gamma, omega, xi, model: MODEL };
      const trajectory = await requestTrajectory("/v1/trajectories", { method: "POST", body: { ...body, periods: PERIODS, samples: SAMPLES } });
      if (this.closed) return;
      this.player.show(trajectory);
      this.flights = trajectory.flights;
      this.shownGamma = gamma;
      this.readout.textContent = describe(trajectory);
      this.portraits.show({ trajectory });
      this.plot.redraw();
      if (gamma !== this.values.gamma || omega !== this.values.omega || xi !== this.values.xi) return; // moved on meanwhile
      const long = await requestTrajectory("/v1/trajectories", { method: "POST", body: { ...body, periods: MAP_PERIODS, samples: MAP_SAMPLES } });
      if (!this.closed) this.portraits.show({ flights: long.flights });
    } catch (error) {
      this.#showError(error);
    } finally {
      this.computing.hide();
    }
  }

  /** The thresholds in words. */
  #describe() {
    const { gamma, omega, xi } = this.values;
    const lowest = threshold(omega, xi);
    const parts = [`Rest ends at Γ = ${number(lowest, 4)} (Eq. 25): at Γ = ${number(gamma)} a spring at rest ${gamma > lowest ? "takes off" : "stays on the plate"}.`];
    if (this.closedForm) {
      const [jump, down, cause, reason] = ["jump", "down", "cause", "reason"].map((name) => this.closedForm[name].data);
      if (jump !== null) parts.push(`On the way up, flights leap at Γ = ${number(jump, 4)}.`);
      if (down === null) parts.push(`The lowest Γ that bounces is ${cause}${reason ? `: ${reason}` : ""}.`);
      else parts.push(`Nothing bounces for ever below Γ = ${number(down, 4)} (${cause}).`);
    }
    this.words.textContent = parts.join(" ");
  }

  #content() {
    const { gamma, omega, xi } = this.values;
    return {
      title: `Ω = ${number(omega)},   ξ = ${number(xi)}`,
      legend: branchLegend(),
      x: { label: axisLabel("gamma"), low: 0, high: RANGES.gamma.max },
      y: { label: "flight time φ (rad)", low: 0, high: MAX_FLIGHT, periods: true },
      layers: [
        (ctx, box) => drawThreshold(ctx, box, { omega, xi }),
        (ctx, box) => this.branches && drawBranches(ctx, box, this.branches),
        (ctx, box) => {
          verticalLine(ctx, box, box.x.pixel(gamma), box.theme.cursor);
          if (this.shownGamma === gamma) for (const time of new Set(this.flights)) disc(ctx, box.theme.single, box.x.pixel(gamma), box.y.pixel(time), 3);
        },
      ],
    };
  }

  #showError(error) {
    if (this.closed || (error && isHandledElsewhere(error))) return;
    this.problem.hidden = !error;
    this.problem.textContent = error?.message ?? "";
  }
}

/** A value within the range of its slider. */
function limited(axis, value) {
  const { min, max, step } = RANGES[axis];
  return Number(Math.min(Math.max(Math.round(value / step) * step, min), max).toFixed(6));
}
