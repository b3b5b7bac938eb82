// One spring, explored without a sweep: Γ, Ω and ξ by sliders, its contact; thresholds and cycles, motion, return map.

import { currentQuery, link, queryChanges, setQuery } from "../lib/address.js";
import { query } from "../lib/api.js";
import { h, latest } from "../lib/dom.js";
import { number } from "../lib/format.js";
import { AXES, axisLabel, clampIndex, contactQuery, isClose, nearestIndex, threshold } from "../lib/physics.js";
import { disc, verticalLine } from "../plot/drawing.js";
import { MAPPED, Motion, PLAYED } from "../motion/motion.js";
import { branchLegend, branchesPath, drawBranches, readBranches } from "../views/closed-form.js";
import { choice, sliders } from "../views/controls.js";
import { drawThreshold } from "../views/diagram.js";
import { PlotView } from "../views/plot-view.js";

const range = (min, max, step) => Array.from({ length: Math.round((max - min) / step) + 1 }, (_, i) => Number((min + i * step).toFixed(6)));
const GRID = { gamma: range(0.1, 8, 0.01), omega: range(0.1, 2, 0.005), xi: range(0, 1, 0.005) };
const START = { gamma: 2.3, omega: 0.5, xi: 0.26 }; // Fig. 2b
const MAX_GAMMA = GRID.gamma.at(-1);
const MAX_FLIGHT = 6.6 * Math.PI; // rad, of the plot: cycles of up to three plate periods
const SPRING = { job: { name: "spring", spec: { protocol: { kind: "spring" } } }, number: 1, directions: [], grid: GRID };
const HINT = "Cycles of one bounce; dots: the flights of the motion shown. Choose a Γ by pointing.";
const CONTACTS = {
  ideal: { kind: "rigid" },
  rebound: { kind: "rigid", restitution: 0.3 },
  soft: { kind: "soft", restitution: 0.01, penetration: 0.001, adhesive: true },
};
const CONTACT_NAMES = [["ideal", "an ideal plate, in closed form"], ["rebound", "rigid, restitution 0.3"], ["soft", "soft, 0.001 amplitudes deep"]];
const contactName = () => (currentQuery().contact in CONTACTS ? currentQuery().contact : "ideal");
const contactOf = () => CONTACTS[contactName()];

/** The cycles of the spring over Γ. Cells are values of Γ. */
class Cycles extends PlotView {
  name = "cycles";

  constructor(root, motion) {
    super({ sources: [SPRING], onSelect: ({ gamma }) => setQuery({ gamma }) });
    this.motion = motion;
    this.words = h("p", { className: "readout closed", role: "status" });
    const contact = choice("Contact", CONTACT_NAMES, contactName(), (name) => setQuery({ contact: name === "ideal" ? null : name }));
    const controls = h("div", { className: "controls" }, sliders(this, AXES), contact);
    this.build(root, { controls, label: "Flight times of the cycles over Γ", hint: HINT, ratio: 0.62, shown: [this.words] });
    queryChanges.addEventListener("change", () => this.describeThresholds(), { signal: this.closing.signal });
    this.describeThresholds();
  }

  paths() {
    return [this.filePath(), `/v1/threshold?${query({ omega: this.place.omega, xi: this.place.xi, ...contactQuery(contactOf()) })}`];
  }

  filePath() {
    return branchesPath(this.place, MAX_GAMMA, contactOf());
  }

  read([branches, thresholds]) {
    this.branches = readBranches(branches);
    this.thresholds = thresholds;
    this.describeThresholds();
  }

  shown() {
    return { omega: this.thresholds.omega.data, xi: this.thresholds.xi.data };
  }

  /** The thresholds in words: Eq. 25 at once, the rest when the service has answered. */
  describeThresholds() {
    const { gamma, omega, xi } = this.place;
    const lowest = threshold(omega, xi);
    const parts = [`Rest ends at Γ = ${number(lowest, 4)} (Eq. 25): at Γ = ${number(gamma)} a spring at rest ${gamma > lowest ? "takes off" : "stays on the plate"}.`];
    if (this.thresholds && isClose(this.thresholds.omega.data, omega) && isClose(this.thresholds.xi.data, xi)) {
      const [jump, down, cause, reason] = ["jump", "down", "cause", "reason"].map((name) => this.thresholds[name].data);
      if (jump !== null) parts.push(`On the way up, flights leap at Γ = ${number(jump, 4)}.`);
      if (down === null) parts.push(`The lowest Γ that bounces is ${cause}${reason ? `: ${reason}` : ""}.`);
      else parts.push(`Bouncing does not persist below Γ = ${number(down, 4)} (${cause}).`);
    }
    this.words.textContent = parts.join(" ");
  }

  whole() {
    return { x0: 0, x1: MAX_GAMMA, y0: 0, y1: MAX_FLIGHT };
  }

  content() {
    const { gamma, omega, xi } = this.place;
    const { x0, x1, y0, y1 } = this.visible();
    const { trajectory } = this.motion;
    return {
      title: `Ω = ${number(omega)},   ξ = ${number(xi)}`,
      legend: branchLegend(),
      x: { label: axisLabel("gamma"), low: x0, high: x1 },
      y: { label: "flight time φ (rad)", low: y0, high: y1, periods: true },
      layers: [
        (ctx, box) => drawThreshold(ctx, box, { omega, xi }),
        (ctx, box) => drawBranches(ctx, box, this.branches),
        (ctx, box) => {
          verticalLine(ctx, box, box.x.pixel(gamma), box.theme.cursor);
          if (trajectory?.gamma === gamma) for (const time of new Set(trajectory.flights)) disc(ctx, box.theme.rest, box.x.pixel(gamma), box.y.pixel(time), 3);
        },
      ],
    };
  }

  nearest(x) {
    return GRID.gamma[nearestIndex(GRID.gamma, x)];
  }

  step(current, right) {
    return GRID.gamma[clampIndex(nearestIndex(GRID.gamma, current ?? this.place.gamma) + right, GRID.gamma.length)];
  }

  at(gamma) {
    return [gamma];
  }

  describe(gamma) {
    return `Γ = ${number(gamma)}`;
  }

  cellOf(gamma) {
    return { gamma };
  }
}

export class Explore {
  constructor(root) {
    document.title = "Explore · Bouncing spring";
    setQuery({ ...START, ...currentQuery() });
    this.sweep = h("a", {}, "New sweep around this spring");
    const [diagram, portraits] = [h("section", { className: "panel", "aria-label": "Cycles" }), h("section", { "aria-label": "Return map and phase portrait" })];
    this.motion = new Motion({ portraits });
    root.replaceChildren(
      h("h1", { tabindex: "-1" }, "Explore a spring"),
      h("div", { className: "explored" }, diagram, h("section", { "aria-label": "Motion" }, this.motion.element, h("p", {}, this.sweep))), portraits);
    this.view = new Cycles(diagram, this.motion);
    this.load = latest(() => this.#load()); // not aborted: the service computes it anyway
    queryChanges.addEventListener("change", () => this.load(), { signal: this.view.closing.signal });
    this.load();
  }

  show() {
    queryChanges.dispatchEvent(new Event("change"));
  }

  refresh() {
    this.view.load();
    this.load();
  }

  close() {
    this.view.close();
    this.motion.close();
  }

  async #load() {
    const { place } = this.view;
    const request = (length) => ["/v1/trajectories", { method: "POST", body: { ...place, model: contactOf(), ...length } }];
    this.sweep.href = link(["new"], place);
    const shown = () => JSON.stringify([this.view.place, contactName()]);
    const asked = shown();
    if (asked === this.loaded || !(await this.motion.load(...request(PLAYED)))) return;
    this.loaded = asked;
    this.view.plot.redraw();
    if (this.loaded === shown()) await this.motion.loadMap(...request(MAPPED)); // else moved on meanwhile
  }
}
