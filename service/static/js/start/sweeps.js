// The start page, a list of sweeps: found by name, state and model, in pages; several of them compared or deleted.

import { currentQuery, link, navigate, setQuery } from "../lib/address.js";
import { deleteJob, query, requestJson } from "../lib/api.js";
import { announce, button, checkBox, choice, debounced, delayed, h, problemLine, renew, workButton } from "../lib/dom.js";
import { ago, count, plural } from "../lib/format.js";
import { IDLE_POLL_MS, JobSummary, MOST_COMPARED, POLL_MS, UNFINISHED, titleOf } from "../views/progress.js";

const PAGE_SIZE = 25;
const MAX_PINNED = 100; // shown above the first page too
const ERROR_MS = 8000; // how long an error is shown
const TYPING_MS = 250;
const MAX_NAMED = 5; // sweeps named in a confirmation
const STATES = [["", "any state"], "queued", "running", "done", "failed", "cancelled"];
const MODELS = [["", "any contact"], "rigid", "soft", "stepped", "ball", "auto"];
const ORDERS = [["", "newest first"], ["oldest", "oldest first"], ["finished", "last finished first"], ["name", "by name"], ["largest", "largest first"]];

export class SweepList {
  rows = new Map(); // job id → row
  selected = new Set(); // ids, in the order in which they were selected
  jobs = []; // of this page

  constructor(root, address, signal) {
    this.signal = signal;
    document.title = "Bouncing spring";
    const find = () => {
      setQuery({ ...Object.fromEntries(Array.from(new FormData(this.filters), ([name, value]) => [name, value || null])), pages: null });
      this.refresh();
    };
    const select = (name, title, options) => choice(title, options, "", find, { name });
    const search = h("input", { type: "search", name: "search", size: 24, maxlength: 200, placeholder: "name or id", oninput: debounced(TYPING_MS, () => signal.aborted || find()) });
    this.filters = h("form", { className: "controls", role: "search", "aria-label": "Find sweeps", onsubmit: (event) => { event.preventDefault(); find(); } },
      h("label", { className: "option" }, "Find ", search),
      select("state", "State", STATES), select("model", "Contact", MODELS), select("order", "Order", ORDERS));
    const all = checkBox("Select all shown", { onchange: () => this.#select(this.jobs, this.all.checked) });
    this.all = all.control;
    this.chosen = h("span", { className: "note", role: "status" });
    this.compare = button("Compare", () => navigate(["compare"], { jobs: [...this.selected].join() }));
    this.remove = button("Delete", () => this.#delete());
    this.bulk = h("div", { className: "actions" }, this.compare, this.remove);
    this.selection = h("div", { className: "selection" }, all, this.chosen, this.bulk);
    this.list = h("ol", { className: "jobs", "aria-label": "Sweeps" });
    this.problem = problemLine();
    this.notice = h("p", { className: "notice", role: "status" });
    this.range = h("span", { className: "note", role: "status" });
    this.previous = button("Previous page", () => this.#turn(this.cursors.slice(0, -1)));
    this.next = button("Next page", () => this.#turn([...this.cursors, this.following]));
    this.intro = introduction();
    root.replaceChildren(
      h("h1", { id: "sweeps", tabindex: "-1" }, "Sweeps"), this.intro, this.notice, this.filters, this.problem.element,
      this.selection, this.list, h("div", { className: "controls" }, this.previous, this.next, this.range));
    this.#showSelection();
    this.show();
  }

  show() {
    const query = currentQuery();
    for (const control of this.filters.elements) control.value = query[control.name] ?? "";
    this.refresh();
  }

  /** Of the pages up to the one that is shown. */
  get cursors() {
    return [null, ...(currentQuery().pages?.split(",") ?? [])];
  }

  async refresh() {
    this.#refreshAfter.cancel();
    const wanted = this.#wanted();
    const asked = JSON.stringify([wanted, this.cursors]);
    const request = (page) => requestJson(`/v1/jobs?${query({ ...wanted, ...page })}`, { signal: this.signal });
    try {
      const [pinned, others] = await Promise.all([
        request({ pinned: true, limit: MAX_PINNED }),
        request({ limit: PAGE_SIZE, cursor: this.cursors.at(-1) }),
      ]);
      if (asked !== JSON.stringify([this.#wanted(), this.cursors])) return;
      if (!others.jobs.length && this.cursors.length > 1) { // all of this page were deleted
        setQuery({ pages: this.cursors.slice(1, -1).join() || null });
        return this.refresh(); // not show(), which would take back what is typed
      }
      const above = this.cursors.length === 1 ? pinned.jobs : [];
      this.#showJobs([...new Map([...above, ...others.jobs].map((job) => [job.id, job])).values()]);
      this.#showRange(pinned, others);
      renew(this.notice, others.notice ?? "");
      this.#refreshAfter([...pinned.jobs, ...others.jobs].some((job) => UNFINISHED.has(job.state)) ? POLL_MS : IDLE_POLL_MS);
    } catch (error) {
      this.showError(error);
      if (error.status >= 500) this.#refreshAfter(IDLE_POLL_MS); // it may be temporary
    }
  }

  showError(error) {
    this.problem.show(error);
    this.#hideError();
  }

  #hideError = debounced(ERROR_MS, () => this.problem.show(null));
  #refreshAfter = delayed(() => this.refresh());

  /** The parameters of a request for jobs, except which page. */
  #wanted() {
    const { search, ...choices } = Object.fromEntries(new FormData(this.filters));
    return { search: search.trim(), ...choices };
  }

  /** Show another page of the list. The heading takes the keyboard focus: the pressed button disappears. */
  #turn(cursors) {
    setQuery({ pages: cursors.slice(1).join() || null });
    this.refresh();
    document.getElementById("sweeps")?.focus();
  }

  #showRange(pinned, others) {
    this.following = others.next;
    const before = (this.cursors.length - 1) * PAGE_SIZE;
    const isFiltered = [...new FormData(this.filters)].some(([name, value]) => value && name !== "order");
    const foundText = isFiltered ? (others.total ? `${plural(others.total, "sweep")} found` : "No sweep matches.") : others.total ? "" : "No sweeps yet.";
    this.previous.hidden = !before;
    this.next.hidden = others.next === null;
    const pinnedText = pinned.total ? `, with ${count(pinned.total)} pinned` : "";
    const range = `${count(before + 1)} to ${count(before + others.jobs.length)} of ${count(others.total)}${pinnedText}`;
    renew(this.range, before || others.next ? range : foundText);
    this.intro.hidden = others.total > 0 || isFiltered;
    this.filters.hidden = !others.total && !isFiltered;
    this.selection.hidden = !others.total;
  }

  /** Rows are updated in place, which keeps the keyboard focus. */
  #showJobs(jobs) {
    this.jobs = jobs;
    const rows = new Map(jobs.map(({ id }) => [id, this.rows.get(id) ?? this.#row()]));
    for (const [id, { element }] of this.rows) if (!rows.has(id)) element.remove();
    this.rows = rows;
    this.selected = new Set([...this.selected].filter((id) => rows.has(id)));
    jobs.forEach((job, index) => {
      const { element, update } = rows.get(job.id);
      update(job);
      if (this.list.children[index] !== element) this.list.insertBefore(element, this.list.children[index] ?? null);
    });
    this.#showSelection();
  }

  #row() {
    let job;
    const box = h("input", { type: "checkbox", onchange: () => this.#select([job], box.checked) });
    const changePin = async ({ detail: presses }) => { // of a key, none
      const action = job.pinned ? "unpin" : "pin";
      await requestJson(`/v1/jobs/${job.id}/${action}`, { method: "POST" }).finally(() => this.refresh());
      if (!presses) element.scrollIntoView({ block: "nearest" }); // with the focus, which follows the row
      announce(`${titleOf(job)} is ${action}ned.`);
    };
    const pin = workButton("", changePin, (error) => this.showError(error), { className: "quiet pin" });
    const name = h("a", {});
    const time = h("span", { className: "note" });
    const error = h("p", { className: "problem" });
    const summary = new JobSummary(name, { change: () => this.refresh(), delete: () => this.#turn(this.cursors), error: (failure) => this.showError(failure) });
    const element = h("li", {}, h("div", { className: "choice" }, box, pin), h("div", { className: "about" }, h("h2", {}, name), summary.about),
      summary.progress, time, summary.actions, summary.notice, error);
    const update = (current) => {
      job = current;
      summary.show(job);
      box.setAttribute("aria-label", `Select ${titleOf(job)}`);
      pin.textContent = job.pinned ? "★" : "☆";
      pin.setAttribute("aria-label", `Pin ${titleOf(job)}`);
      pin.setAttribute("aria-pressed", String(job.pinned));
      pin.title = job.pinned ? "Unpin" : "Pin: show it above the others";
      name.href = link(["job", job.id]);
      time.textContent = ago(job.finished ?? job.created);
      error.textContent = job.error ?? "";
    };
    return { element, update, box };
  }

  #select(jobs, on) {
    for (const { id } of jobs) this.selected[on ? "add" : "delete"](id);
    this.#showSelection();
  }

  #showSelection() {
    for (const [id, { box }] of this.rows) box.checked = this.selected.has(id);
    const selected = this.jobs.filter(({ id }) => this.selected.has(id));
    this.all.checked = this.jobs.length > 0 && selected.length === this.jobs.length;
    this.all.indeterminate = selected.length > 0 && !this.all.checked;
    const areTooMany = selected.length > MOST_COMPARED;
    const limit = areTooMany ? `; at most ${MOST_COMPARED} can be compared` : "";
    renew(this.chosen, selected.length ? `${count(selected.length)} selected${limit}` : "");
    this.bulk.hidden = !selected.length;
    this.compare.disabled = selected.length < 2 || areTooMany;
    this.remove.disabled = selected.every((job) => UNFINISHED.has(job.state));
  }

  /** Delete the selected sweeps that are finished, after a confirmation that names them. */
  async #delete() {
    const finished = this.jobs.filter((job) => this.selected.has(job.id) && !UNFINISHED.has(job.state));
    const running = this.selected.size - finished.length;
    const names = finished.slice(0, MAX_NAMED).map((job) => `“${titleOf(job)}”`).join(", ");
    const more = finished.length > MAX_NAMED ? ` and ${count(finished.length - MAX_NAMED)} more` : "";
    const kept = running ? ` Kept, as not finished: ${plural(running, "sweep")}.` : "";
    if (!confirm(`Delete ${plural(finished.length, "sweep")} and ${finished.length === 1 ? "its" : "their"} results: ${names}${more}?${kept}`)) return;
    const failed = [];
    for (const job of finished) {
      await deleteJob(job).catch((error) => failed.push(`${titleOf(job)}: ${error.message}`));
    }
    if (failed.length) this.showError(new Error(failed.join("; ")));
    announce(`${plural(finished.length - failed.length, "sweep")} deleted.`);
    this.#turn(this.cursors);
  }
}

const introduction = () => h("section", { className: "intro", hidden: true },
  h("p", {}, "Two masses joined by a spring and a dashpot bounce on a plate that vibrates. Their flight times and modes depend on the plate’s acceleration ",
    h("i", {}, "Γ"), ", its frequency ", h("i", {}, "Ω"), " and the damping ", h("i", {}, "ξ"), "."),
  h("p", {}, h("a", { className: "button", href: link(["new"]) }, "New study"), " computes sweeps of these parameters, from the paper’s figures or your own."),
  h("p", {}, h("a", { className: "button", href: link(["explore"]) }, "Explore"), " shows one spring move, its cycles and thresholds, without computing a sweep."));
