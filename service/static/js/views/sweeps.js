// The list of sweeps, the last first, as they move.

import { link } from "../lib/address.js";
import { askJson, query, toldElsewhere } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { ago } from "../lib/format.js";
import { Glimpse } from "../motion/preview.js";
import { ProgressBar, UNFINISHED, actions, summary } from "./progress.js";
import { presets } from "../form/catalogue.js";

const PAGE = 25;
const SOON = 700; // while something is in work
const LATER = 5000;

export class Sweeps {
  constructor(root) {
    document.title = "Bouncing spring";
    this.rows = new Map();
    this.limit = PAGE;
    this.list = h("ol", { className: "jobs", "aria-label": "Sweeps" });
    this.more = h("button", { type: "button", className: "quiet", hidden: true, onclick: () => { this.limit += PAGE; this.refresh(); } }, "Show older ones");
    this.problem = h("p", { className: "problem", role: "alert", hidden: true });
    this.figures = h("ul", {});
    this.none = h("p", { className: "note", hidden: true }, "None yet. A figure of the paper is a good first one.");
    this.glimpse = new Glimpse();
    root.replaceChildren(
      h("div", { className: "start" }, h("section", { className: "intro" },
        h("h1", { tabindex: "-1" }, "A spring bouncing on a vibrating plate"),
        h("p", {}, "Two masses, a spring and a dashpot on a plate that shakes. How long they fly, and in what rhythm, depends on the plate’s acceleration ", h("i", {}, "Γ"), ", its frequency ", h("i", {}, "Ω"), " and the damping ", h("i", {}, "ξ"), ". Sweep them and look."),
        h("p", { className: "starts" }, h("a", { className: "button", href: link(["new"]) }, "New sweep"))),
      this.glimpse.element),
      h("section", { className: "figures", "aria-labelledby": "figures" },
        h("h2", { id: "figures" }, "From the paper"),
        this.figures),
      h("section", { "aria-labelledby": "sweeps" }, h("h2", { id: "sweeps", tabindex: "-1" }, "Sweeps"), this.problem, this.none, this.list, this.more));
    this.refresh();
  }

  takes({ path }) {
    return path.length === 0;
  }

  go() {}

  close() {
    this.closed = true;
    this.glimpse.close();
    clearTimeout(this.timer);
  }

  async refresh() {
    clearTimeout(this.timer);
    this.glimpse.refresh();
    if (!this.figures.hasChildNodes()) this.#showFigures();
    try {
      const { jobs, next } = await askJson(`/v1/jobs?${query({ limit: Math.min(this.limit, 1000) })}`);
      if (this.closed) return;
      this.#show(jobs);
      this.more.hidden = next === null;
      this.none.hidden = jobs.length > 0;
      const busy = jobs.some((job) => UNFINISHED.has(job.state));
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.refresh(), busy ? SOON : LATER);
    } catch (error) {
      if (this.closed) return;
      this.#fail(error);
      if (!(error.status >= 500)) return;
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.refresh(), LATER); // it may have gone wrong for once
    }
  }

  async #showFigures() {
    try {
      this.figures.replaceChildren(...(await presets()).map(({ label, title, sweeps: [first] }) =>
        h("li", {}, h("a", { href: link(["new"], { figure: first.key }) }, h("b", {}, label), h("span", {}, title)))));
    } catch (error) {
      this.#fail(error);
    }
  }

  /** Rows stay as they are and only change what they say, so that nobody's focus is lost. */
  #show(jobs) {
    const ids = new Set(jobs.map((job) => job.id));
    for (const [id, row] of this.rows) {
      if (ids.has(id)) continue;
      row.element.remove();
      this.rows.delete(id);
    }
    jobs.forEach((job, place) => {
      if (!this.rows.has(job.id)) this.rows.set(job.id, this.#row());
      const row = this.rows.get(job.id);
      row.show(job);
      if (this.list.children[place] !== row.element) this.list.insertBefore(row.element, this.list.children[place] ?? null);
    });
  }

  #row() {
    const name = h("a", {});
    const about = h("p", { className: "summary" });
    const when = h("span", { className: "note" });
    const bar = new ProgressBar();
    const buttons = h("div", { className: "actions" });
    const error = h("p", { className: "problem", hidden: true });
    const element = h("li", {}, h("div", { className: "what" }, h("h3", {}, name), about), bar.element, when, buttons, error);
    const show = (job) => {
      name.textContent = job.name || `Sweep ${job.id.slice(0, 8)}`;
      name.href = link(["job", job.id]);
      if (!about.hasChildNodes() || job.choice) about.replaceChildren(...summary(job));
      when.textContent = ago(job.finished ?? job.created);
      bar.show(job);
      error.hidden = !job.error;
      error.textContent = job.error ?? "";
      actions(buttons, job, { changed: () => this.refresh(), deleted: () => this.#deleted(), fail: (failure) => this.#fail(failure) });
    };
    return { element, show };
  }

  #deleted() {
    this.refresh();
    document.getElementById("sweeps")?.focus(); // the button that was pressed goes
  }

  #fail(error) {
    if (toldElsewhere(error)) return;
    this.problem.hidden = false;
    this.problem.textContent = error.message;
    setTimeout(() => { this.problem.hidden = true; }, 8000);
  }
}
