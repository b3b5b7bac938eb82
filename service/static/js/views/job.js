// One sweep: how far it is, and its diagram, mode map, thresholds and details; a cell of it in motion.

import { go, here, link, note, noted } from "../lib/address.js";
import { askJson, toldElsewhere } from "../lib/api.js";
import { Details } from "./details.js";
import { Diagram } from "./diagram.js";
import { h, say } from "../lib/dom.js";
import { Modes } from "./modes.js";
import { Motion } from "../motion/panel.js";
import { axisValues, directionsOf } from "../lib/physics.js";
import { ProgressBar, UNFINISHED, actions, summary } from "./progress.js";
import { Thresholds } from "./thresholds.js";

const TABS = { diagram: ["Diagram", Diagram], modes: ["Mode map", Modes], thresholds: ["Thresholds", Thresholds], details: ["Details", Details] };
const SOON = 600;
const LATER = 3000;

export class JobView {
  constructor(root, { path }) {
    this.root = root;
    this.id = path[1];
    this.name = h("h1", { tabindex: "-1" }, "…");
    this.about = h("p", { className: "summary" });
    this.bar = new ProgressBar();
    this.actions = h("div", { className: "actions" });
    this.tabs = h("nav", { className: "tabs", "aria-label": "Views of the sweep" });
    this.problem = h("p", { className: "problem", role: "alert", hidden: true });
    this.panel = h("section", { className: "panel" });
    this.aside = h("section", { className: "motion", "aria-label": "A cell in motion", hidden: true });
    root.replaceChildren(
      h("p", { className: "back" }, h("a", { href: link([]) }, "← All sweeps")),
      h("header", { className: "job" }, this.name, this.about, this.bar.element, this.actions),
      this.problem, this.tabs, h("div", { className: "work" }, this.panel, this.aside));
    this.motion = new Motion(this.aside, { closed: () => this.#closeMotion() });
    this.#look(true);
  }

  /** Whether a place is still in this view. */
  takes({ path }) {
    return path[0] === "job" && path[1] === this.id;
  }

  go() {
    if (!this.job) return; // #look shows it when it is there
    this.#showTab();
    this.#showCell();
  }

  refresh(redraw = true) {
    clearTimeout(this.timer);
    this.#look(redraw);
  }

  close() {
    clearTimeout(this.timer);
    this.closed = true;
    this.view?.close();
    this.motion.hide();
  }

  async #look(redraw) {
    let job;
    try {
      job = await askJson(`/v1/jobs/${this.id}`);
    } catch (error) {
      this.#missed(error, redraw);
      return;
    }
    if (this.closed) return;
    const first = !this.job;
    const moved = !first && (job.progress.cells_done !== this.job.progress.cells_done || job.state !== this.job.state);
    if (moved && !UNFINISHED.has(job.state)) say(`The sweep is ${job.state}.`);
    this.job = job;
    this.#describe();
    if (first) this.go();
    else if (moved || redraw) this.view?.update(job);
    if (redraw && !first) this.#showCell(); // it may have been lost on its way
    if (UNFINISHED.has(job.state)) this.#lookIn(this.#pause());
  }

  /** One look at a time is waited for, however many reasons there are for it. */
  #lookIn(pause, redraw = false) {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.#look(redraw), pause);
  }

  /** "refresh" comes when the service is back; what only went wrong for once is asked again. */
  #missed(error, redraw) {
    if (this.closed) return;
    this.#fail(error);
    if (error.status >= 500) this.#lookIn(LATER, redraw);
    if (error.status !== 404 || this.job) return;
    this.name.textContent = "No such sweep";
    document.title = "No such sweep · Bouncing spring";
    this.bar.element.hidden = true;
  }

  /** A long job is looked at more seldom. */
  #pause() {
    return (this.job.progress.eta_seconds ?? 0) > 300 ? LATER : SOON;
  }

  #describe() {
    const { job } = this;
    const name = job.name || `Sweep ${job.id.slice(0, 8)}`;
    this.name.textContent = name;
    document.title = `${name} · Bouncing spring`;
    this.about.replaceChildren(...summary(job));
    this.bar.show(job);
    this.#fail(this.#ended());
    actions(this.actions, job, {
      changed: (now) => {
        this.job = now;
        this.#describe();
        this.#lookIn(SOON / 2);
      },
      deleted: () => go([]),
      fail: (error) => this.#fail(error),
    });
  }

  #showTab() {
    const { path, query } = here();
    const tab = TABS[path[2]] ? path[2] : this.#firstTab();
    const kept = ["gamma", "omega", "xi", "cell"].filter((name) => query[name] !== undefined);
    this.tabs.replaceChildren(...Object.entries(TABS).map(([key, [title]]) =>
      h("a", {
        href: link(["job", this.id, key]), "aria-current": key === tab ? "page" : undefined,
        onclick: (event) => { // where the sliders are now goes along
          const now = noted();
          event.currentTarget.href = link(["job", this.id, key], Object.fromEntries([...kept, "gamma", "omega", "xi", "cell"].map((name) => [name, now[name]])));
        },
      }, title)));
    this.view?.close();
    this.#fail(this.#ended());
    const [, View] = TABS[tab];
    const { spec } = this.job;
    this.view = new View(this.panel, {
      job: this.job,
      grid: Object.fromEntries(["gamma", "omega", "xi"].map((axis) => [axis, axisValues(spec[axis])])),
      directions: directionsOf(spec),
      choose: (cell) => this.#choose(cell),
      chosen: () => this.cell,
    });
  }

  /** Where so few flights are kept that they make no diagram, thresholds are what it is about. */
  #firstTab() {
    const { keep, omega } = this.job.spec;
    return keep < 4 && axisValues(omega).length > 2 ? "thresholds" : "diagram";
  }

  /** The other views open at this cell. */
  #choose({ direction, ...cell }) {
    const [gamma, omega, xi] = ["gamma", "omega", "xi"].map((axis) => Number(cell[axis].toPrecision(10)));
    note({ gamma, omega, xi, cell: [gamma, omega, xi, direction].join(",") });
    this.#showCell();
    // On a phone the motion is below what was touched.
    if (matchMedia("(max-width: 60rem)").matches) this.aside.scrollIntoView({ behavior: "smooth", block: "nearest" });
  }

  #showCell() {
    const asked = (noted().cell ?? "").split(",");
    const [gamma, omega, xi] = asked.map(Number);
    this.cell = asked.length === 4 && [gamma, omega, xi].every(Number.isFinite) ? { gamma, omega, xi, direction: asked[3] } : null;
    if (this.cell) this.motion.show(this.job, this.cell);
    else this.motion.hide();
    this.view.plot?.redraw();
  }

  #closeMotion() {
    note({ cell: null });
    this.#showCell();
    this.panel.querySelector(".plot")?.focus();
  }

  /** Why the sweep failed, if it did. */
  #ended() {
    return this.job.error ? new Error(`The sweep failed: ${this.job.error}`) : null;
  }

  #fail(error) {
    if (error && toldElsewhere(error)) return;
    this.problem.hidden = !error;
    this.problem.textContent = error?.message ?? "";
  }
}
