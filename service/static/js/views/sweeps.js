// The start page: a preview, the presets, and the list of sweeps, the newest first.

import { link } from "../lib/address.js";
import { isHandledElsewhere, query, requestJson } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { ago } from "../lib/format.js";
import { loadPresets } from "../form/catalogue.js";
import { Preview } from "../motion/preview.js";
import { ProgressBar, UNFINISHED, notice, showActions, summary, titleOf } from "./progress.js";

const PAGE_SIZE = 25;
const MAX_LISTED = 1000; // of one request
const POLL_MS = 700; // while a sweep is being computed
const IDLE_POLL_MS = 5000;
const ERROR_MS = 8000; // how long an error is shown

export class Sweeps {
  constructor(root) {
    document.title = "Bouncing spring";
    this.rows = new Map(); // job id → row
    this.limit = PAGE_SIZE;
    this.list = h("ol", { className: "jobs", "aria-label": "Sweeps" });
    this.more = h("button", { type: "button", className: "quiet", hidden: true, onclick: () => { this.limit += PAGE_SIZE; this.refresh(); } }, "Show older sweeps");
    this.problem = h("p", { className: "problem", role: "alert", hidden: true });
    this.presets = h("ul", {});
    this.empty = h("p", { className: "note", hidden: true }, "No sweeps yet. Start with a preset.");
    this.preview = new Preview();
    root.replaceChildren(
      h("div", { className: "start" }, h("section", { className: "intro" },
        h("h1", { tabindex: "-1" }, "A spring bouncing on a vibrating plate"),
        h("p", {}, "Two masses joined by a spring and a dashpot bounce on a plate that vibrates. Their flight times and modes depend on the plate’s acceleration ", h("i", {}, "Γ"), ", its frequency ", h("i", {}, "Ω"), " and the damping ", h("i", {}, "ξ"), ". Compute sweeps of these parameters and explore the results."),
        h("p", {}, h("a", { className: "button", href: link(["new"]) }, "New sweep"))),
      this.preview.element),
      h("section", { className: "presets", "aria-labelledby": "presets" },
        h("h2", { id: "presets" }, "Presets"),
        this.presets),
      h("section", { "aria-labelledby": "sweeps" }, h("h2", { id: "sweeps", tabindex: "-1" }, "Sweeps"), this.problem, this.empty, this.list, this.more));
    this.refresh();
  }

  handles({ path }) {
    return path.length === 0;
  }

  show() {}

  close() {
    this.closed = true;
    this.preview.close();
    clearTimeout(this.timer);
  }

  async refresh() {
    clearTimeout(this.timer);
    this.preview.refresh();
    if (!this.presets.hasChildNodes()) this.#showPresets();
    try {
      const { jobs, next } = await requestJson(`/v1/jobs?${query({ limit: Math.min(this.limit, MAX_LISTED) })}`);
      if (this.closed) return;
      this.#showJobs(jobs);
      this.more.hidden = next === null;
      this.empty.hidden = jobs.length > 0;
      this.#refreshAfter(jobs.some((job) => UNFINISHED.has(job.state)) ? POLL_MS : IDLE_POLL_MS);
    } catch (error) {
      if (this.closed) return;
      this.#showError(error);
      if (error.status >= 500) this.#refreshAfter(IDLE_POLL_MS); // it may be temporary
    }
  }

  #refreshAfter(milliseconds) {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.refresh(), milliseconds);
  }

  async #showPresets() {
    try {
      this.presets.replaceChildren(...(await loadPresets()).map(({ label, title, sweeps: [first] }) =>
        h("li", {}, h("a", { href: link(["new"], { figure: first.key }) }, h("b", {}, label), h("span", {}, title)))));
    } catch (error) {
      this.#showError(error);
    }
  }

  /** Rows are updated in place, which keeps the keyboard focus. */
  #showJobs(jobs) {
    const ids = new Set(jobs.map((job) => job.id));
    for (const [id, row] of this.rows) {
      if (ids.has(id)) continue;
      row.element.remove();
      this.rows.delete(id);
    }
    jobs.forEach((job, index) => {
      if (!this.rows.has(job.id)) this.rows.set(job.id, this.#row());
      const row = this.rows.get(job.id);
      row.update(job);
      if (this.list.children[index] !== row.element) this.list.insertBefore(row.element, this.list.children[index] ?? null);
    });
  }

  #row() {
    const name = h("a", {});
    const about = h("p", { className: "summary" });
    const time = h("span", { className: "note" });
    const bar = new ProgressBar();
    const buttons = h("div", { className: "actions" });
    const other = h("p", { className: "notice", hidden: true });
    const error = h("p", { className: "problem", hidden: true });
    const element = h("li", {}, h("div", { className: "about" }, h("h3", {}, name), about), bar.element, time, buttons, other, error);
    const update = (job) => {
      name.textContent = titleOf(job);
      name.href = link(["job", job.id]);
      if (!about.hasChildNodes() || job.choice) about.replaceChildren(...summary(job));
      time.textContent = ago(job.finished ?? job.created);
      bar.show(job);
      other.hidden = !job.notice;
      other.replaceChildren(...notice(job));
      error.hidden = !job.error;
      error.textContent = job.error ?? "";
      showActions(buttons, job, { onChange: () => this.refresh(), onDelete: () => this.#onDelete(), onError: (failure) => this.#showError(failure) });
    };
    return { element, update };
  }

  #onDelete() {
    this.refresh();
    document.getElementById("sweeps")?.focus(); // the pressed button disappears
  }

  #showError(error) {
    if (isHandledElsewhere(error)) return;
    this.problem.hidden = false;
    this.problem.textContent = error.message;
    setTimeout(() => { this.problem.hidden = true; }, ERROR_MS);
  }
}
