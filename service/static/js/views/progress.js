// How far a sweep is, in a line; what it is about, in another; and what can be done with it.

import { askJson } from "../lib/api.js";
import { confirmed } from "../lib/confirm.js";
import { h } from "../lib/dom.js";
import { count, number, plural, seconds } from "../lib/format.js";
import { SYMBOL, axisValues } from "../lib/physics.js";

export const UNFINISHED = new Set(["queued", "running"]);
const RESUMABLE = new Set(["failed", "cancelled"]);

export class ProgressBar {
  constructor() {
    this.fill = h("span", {});
    this.track = h("div", { className: "bar", role: "progressbar", "aria-valuemin": 0, "aria-valuemax": 100 }, this.fill);
    this.text = h("span", { className: "said" });
    this.state = h("span", { className: "state" });
    this.element = h("div", { className: "progress" }, this.state, this.track, this.text);
  }

  show({ name, state, progress }) {
    this.state.textContent = state;
    this.element.dataset.state = state;
    this.fill.style.width = `${progress.percent}%`;
    this.track.setAttribute("aria-valuenow", String(progress.percent));
    this.track.setAttribute("aria-label", `Progress of ${name || "the sweep"}`);
    this.text.textContent = told(state, progress);
  }
}

function told(state, { cells_done: done, cells_total: total, percent, eta_seconds: eta }) {
  if (state === "done") return plural(total, "cell");
  const part = `${number(percent, 3)} % of ${plural(total, "cell")}`;
  return state === "running" && eta !== null && done ? `${part}, ${seconds(eta)} to go` : part;
}

/** Axes, start and contact of a sweep, as nodes. */
export function summary({ spec, choice }) {
  if (!spec) return ["a long specification"];
  const axes = ["gamma", "omega", "xi"].flatMap((axis) => [h("span", {}, h("i", {}, SYMBOL[axis]), ` ${extent(spec[axis])}`), " · "]);
  const kind = choice ? `${spec.model.kind} → ${choice.model}` : spec.model.kind;
  return [...axes, h("span", {}, started(spec.protocol)), " · ", h("span", {}, `${kind} contact`)];
}

function extent(axis) {
  const values = axisValues(axis);
  if (values.length <= 4) return values.map((value) => number(value)).join(", ");
  return `${number(values[0])} – ${number(values.at(-1))} (${count(values.length)})`;
}

function started({ kind, axis, direction }) {
  if (kind === "rest") return "from rest";
  return `${direction === "both" ? "up and down" : direction} along ${SYMBOL[axis]}`;
}

/** Buttons for what the state allows; the one that had the focus keeps it. */
export function actions(root, job, { changed, deleted, fail }) {
  const wanted = UNFINISHED.has(job.state) ? ["cancel"] : RESUMABLE.has(job.state) ? ["resume", "delete"] : ["delete"];
  if (root.dataset.shows === wanted.join()) return;
  const focused = root.contains(document.activeElement);
  root.dataset.shows = wanted.join();
  root.replaceChildren(...wanted.map((what) =>
    h("button", {
      type: "button", className: "quiet", "aria-label": `${TITLES[what]} ${job.name || job.id.slice(0, 8)}`,
      onclick: async (event) => {
        if (what === "delete" && !(await confirmed(`Delete “${job.name || job.id.slice(0, 8)}” and all it has computed?`, "Delete"))) return;
        const pressed = event.target;
        pressed.disabled = true;
        try {
          if (what === "delete") {
            await askJson(`/v1/jobs/${job.id}`, { method: "DELETE" });
            deleted();
          } else changed(await askJson(`/v1/jobs/${job.id}/${what}`, { method: "POST" }));
        } catch (error) {
          fail(error);
        } finally {
          pressed.disabled = false;
        }
      },
    }, TITLES[what])));
  if (focused) root.querySelector("button")?.focus();
}

const TITLES = { cancel: "Cancel", resume: "Resume", delete: "Delete" };
