// One spring, explored without a sweep: Γ, Ω and ξ, its contact; cycles and their events, thresholds, motion, return map.

import { cellIn, cellQuery, currentQuery, link, queryChanges, setQuery } from "../lib/address.js";
import { query } from "../lib/api.js";
import { choice, h, latest } from "../lib/dom.js";
import { number, plural } from "../lib/format.js";
import { AXES, EXPLORED, SYMBOL, clamp, contactQuery, inSymbols, isClose, startOf, threshold } from "../lib/physics.js";
import { disc, verticalLine } from "../plot/drawing.js";
import { TrajectoryPanel } from "../motion/panel.js";
import { branchesPath } from "../views/closed-form.js";
import { queryNumber, numberInput, sliders } from "../views/controls.js";
import { Cycles } from "../views/cycles.js";
import { buildFrame } from "../views/plot-view.js";

const range = (min, max, step) => Array.from({ length: Math.round((max - min) / step) + 1 }, (_, i) => Number((min + i * step).toFixed(6)));
const GRID = Object.fromEntries(AXES.map((axis) => [axis, range(...EXPLORED[axis])]));
const START = { gamma: 2.3, omega: 0.5, xi: 0.26 }; // Fig. 2b
const LONGEST = 6; // plate periods of a cycle
const SPRING = { job: { name: "spring", spec: { protocol: { kind: "spring" } } }, number: 1, directions: [], grid: GRID };
const HINT = "Dots: the flights of the motion shown. Point at a branch to read it, press to start on it.";
const CONTACTS = [["ideal", "ideal plate"], "rigid", "soft"];
/** The parameters of each contact that can be typed, with their defaults. */
const TYPED = { ideal: {}, rigid: { restitution: 0.3 }, soft: { restitution: 0.01, penetration: 0.001 } };
const LABELS = { restitution: "e", penetration: "depth" };
const LIMITS = { restitution: { max: 0.999 }, penetration: { min: 1e-12, max: 1 } }; // of contacts that have branches
const contactName = () => ["rigid", "soft"].find((name) => name === currentQuery().contact) ?? "ideal";
const longest = () => clamp(Math.round(queryNumber("periods", 3)), 1, LONGEST);

function contactOf() {
  const name = contactName();
  const typed = Object.entries(TYPED[name]).map(([field, usual]) => [field, queryNumber(field, usual, LIMITS[field])]);
  return { kind: name === "soft" ? name : "rigid", ...Object.fromEntries(typed), ...(name === "soft" && { adhesive: true }) };
}

/** The cycles of the spring, and the flights of the motion shown. */
export class Explore extends Cycles {
  get isContinuous() { return true; } // read before fields have values

  constructor(root, address, signal) {
    document.title = "Explore · Bouncing spring";
    setQuery({ ...START, ...currentQuery() });
    const sweep = h("a", {}, "New sweep around this spring");
    const words = h("p", { className: "summary closed", role: "status" }); // on the thresholds
    const frame = buildFrame(root, { bar: [h("h1", { tabindex: "-1" }, "Explore a spring"), sweep], line: [words] });
    super(frame.panel, { sources: [SPRING], signal, bar: frame.controls, onSelect: (cell) => setQuery(cellQuery(cell)) }, HINT);
    Object.assign(this, { sweep, words, motion: new TrajectoryPanel(frame.trajectorySection, signal) });
    this.move = latest(async () => { // not aborted: the service computes it anyway
      await this.motion.show({ ...SPRING.job, spec: { model: contactOf() } }, { ...this.place, direction: this.direction });
      this.plot.redraw();
    });
    queryChanges.addEventListener("change", () => this.#follow(), { signal });
    this.#follow();
  }

  controls() {
    const typed = h("span", { className: "controls" });
    const changeContact = (name) => {
      setQuery({ contact: name === "ideal" ? null : name, restitution: null, penetration: null });
      this.showChoices();
    };
    const contact = choice("Contact", CONTACTS, "", changeContact);
    const modes = range(1, LONGEST, 1).map((periods) => [periods, plural(periods, "period")]);
    const cycles = choice("Cycles up to", modes, "", (periods) => setQuery({ periods }));
    this.showChoices = () => {
      [contact.control.value, cycles.control.value] = [contactName(), longest()];
      typed.replaceChildren(...Object.entries(TYPED[contactName()]).map(([field, usual]) => numberInput(LABELS[field], field, usual, LIMITS[field])));
    };
    this.showChoices();
    return [sliders(this, AXES), contact, typed, cycles];
  }

  /** As typed, not only the values of the sliders. */
  get place() {
    return Object.fromEntries(AXES.map((axis) => [axis, clamp(queryNumber(axis, START[axis]), GRID[axis][0], GRID[axis].at(-1))]));
  }

  /** The start: the cycle that the address names, if it is one of this spring. */
  get direction() {
    const cell = cellIn(currentQuery());
    return cell && startOf(cell.direction) && AXES.every((axis) => isClose(cell[axis], this.place[axis])) ? cell.direction : "rest";
  }

  paths() {
    return [this.filePath(), `/v1/threshold?${query({ omega: this.place.omega, xi: this.place.xi, ...contactQuery(contactOf()) })}`];
  }

  filePath() {
    return branchesPath(this.place, GRID.gamma.at(-1), contactOf(), longest());
  }

  read([branches, thresholds]) {
    super.read([branches]);
    Object.assign(this, { thresholds, restEnds: thresholds.threshold.data, described: this.requested });
    this.describeThresholds();
  }

  /** The thresholds in words: Eq. 25 of an ideal plate at once, the rest when the service has answered. */
  describeThresholds() {
    const { gamma, omega, xi } = this.place;
    const isAnswered = this.described === this.paths().join();
    const isOwn = "model" in contactQuery(contactOf());
    const lowest = isOwn ? isAnswered && this.restEnds : threshold(omega, xi);
    const asked = currentQuery();
    const sentences = Object.entries({ ...this.place, ...contactOf(), periods: longest() }).filter(([name, value]) => name in asked && Number(asked[name]) !== value)
      .map(([name, value]) => `${SYMBOL[name] ?? name} = ${asked[name]} is outside the limits; ${number(value)} is shown.`);
    const fate = `at Γ = ${number(gamma)} a spring at rest ${gamma > lowest ? "takes off" : "stays on the plate"}`;
    if (lowest) sentences.push(`Rest ends at Γ = ${number(lowest, 4)} (${isOwn ? "of this contact" : "Eq. 25"}): ${fate}.`);
    if (isAnswered) {
      const [jump, down, cause, reason] = ["jump", "down", "cause", "reason"].map((name) => this.thresholds[name].data);
      if (jump !== null) sentences.push(`On the way up, flights leap at Γ = ${number(jump, 4)}.`);
      sentences.push(`${down === null ? `The lowest Γ that bounces is ${cause}` : `Bouncing does not persist below Γ = ${number(down, 4)} (${cause})`}${reason ? `: ${reason}` : ""}.`);
    } else if (isOwn) sentences.push("Workers follow the cycles of this contact; the first ones compile its kernel.");
    this.words.textContent = inSymbols(sentences.join(" "));
  }

  content() {
    const [content, { gamma }, { trajectory }] = [super.content(), this.place, this.motion];
    const flights = (ctx, box) => {
      verticalLine(ctx, box, box.x.pixel(gamma), box.theme.cursor);
      const isOfPlot = trajectory && isClose(trajectory.gamma, gamma) && this.described.startsWith(`${branchesPath(trajectory, GRID.gamma.at(-1), trajectory.contact, longest())},`);
      for (const time of isOfPlot ? new Set(trajectory.flights) : []) disc(ctx, box.theme.rest, box.x.pixel(gamma), box.y.pixel(time), 3);
    };
    return { ...content, layers: [...content.layers, flights] };
  }

  cellOf(cell) {
    return super.cellOf(cell) ?? { ...this.place, gamma: cell.gamma, direction: "rest" };
  }

  show() {
    this.showChoices();
    setQuery({});
  }

  refresh() {
    this.load();
    this.#follow();
  }

  #follow() {
    this.sweep.href = link(["new"], { ...this.place, gamma: null, ...contactQuery(contactOf()) });
    this.describeThresholds();
    this.plot.redraw(); // its Γ
    this.move();
  }
}
