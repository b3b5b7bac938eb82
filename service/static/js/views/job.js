// One sweep: its progress, a tab each for diagram, mode map, thresholds and details, and a selected cell's trajectory.

import { addressValue, cellIn, cellQuery, currentAddress, currentQuery, link, navigate, setQuery } from "../lib/address.js";
import { requestJson, shared } from "../lib/api.js";
import { announce, delayed, h, problemLine, renew, workButton } from "../lib/dom.js";
import { AXES, isSweep, nearestIndex } from "../lib/physics.js";
import { TrajectoryPanel } from "../motion/panel.js";
import { Basin } from "./basin.js";
import { Cycles } from "./cycles.js";
import { Details } from "./details.js";
import { Diagram } from "./diagram.js";
import { Modes } from "./modes.js";
import { AttractorDiagram, AttractorMap } from "./multistability.js";
import { buildFrame, sourceOf } from "./plot-view.js";
import { ERROR_POLL_MS, IDLE_POLL_MS, JobSummary, POLL_MS, isGoing, settling, titleOf } from "./progress.js";
import { Thresholds } from "./thresholds.js";

const TABS = { __proto__: null, diagram: ["Diagram", Diagram], modes: ["Mode map", Modes], thresholds: ["Thresholds", Thresholds], details: ["Details", Details] };
const STUDY_TABS = { // by the kind of study; others have their details alone
  orbits: { __proto__: null, cycles: ["Branches", Cycles], details: TABS.details },
  basin: { __proto__: null, basin: ["Basins", Basin], details: TABS.details },
  multistability: { __proto__: null, attractors: ["Diagram", AttractorDiagram], map: ["Map", AttractorMap], details: TABS.details },
};
const SHARED = [...AXES, "cell", "min", "hide"]; // query parameters that all tabs understand
const MAPPED_FROM = 8; // values of Γ and of Ω: a sweep of as many opens on its map
const WIDE = matchMedia("(min-width: 100rem)"); // beside the map there is room for a diagram

export class JobView {
  constructor(root, { path }, signal) {
    Object.assign(this, { root, signal, id: path[1] });
    this.heading = h("h1", { tabindex: "-1" }, "…");
    this.problem = problemLine();
    this.summary = new JobSummary(this.heading, { change: (job) => this.#onChange(job), delete: () => signal.aborted || navigate([]), error: this.problem.show });
    this.settling = h("p", { className: "notice settling" });
    this.tabs = h("nav", { className: "tabs", "aria-label": "Views of the sweep" });
    const ask = async () => {
      const name = prompt("Name of the sweep", this.job.name);
      if (name === null) return;
      this.#onChange(await requestJson(`/v1/jobs/${this.id}/rename`, { method: "POST", body: { name } }));
      announce("The sweep is renamed.");
    };
    const rename = workButton("✎", ask, this.problem.show, { className: "quiet", "aria-label": "Rename", title: "Rename", "data-service": true });
    const { progress, actions, about, notice } = this.summary;
    const [bar, line] = [[this.heading, progress, h("div", { className: "actions" }, h("a", { href: link(["new"], { from: this.id }) }, "Duplicate"), rename, actions)], [about, notice, this.settling, this.problem.element]];
    Object.assign(this, buildFrame(root, { bar, line, tabs: this.tabs }));
    this.trajectory = new TrajectoryPanel(this.trajectorySection, signal, () => this.#closeTrajectory());
    addEventListener("keydown", ({ key }) => key === "Escape" && this.cell && this.#closeTrajectory(), { signal });
    this.refresh();
  }

  show() {
    if (!this.job) return; // the first poll shows it
    this.#showTab();
    this.#showSelectedCell();
  }

  /** Again each second or so; without `redraw`, what is drawn stays unless cells were computed. */
  async refresh(redraw = true) {
    this.#pollAfter.cancel();
    const job = await requestJson(`/v1/jobs/${this.id}`, { signal: this.signal }).catch((error) => this.#pollFailed(error, redraw));
    if (!job || this.signal.aborted) return;
    if (!this.panel.isConnected) return location.reload(); // "No such sweep" took its place, and there is one again
    const isFirst = !this.job;
    const hasChanged = !isFirst && (job.progress.cells_done !== this.job.progress.cells_done || job.state !== this.job.state);
    if (!isFirst && job.state !== this.job.state) announce(`The sweep ${job.state === "failed" ? "has" : "is"} ${job.state}.`);
    const isSame = JSON.stringify(job) === JSON.stringify(this.job);
    this.job = Object.assign(this.job ?? {}, job); // the views have it too
    if (!isSame || redraw || this.hasFailed) this.#describe(); // else the problem of an action stays
    this.hasFailed = false;
    if (isFirst) this.show();
    else if (hasChanged || redraw) [this.view, this.beside].forEach((view) => view?.update(this.job));
    if (redraw && !isFirst) this.#showSelectedCell(); // its request may have failed
    if (this.#follows(job)) return;
    if (!shared) this.#pollAfter(isGoing(job) ? POLL_MS : IDLE_POLL_MS);
  }

  /** While a budget goes on, the finest level that is done takes the place of a coarser one. Returns whether it does. */
  #follows({ budget }) {
    const isAnswer = [null, this.id].includes(budget?.answer ?? null) || budget.computing === this.id;
    const follows = !isAnswer && (this.wasAnswer || !budget.over);
    this.wasAnswer = isAnswer;
    if (follows) location.replace(link(["job", budget.answer, ...currentAddress().path.slice(2)], currentQuery()));
    return follows;
  }

  #pollAfter = delayed((redraw = false) => this.refresh(redraw));

  /** An error of the service may be temporary; when the service is unreachable, main.js calls refresh() once it is back. */
  #pollFailed(error, redraw) {
    this.problem.show(error);
    this.hasFailed = true;
    if (error.status >= 500) this.#pollAfter(ERROR_POLL_MS, redraw);
    if (error.status !== 404) return;
    this.#pollAfter(IDLE_POLL_MS); // it may be submitted or imported again
    if (this.job) return location.reload(); // deleted meanwhile: nothing of it stays
    if (!this.panel.isConnected) return;
    document.getElementById("bar").replaceChildren();
    document.title = "No such sweep · Bouncing spring";
    this.root.replaceChildren(h("h1", { tabindex: "-1" }, "No such sweep"), this.problem.element);
  }

  #describe() {
    const { job } = this;
    document.title = `${titleOf(job)} · Bouncing spring`;
    this.summary.show(job);
    renew(this.settling, shared ? shared.note : settling(job));
    this.problem.show(job.error ? new Error(`The sweep failed: ${job.error}`) : null);
  }

  #onChange(job) {
    if (this.signal.aborted) return; // its title would be that of another page
    if (job.id !== this.id) return navigate(["job", job.id]); // of another kernel version: resumed, it starts anew as another
    this.job.name = job.name; // the rest follows when it is polled
    this.#describe();
    this.#pollAfter(0);
  }

  #showTab() {
    const { path, query } = currentAddress();
    const tabs = this.#tabs();
    const current = tabs[path[2]] ? path[2] : Object.keys(tabs)[0];
    if (this.tab === "details" && current !== this.tab) scrollTo(0, 0); // from a link far below
    this.tab = current;
    const target = (tab, parameters) => link(["job", this.id, tab], Object.fromEntries(SHARED.map((name) => [name, parameters[name]])));
    this.tabs.replaceChildren(...Object.entries(tabs).map(([tab, [title]]) =>
      h("a", {
        href: target(tab, query), "aria-current": tab === current ? "page" : undefined,
        onclick: (event) => { event.currentTarget.href = target(tab, currentQuery()); }, // sliders may have moved since
      }, title)));
    this.leaving?.abort();
    this.leaving = new AbortController(); // of this tab
    this.controls.replaceChildren();
    this.#describe(); // the problem of another tab is over
    const [, View] = tabs[current];
    const signal = AbortSignal.any([this.signal, this.leaving.signal]);
    const common = { sources: [sourceOf(this.job)], signal, onSelect: (cell) => this.#select(cell), selected: () => this.cell };
    const isBeside = current === "modes" && WIDE.matches; // the diagram at the Ω under the pointer
    this.secondPanel.hidden = !isBeside;
    this.beside = isBeside ? new Diagram(this.secondPanel, { ...common, isBeside, isFollower: true }) : null;
    const pointBeside = (view, gamma, omega) => {
      if (!this.beside || gamma === undefined) return;
      setQuery({ omega: addressValue(view.rows[nearestIndex(view.rows, omega)]) });
      this.beside.follow(gamma, 0);
    };
    this.view = new View(this.panel, { ...common, bar: this.controls, onPoint: pointBeside });
  }

  #tabs() {
    const { spec } = this.job;
    const { gamma, omega } = sourceOf(this.job).grid;
    const all = isSweep(spec) ? TABS : (STUDY_TABS[spec.protocol.kind] ?? { details: TABS.details });
    const isPlane = gamma?.length > 1 && omega?.length > 1;
    const isLeftOut = { modes: !isPlane, map: !isPlane, thresholds: gamma?.length < 2 || (spec.protocol.axis ?? "gamma") !== "gamma" };
    const first = isSweep(spec) && isPlane && Math.min(gamma.length, omega.length) >= MAPPED_FROM ? { modes: TABS.modes } : {};
    return { __proto__: null, ...Object.fromEntries(Object.entries({ ...first, ...all }).filter(([tab]) => !isLeftOut[tab])) };
  }

  /** The address holds the selected cell, and its axis values for the sliders of the other tabs. */
  #select(cell) {
    if (shared) return; // nothing computes its motion
    setQuery(cellQuery(cell));
    this.#showSelectedCell();
    if (matchMedia("(max-width: 60rem)").matches) this.trajectorySection.scrollIntoView({ behavior: matchMedia("(prefers-reduced-motion: reduce)").matches ? "instant" : "smooth", block: "nearest" }); // below the plot
  }

  #showSelectedCell() {
    this.cell = cellIn(currentQuery());
    if (this.cell) this.trajectory.show(this.job, this.cell);
    else this.trajectory.hide();
    [this.view, this.beside].forEach((view) => view?.plot?.drawCursor());
  }

  #closeTrajectory() {
    setQuery({ cell: null });
    this.#showSelectedCell();
    this.panel.querySelector(".plot")?.focus();
  }
}
