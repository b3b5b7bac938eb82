// One spring, explored without a sweep: Γ, Ω and ξ, its contact; cycles and their events, thresholds, motion, return map.

import { cellQuery, currentQuery, link, queryChanges, setQuery } from "../lib/address.js";
import { query } from "../lib/api.js";
import { h, latest } from "../lib/dom.js";
import { number } from "../lib/format.js";
import { AXES, axisLabel, contactQuery, isClose, startName, startOf, threshold } from "../lib/physics.js";
import { PagedTable } from "../lib/table.js";
import { disc, verticalLine } from "../plot/drawing.js";
import { MAPPED, Motion, PLAYED } from "../motion/motion.js";
import { branchLegend, branchesPath, cyclesAt, describeCycle, drawBranches, drawCycle, eventName, nearestCycle, readBranches } from "../views/closed-form.js";
import { choice, numberInput, sliders } from "../views/controls.js";
import { drawThreshold } from "../views/diagram.js";
import { buildFrame, clearBar } from "../views/frame.js";
import { PlotView } from "../views/plot-view.js";

const range = (min, max, step) => Array.from({ length: Math.round((max - min) / step) + 1 }, (_, i) => Number((min + i * step).toFixed(6)));
const STEP = 0.01; // of Γ, by an arrow key
const GRID = { gamma: range(0.1, 8, STEP), omega: range(0.1, 2, 0.005), xi: range(0, 1, 0.005) };
const START = { gamma: 2.3, omega: 0.5, xi: 0.26 }; // Fig. 2b
const MAX_GAMMA = GRID.gamma.at(-1);
const LONGEST = 6; // plate periods of a cycle
const SPRING = { job: { name: "spring", spec: { protocol: { kind: "spring" } } }, number: 1, directions: [], grid: GRID };
const HINT = "Cycles of one bounce; dots: the flights of the motion shown. Point at a branch to read it, press to start on it.";
const CONTACTS = [["ideal", "ideal, closed form"], ["rigid", "rigid"], ["soft", "soft"]];
const RESTITUTION = { ideal: 0, rigid: 0.3, soft: 0.01 };

const contactName = () => CONTACTS.find(([name]) => name === currentQuery().contact)?.[0] ?? "ideal";
const given = (name, otherwise) => { const value = Number(currentQuery()[name] || NaN); return Number.isFinite(value) ? value : otherwise; };
const longest = () => Math.min(Math.max(Math.round(given("periods", 3)), 1), LONGEST);

/** The contact that the address names. */
function contactOf() {
  const name = contactName();
  const restitution = given("restitution", RESTITUTION[name]);
  return { ideal: { kind: "rigid" }, rigid: { kind: "rigid", restitution }, soft: { kind: "soft", restitution, penetration: given("penetration", 0.001), adhesive: true } }[name];
}

/** The cycles of the spring over Γ. Cells are {gamma}, and on a branch {gamma, branch, point}. */
class Cycles extends PlotView {
  name = "cycles";
  isContinuous = true;
  isDrawn = false;

  constructor(root, bar, words, motion) {
    super({ sources: [SPRING], bar, onSelect: (cell) => setQuery(cellQuery(cell)) });
    Object.assign(this, { motion, words });
    const typed = h("span", { className: "controls" });
    const showTyped = () => typed.replaceChildren(...(contactName() === "ideal" ? [] : [numberInput("e", "restitution", RESTITUTION[contactName()])]), ...(contactName() === "soft" ? [numberInput("depth", "penetration", 0.001)] : []));
    const contact = choice("Contact", CONTACTS, contactName(), (name) => { setQuery({ contact: name === "ideal" ? null : name, restitution: null, penetration: null }); showTyped(); });
    const cycles = choice("Cycles up to", range(1, LONGEST, 1).map((periods) => [periods, `(1, ${periods})`]), longest(), (periods) => setQuery({ periods }));
    showTyped();
    this.events = new PagedTable("Folds, flips and grazes", () => this.#eventRows(), () => "events.csv", true);
    this.build(root, { controls: h("div", { className: "controls" }, sliders(this, AXES), contact, typed, cycles), label: "Flight times of the cycles over Γ", hint: HINT, tables: [this.events.element] });
    queryChanges.addEventListener("change", () => this.describeThresholds(), { signal: this.closing.signal });
    this.describeThresholds();
  }

  /** As typed, not only the values of the sliders. */
  get place() {
    return Object.fromEntries(AXES.map((axis) => [axis, Math.min(Math.max(given(axis, START[axis]), GRID[axis][0]), GRID[axis].at(-1))]));
  }

  /** The cycle to start on, if the address names one of this spring. */
  get start() {
    const [gamma, omega, xi, name = ""] = (currentQuery().cell ?? "").split(",");
    const { place } = this;
    return isClose(Number(gamma), place.gamma) && isClose(Number(omega), place.omega) && isClose(Number(xi), place.xi) ? startOf(name) : null;
  }

  paths() {
    return [this.filePath(), `/v1/threshold?${query({ omega: this.place.omega, xi: this.place.xi, ...contactQuery(contactOf()) })}`];
  }

  filePath() {
    return branchesPath(this.place, MAX_GAMMA, contactOf(), longest());
  }

  read([branches, thresholds]) {
    Object.assign(this, { branches: readBranches(branches), thresholds });
    this.describeThresholds();
    this.events.update();
  }

  #eventRows() {
    const events = (this.branches?.events ?? []).filter(({ violations }) => violations === 0).sort((a, b) => a.gamma - b.gamma);
    const row = ({ kind, bounces, periods, gamma, flight_time: time }) => [eventName(kind), `(${bounces}, ${periods})`, number(gamma, 7), number(time, 6)];
    return { titles: ["event", "cycle", "Γ", "φ (rad)"], length: events.length, row: (i) => row(events[i]) };
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
    return { x0: 0, x1: MAX_GAMMA, y0: 0, y1: 2.2 * Math.PI * longest() };
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
          if (trajectory && isClose(trajectory.gamma, gamma)) for (const time of new Set(trajectory.flights)) disc(ctx, box.theme.rest, box.x.pixel(gamma), box.y.pixel(time), 3);
        },
      ],
      cursor: (ctx, box) => {
        if (this.current?.branch) drawCycle(ctx, box, this.current);
        else if (this.current) verticalLine(ctx, box, box.x.pixel(this.current.gamma), box.theme.muted, 1, [2, 3]);
      },
    };
  }

  nearest(x, y) {
    const cycle = this.plot.box && nearestCycle(this.branches, this.plot.box, x, y);
    return cycle ? { ...cycle, gamma: cycle.branch.gamma[cycle.point] } : { gamma: Number(x.toPrecision(4)) };
  }

  cellsShown() {
    return this.branches.branches.flatMap((branch) => Array.from(branch.gamma, (gamma, point) => ({ gamma, branch, point }))).filter(({ gamma, branch, point }) => !branch.violations[point] && this.isVisible(gamma, branch.flight_time[point]));
  }

  columnsOfTable() {
    return [["Γ", ({ gamma }) => number(gamma)], ["cycle", ({ branch }) => `(${branch.bounces}, ${branch.periods})`],
      ["φ (rad)", ({ branch, point }) => number(branch.flight_time[point])], ["stability", ({ branch, point }) => (branch.stable[point] ? "stable" : "unstable")]];
  }

  /** Up and down go through the cycles at this Γ; to the sides, the nearest cycle follows. */
  step(current, right, up) {
    const gamma = Math.min(Math.max((current ?? this.place).gamma + STEP * right, GRID.gamma[0]), MAX_GAMMA);
    const cycles = cyclesAt(this.branches, gamma);
    const time = current?.branch?.flight_time[current.point] ?? 0;
    const away = ({ branch, point }) => Math.abs(branch.flight_time[point] - time);
    const at = cycles.indexOf(cycles.toSorted((a, b) => away(a) - away(b))[0]);
    return { gamma, ...(current?.branch || up ? cycles[Math.min(Math.max(at + (current?.branch ? Math.sign(up) : 0), 0), cycles.length - 1)] : null) };
  }

  at({ gamma, branch, point }) {
    return [gamma, branch?.flight_time[point]];
  }

  describe(cell) {
    return cell.branch ? `${describeCycle(cell)} · press to start on it` : `Γ = ${number(cell.gamma)}`;
  }

  cellOf({ gamma, branch, point }) {
    return { ...this.place, gamma: branch ? branch.gamma[point] : gamma, direction: branch ? startName("cycle", branch.periods, branch.flight_time[point]) : "rest" };
  }
}

export class Explore {
  constructor(root) {
    document.title = "Explore · Bouncing spring";
    setQuery({ ...START, ...currentQuery() });
    this.sweep = h("a", {}, "New sweep around this spring");
    const words = h("p", { className: "summary closed", role: "status" });
    this.motion = new Motion();
    const { controls, panel, aside } = buildFrame(root, { bar: [h("h1", { tabindex: "-1" }, "Explore a spring"), this.sweep], line: [words] });
    this.about = h("p", { className: "note" });
    aside.hidden = false;
    aside.replaceChildren(h("div", { className: "facts" }, h("h2", {}, "Motion"), this.about), this.motion.element, this.motion.portraits.element);
    root.classList.add("explored");
    this.view = new Cycles(panel, controls, words, this.motion);
    this.load = latest(() => this.#load()); // not aborted: the service computes it anyway
    queryChanges.addEventListener("change", () => this.load(), { signal: this.view.closing.signal });
    this.root = root;
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
    this.root.classList.remove("explored");
    clearBar();
    this.view.close();
    this.motion.close();
  }

  async #load() {
    const { place, start } = this.view;
    const request = (length) => ["/v1/trajectories?", { method: "POST", body: { ...place, model: contactOf(), ...(start && { start }), ...length } }];
    this.sweep.href = link(["new"], { omega: place.omega, xi: place.xi });
    this.about.textContent = start ? `On the cycle (1, ${start.periods})` : "From rest, after its transient";
    const shown = () => JSON.stringify([this.view.place, this.view.start, contactOf()]);
    const asked = shown();
    if (asked === this.loaded || !(await this.motion.load(...request(PLAYED)))) return;
    this.loaded = asked;
    this.view.plot.redraw();
    if (this.loaded === shown()) await this.motion.loadMap(...request(MAPPED)); // else moved on meanwhile
  }
}
