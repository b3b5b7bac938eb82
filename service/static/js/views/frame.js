// The frame of a page with a plot: a bar, a line on what is shown, controls, the plot with a column, and a motion below it.

import { h } from "../lib/dom.js";

/** Build it in `root` from the contents of the bar and the line, an element for a problem and one with tabs; the rest is filled later. */
export function buildFrame(root, { bar, line, tabs = false, problem = false }) {
  const controls = h("div", { className: "view-controls" });
  const panel = h("section", { className: "panel" });
  const secondPanel = h("section", { className: "beside", hidden: true });
  const trajectorySection = h("section", { className: "trajectory", "aria-label": "Trajectory of a cell", hidden: true });
  document.getElementById("bar").replaceChildren(...bar);
  root.replaceChildren(h("header", { className: "job" }, line), ...(problem ? [problem] : []), h("div", { className: "views" }, tabs, controls),
    h("div", { className: "panels" }, panel, secondPanel), trajectorySection);
  return { controls, panel, secondPanel, trajectorySection };
}
