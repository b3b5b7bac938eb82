// A job in short: its title, its specification in a line, its progress, and the buttons to cancel, resume or delete it.

import { link } from "../lib/address.js";
import { deleteJob, requestJson } from "../lib/api.js";
import { announce, h, keepFocus, renew, workButton } from "../lib/dom.js";
import { count, duration, number, plural } from "../lib/format.js";
import { AXES, SYMBOL, axisText, axisValues } from "../lib/physics.js";

export const UNFINISHED = new Set(["queued", "running"]);
/** Whether a job, or the budget that it is a level of, goes on. */
export const isGoing = ({ state, budget }) => UNFINISHED.has(state) || (budget ? !budget.over : false);
export const RESUMABLE = new Set(["failed", "cancelled"]);
export const [POLL_MS, ERROR_POLL_MS, IDLE_POLL_MS] = [1000, 3000, 5000]; // of a page of sweeps, while idle too: somebody else may change them
export const MOST_COMPARED = 6; // sweeps: more cannot be told apart by colour
const MAX_LISTED = 4; // values of an axis
const PARAMETER = { restitution: "e", penetration: "d", rest_length: "Λ" };

/** A sweep's name, or the beginning of its id. */
export const titleOf = (job) => (job.name.trim() ? job.name : "") || `Sweep ${job.id.slice(0, 8)}`;
/** The same on a plot, where a long one would be cut. */
export const shortTitleOf = (job) => titleOf(job).replace(/^(.{31})..+/su, "$1…");

/** What the list and the page of sweeps show of a job. `on`: {change(job), delete(), error(error)}, of its buttons. */
export class JobSummary {
  about = h("p", { className: "summary" });
  bar = h("progress", { className: "bar", max: 100 });
  amount = h("span", { className: "amount" });
  state = h("span", { className: "state" });
  progress = h("div", { className: "progress" }, this.state, this.bar, this.amount);
  actions = h("div", { className: "actions" });
  notice = h("p", { className: "notice" });

  constructor(name, on) {
    Object.assign(this, { name, on });
  }

  show(job) {
    const { state, progress, compiling } = job;
    this.name.textContent = this.name.title = titleOf(job);
    if (!this.about.hasChildNodes() || job.choice) renew(this.about, summary(job));
    this.state.textContent = state;
    this.progress.dataset.state = state;
    this.bar.value = progress.percent;
    this.bar.setAttribute("aria-label", `Progress of ${titleOf(job)}`);
    this.amount.textContent = this.amount.title = compiling ? `compiling ${compiling.kernel}, ${duration(compiling.seconds)} of about ${duration(compiling.usual)}` : amount(job);
    renew(this.notice, job.notice ? notice(job) : [], job.budget ? level(job) : []);
    showActions(this.actions, job, this.on);
  }
}

/** How much of a job is computed, in words. */
export function amount({ state, progress: { cells_done: done, cells_total: total, cells_computed: computed, cells_needed: needed, percent, eta_seconds: eta } }) {
  const isAdaptive = (computed ?? null) !== null;
  if (state === "done") return isAdaptive ? `${plural(total, "cell")}, ${count(computed)} computed` : plural(total, "cell");
  const known = isAdaptive ? `, ${count(computed)} of at least ${count(needed)} computed` : "";
  const left = state === "running" && eta !== null && done ? `, ${duration(eta)} left` : "";
  return `${number(percent, 3)} % of ${plural(total, "cell")}${left}${known}`;
}

export function summary({ spec, choice }) {
  if (!spec) return ["specification too long to list"];
  const axes = AXES.filter((axis) => axis in spec).map((axis) => [h("i", {}, SYMBOL[axis]), ` ${rangeText(spec[axis])}`]);
  const texts = [
    protocolText(spec.protocol), spec.model && contactText(spec.model, choice), spec.exponents > 0 && plural(spec.exponents, "exponent"),
    spec.refine && `adaptive, by ${spec.refine.by}`,
    spec.parent && h("a", { href: link(["job", spec.parent, "modes"]) }, "window of another sweep"),
  ].filter(Boolean);
  return [...axes, ...texts].flatMap((part) => [" · ", h("span", {}, part)]).slice(1);
}

/** "soft, e 0.2, d 0.01": a contact with its parameters. */
function contactText({ kind, adhesive = true, ...parameters }, choice) {
  const known = Object.entries(parameters).filter(([, value]) => value !== null)
    .map(([name, value]) => (typeof value === "number" ? `${PARAMETER[name] ?? name.replaceAll("_", " ")}\u00a0${number(value)}` : value));
  return [choice ? `${kind} → ${choice.model}` : kind, ...known, ...(adhesive ? [] : ["never pulling"])].join(", ");
}

/** That another kernel version computed a sweep, and a link to the one that replaces it. */
const notice = ({ notice: text, replaced_by: successor }) => [
  `${text[0].toUpperCase()}${text.slice(1)}. `, ...(successor ? [h("a", { href: link(["job", successor]) }, "Show the sweep that replaces it")] : []),
];

/** How far the budget is that a sweep is a level of: what is computed for it, or what its audit says. */
function level(job) {
  const { id, budget: { doing, computing, answer, seconds_left: left, over, error } } = job;
  const text = (error ?? doing).replace(/gamma|omega|xi/g, (axis) => SYMBOL[axis]);
  if (!over) return [computing && computing !== id ? h("a", { href: link(["job", computing]) }, text) : text, `, ${duration(left)} left`];
  if (answer && answer !== id) return [h("a", { href: link(["job", answer]) }, "Show the finest level of its time")];
  return answer ? [h("a", { href: link(["job", id, "details"]) }, isAudited(job) ? "How wrong it can be" : `${text}; audit it now`)] : [text];
}

/** Whether a sweep is the answer of a budget that has audited it. */
export const isAudited = ({ id, budget }) => Boolean(budget?.over) && budget.answer === id && !budget.doing.startsWith("no audit");

/** How many cells of a sweep were still settling, and what to do; nothing where none was. */
export function settling({ id, progress, spec }) {
  const { cells_settling: cells } = progress;
  if (!cells || !spec) return [];
  const taken = spec.settle === "auto" ? (spec.until ?? 5000) : (spec.settle_until ?? spec.settle + spec.observe);
  return [`${plural(cells, "cell")} still settling after ${count(taken)} plate periods: `,
    h("a", { href: link(["new"], { from: id, field: spec.settle === "auto" ? "until" : "settle" }) }, "give more time")];
}

function rangeText(axis) {
  const values = axisValues(axis);
  if (values.length <= MAX_LISTED) return values.map((value) => axisText(value, values)).join(", ");
  return `${axisText(values[0], values)} – ${axisText(values.at(-1), values)} (${count(values.length)})`;
}

function protocolText({ kind, axis, direction, start, plane, rows, columns }) {
  if (kind === "rest") return "from rest";
  if (kind !== "ramp") return `${kind === "orbits" ? "cycles" : kind}${plane ? `, ${columns} × ${rows} ${plane === "drop" ? "drops" : "starts in contact"}` : ""}`;
  const from = start ? ` from the cycle (1, ${start.periods})` : "";
  return `ramp ${direction === "both" ? "up and down" : direction} along ${SYMBOL[axis]}${from}`;
}

/** Show in `root` the buttons that the job's state allows, keeping the keyboard focus among them. */
function showActions(root, job, on) {
  const actions = UNFINISHED.has(job.state) ? ["cancel"] : [...(RESUMABLE.has(job.state) ? ["resume"] : []), "delete"];
  const shown = [...actions, titleOf(job)].join();
  if (root.dataset.actions === shown) return;
  root.dataset.actions = shown;
  const run = async (action) => {
    if (action !== "delete") {
      on.change(await requestJson(`/v1/jobs/${job.id}/${action}`, { method: "POST" }));
      return announce(`${titleOf(job)}: ${action} requested.`); // running chunks may still end
    }
    if (!confirm(`Delete “${titleOf(job)}” and its results?`)) return;
    await deleteJob(job);
    announce(`${titleOf(job)} is deleted.`);
    on.delete();
  };
  const title = (action) => action[0].toUpperCase() + action.slice(1);
  const buttons = actions.map((action) => workButton(title(action), () => run(action), on.error, { className: "quiet", "aria-label": `${title(action)} ${titleOf(job)}` }));
  keepFocus(root, () => root.replaceChildren(...buttons), () => buttons[0]);
}
