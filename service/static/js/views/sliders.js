// One slider for each axis that the view holds still, along the job's own grid.

import { h } from "../lib/dom.js";
import { number } from "../lib/format.js";
import { MEANING, SYMBOL, nearest } from "../lib/physics.js";

/**
 * Sliders for `axes` (names) over `grid` ({gamma: values, …}), standing at the values nearest to `at`.
 * `moved(axis, value)` is called at every move.
 */
export function sliders(axes, grid, at, moved) {
  return h("div", { className: "sliders" }, axes.map((axis) => one(axis, grid[axis], at[axis], moved)));
}

function one(axis, values, wanted, moved) {
  const name = h("i", {}, SYMBOL[axis]);
  if (values.length === 1) {
    return h("p", { className: "fixed", title: MEANING[axis] }, name, ` = ${number(values[0])}`);
  }
  const id = `slide-${axis}`;
  const start = nearest(values, wanted);
  const output = h("output", { for: id });
  const input = h("input", {
    id, type: "range", min: 0, max: values.length - 1, step: 1, title: MEANING[axis],
    oninput: () => {
      show();
      moved(axis, values[input.valueAsNumber]);
    },
  });
  const show = () => {
    const value = values[input.valueAsNumber];
    output.textContent = number(value);
    input.setAttribute("aria-valuetext", `${SYMBOL[axis]} = ${number(value)}`);
  };
  input.value = String(start);
  show();
  return h("div", { className: "slider" }, h("label", { for: id }, name, " ="), output, input);
}
