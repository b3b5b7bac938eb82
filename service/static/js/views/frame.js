// The frame of a page with a plot: a bar, a line on what is shown, controls, the plot with a column, and a motion below it.

import { h } from "../lib/dom.js";

/** Build it in `root` from the contents of the bar and the line, and an element with tabs; its other parts are returned empty. */
export function buildFrame(root, { bar, line, tabs = false, problem = false }) {
  const part = (tag, className, attributes) => h(tag, { className, ...attributes });
  const parts = {
    controls: part("div", "view-controls"), panel: part("section", "panel"), second: part("section", "beside", { hidden: true }),
    aside: part("section", "trajectory", { "aria-label": "Trajectory of a cell", hidden: true }),
  };
  document.getElementById("bar").replaceChildren(...bar);
  root.replaceChildren(h("header", { className: "job" }, line), ...(problem ? [problem] : []), h("div", { className: "views" }, tabs, parts.controls),
    h("div", { className: "panels" }, parts.panel, parts.second), parts.aside);
  return parts;
}
