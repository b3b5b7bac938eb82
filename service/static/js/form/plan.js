// Plans for a given time: efforts and grids of the form's sweep, with the share each would show wrong, or its levels.

import { partsOf, query, requestDataset } from "../lib/api.js";
import { announce, button, h, problemLine, workButton } from "../lib/dom.js";
import { bytes, count, duration, share } from "../lib/format.js";
import { table } from "../lib/table.js";

const SECONDS = { s: 1, m: 60, h: 3600 };

/** A time as seconds: "90", "90s", "5m" or "1h"; null if empty. Throws an Error for another text. */
function seconds(text) {
  if (!text.trim()) return null;
  const [, value, unit = "s"] = /^\s*(\d+(?:\.\d+)?)\s*(s|m|h)?(?:in)?\s*$/.exec(text) ?? [];
  if (!(value > 0)) throw new Error("The time must be such as 90s, 5m or 1h.");
  return value * SECONDS[unit];
}

/** Compares settings of the sweep that `read()` returns. `use(spec)` takes one of them; `compute(seconds)` submits its levels. */
export class Plan {
  constructor(read, use, compute) {
    [this.read, this.use] = [read, use];
    const compareOnEnter = (event) => {
      if (event.key !== "Enter") return;
      event.preventDefault(); // the form is not submitted
      compare.click();
    };
    this.budget = h("input", { type: "text", size: "6", placeholder: "5m", onkeydown: compareOnEnter });
    this.problem = problemLine();
    const compare = workButton("Compare settings", () => this.#compare(), this.problem.show, { busy: "Comparing …" });
    const computeWithin = () => {
      this.problem.show(null);
      return compute(seconds(this.budget.value || this.budget.placeholder));
    };
    const within = workButton("Compute within this time", computeWithin, this.problem.show);
    this.table = h("div");
    this.element = h("details", {}, h("summary", {}, "Plan for a given time"),
      h("p", { className: "note" }, "Each effort and grid is tried at pilot points and judged by a longer computation. The recommended setting shows least wrong within the time; without a time, it is the cheapest that shows at most 5 % wrong. Its share is of fresh points; a note says if no setting surely keeps to the limit. Or compute from coarse to fine: the picture grows until the time is over, and an audit says how wrong it is."),
      h("p", { className: "controls" }, h("label", {}, "Time ", this.budget), compare, within), this.problem.element, this.table);
  }

  clear() {
    this.comparing?.abort();
    this.table.replaceChildren();
    this.problem.show(null);
  }

  async #compare() {
    this.clear();
    const { signal } = this.comparing = new AbortController();
    const plan = await requestDataset(`/v1/plans?${query({ budget: seconds(this.budget.value) })}`, { method: "POST", body: this.read(), signal, waits: true });
    const rows = partsOf(plan, "setting");
    const { note } = plan.attrs;
    const useButton = ({ effort, grid, spec }) => button("Use", () => this.use(JSON.parse(spec)), { "aria-label": `Use ${effort}, ${grid}` });
    const settings = table("Settings", ["effort", "ξ × Ω × Γ", "cells", "time", "wrong", "at most", "size", ""], rows.map((row) => [
      h("span", {}, row.effort, Boolean(row.recommended) && h("small", { className: "recommended" }, " recommended")),
      row.grid, count(row.cells), duration(row.seconds), share(row.share), share(row.high, 3, true), bytes(Number(row.bytes)), useButton(row),
    ]));
    this.table.append(settings, ...(note ? [h("p", { className: "note" }, `Note: ${note}.`)] : []));
    const { effort, grid, high } = rows.find(({ recommended }) => recommended);
    announce(`Recommended: ${effort}, ${grid} cells, at most ${share(high, 3, true)} wrong${note ? `; ${note}` : ""}.`);
  }
}
