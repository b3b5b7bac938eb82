// Several sweeps compared: in one diagram, or side by side as diagrams or mode maps with the same axes and one pointer.

import { cellQuery, currentQuery, link, navigate, setQuery, windowQuery } from "../lib/address.js";
import { requestJson } from "../lib/api.js";
import { choice, h, problemLine } from "../lib/dom.js";
import { AXES, isClose, isSweep } from "../lib/physics.js";
import { numberedColour, theme } from "../plot/colours.js";
import { legendEntry } from "../views/cells.js";
import { Diagram } from "../views/diagram.js";
import { Modes } from "../views/modes.js";
import { buildFrame, sourceOf } from "../views/plot-view.js";
import { ERROR_POLL_MS, MOST_COMPARED, POLL_MS, amount, isGoing, shortTitleOf, summary, titleOf } from "../views/progress.js";
import { Difference } from "./difference.js";

const LAYOUTS = { overlay: "overlaid", side: "side by side", maps: "mode maps", difference: "difference of the first two" };
const ON_MAPS = { __proto__: null, maps: Modes, difference: Difference };

export class Compare {
  views = [];

  constructor(root, { query }, signal) {
    this.signal = signal;
    document.title = "Comparison · Bouncing spring";
    this.ids = [...new Set((query.jobs ?? "").split(",").filter(Boolean))];
    this.problem = problemLine();
    this.layouts = h("div", { className: "controls" });
    this.legend = h("ul", { className: "compared", "aria-label": "Sweeps" });
    Object.assign(this, buildFrame(root, { bar: [h("h1", { tabindex: "-1" }, "Comparison")], line: [this.legend, this.problem.element], tabs: this.layouts }));
    this.refresh();
  }

  async refresh(redraw = true) {
    clearTimeout(this.timer);
    try {
      if (this.ids.length < 2) throw new Error("Select two sweeps or more in the list of sweeps, and press Compare.");
      if (this.ids.length > MOST_COMPARED) throw new Error(`At most ${MOST_COMPARED} sweeps can be compared; ${this.ids.length} were selected.`);
      const jobs = await Promise.all(this.ids.map((id) => requestJson(`/v1/jobs/${id}`, { signal: this.signal })));
      const sweeps = jobs.filter(({ spec }) => isSweep(spec));
      const others = jobs.filter((job) => !sweeps.includes(job)).map(titleOf).join(", ");
      if (sweeps.length < 2) throw new Error(`Only sweeps have diagrams to compare; other studies: ${others}.`);
      this.problem.show(others ? new Error(`Left out, because only sweeps have diagrams: ${others}.`) : null);
      const isFirst = !this.sources;
      if (isFirst) this.#start(sweeps);
      const hasChanged = this.sources.some(({ job }, i) => job.progress.cells_done !== sweeps[i].progress.cells_done || job.state !== sweeps[i].state);
      this.sources.forEach(({ job }, i) => Object.assign(job, sweeps[i])); // the views have them too
      for (const { job, state } of this.sources) state.textContent = job.state === "done" ? "" : ` · ${job.state}, ${amount(job)}`;
      if (hasChanged || (redraw && !isFirst)) this.views.forEach((view) => view.update());
      if (sweeps.some(isGoing) && !this.signal.aborted) this.timer = setTimeout(() => this.refresh(false), POLL_MS);
    } catch (error) {
      this.problem.show(error);
      if (error.status >= 500) this.timer = setTimeout(() => this.refresh(false), ERROR_POLL_MS);
    }
  }

  #start(jobs) {
    this.sources = jobs.map((job, i) => sourceOf(job, i + 1));
    this.mapped = this.sources.filter(({ grid }) => grid.gamma.length > 1 && grid.omega.length > 1);
    this.legend.replaceChildren(...this.sources.map((source) => legendEntry(numberedColour(source.number, theme().dark),
      h("a", { href: link(["job", source.job.id]) }, titleOf(source.job)),
      h("p", { className: "summary" }, summary(source.job), (source.state = h("span", {}))))));
    this.show();
  }

  show() {
    if (!this.sources) return; // refresh() shows it
    const { layout } = currentQuery();
    const layouts = Object.entries(LAYOUTS).filter(([name]) => name !== "maps" || this.mapped.length > 1);
    const initial = layouts.some(([name]) => name === layout) ? layout : "overlay";
    this.layouts.replaceChildren(choice("Layout", layouts, initial, (name) => {
      setQuery({ layout: name === "overlay" ? null : name, ...windowQuery(null) });
      this.#build(name);
    }));
    this.#build(initial);
  }

  #build(layout) {
    this.leaving?.abort();
    this.leaving = new AbortController(); // of this layout
    const signal = AbortSignal.any([this.signal, this.leaving.signal]);
    const [View, sources] = [ON_MAPS[layout] ?? Diagram, layout === "maps" ? this.mapped : this.sources];
    // The values that any of the sweeps shown has; each is shown at its own nearest one.
    const merged = (lists) => lists.flat().sort((a, b) => a - b).filter((value, i, all) => !i || !isClose(value, all[i - 1]));
    const grid = layout === "difference" ? sources[0].grid : Object.fromEntries(AXES.map((axis) => [axis, merged(sources.map((source) => source.grid[axis]))]));
    const groups = { overlay: [sources], difference: [sources.slice(0, 2)] }[layout] ?? sources.map((source) => [source]);
    this.legend.classList.toggle("uncoloured", layout !== "overlay");
    const isSide = groups.length > 1; // views side by side
    const roots = isSide ? groups.map(() => h("section", {})) : [this.panel];
    this.panel.className = isSide ? "panel side" : "panel";
    this.panel.replaceChildren(...(isSide ? roots : []));
    this.controls.replaceChildren();
    const extent = () => {
      const windows = this.views.filter(({ isLoaded }) => isLoaded).map((view) => view.whole());
      const side = (name, choose) => choose(...windows.map((window) => window[name]));
      return { x0: side("x0", Math.min), x1: side("x1", Math.max), y0: side("y0", Math.min), y1: side("y1", Math.max) };
    };
    const others = (view) => this.views.filter((other) => other !== view);
    this.views = groups.map((group, i) => new View(roots[i], {
      sources: group, signal, compared: sources, bar: isSide ? null : this.controls, grid, isFollower: i > 0,
      prefix: isSide ? `${shortTitleOf(group[0].job)}:   ` : "", extent,
      onSelect: (cell, job) => navigate(["job", job.id, layout in ON_MAPS ? "modes" : "diagram"], cellQuery(cell)),
      onPoint: (view, x, y) => others(view).forEach((other) => other.follow(x, y)),
      onLoad: (view) => others(view).forEach(({ plot }) => plot.redraw()), // the window of all data may have grown
    }));
  }
}
