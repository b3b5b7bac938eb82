// Controls above the plots: sliders along the axes that are held fixed, and those of the bifurcation diagram.

import { h } from "../lib/dom.js";
import { number } from "../lib/format.js";
import { AXES, SYMBOL, meaningOf, nearestIndex } from "../lib/physics.js";

/**
 * Sliders for `axes` along the values of `grid` ({gamma: values, …}), starting at the values nearest to `start`.
 * `onMove(axis, value)` is called at every move. Axes of one value have none: the plot's title shows their value.
 */
export function sliders(axes, grid, start, onMove) {
  const movable = axes.filter((axis) => grid[axis].length > 1);
  return movable.length > 0 && h("div", { className: "sliders" }, movable.map((axis) => slider(axis, grid[axis], start[axis], onMove)));
}

function slider(axis, values, start, onMove) {
  const symbol = h("i", {}, SYMBOL[axis]);
  const id = `slider-${axis}`;
  const output = h("output", { for: id });
  const input = h("input", {
    id, type: "range", min: 0, max: values.length - 1, step: 1, title: meaningOf(axis),
    oninput: () => {
      show();
      onMove(axis, values[input.valueAsNumber]);
    },
  });
  const show = () => {
    const value = values[input.valueAsNumber];
    output.textContent = number(value);
    input.setAttribute("aria-valuetext", `${SYMBOL[axis]} = ${number(value)}`);
  };
  input.value = String(nearestIndex(values, start));
  show();
  return h("div", { className: "slider" }, h("label", { for: id }, symbol, " ="), output, input);
}

/**
 * The controls of a bifurcation diagram. `state`: {axes (of more than one value), along, grid, fixed, directions,
 * shownDirections, minFlight}; `on`: {axis(name), move(axis, value), directions(list), minFlight(rad)}.
 */
export function diagramControls(state, on) {
  const others = AXES.filter((axis) => axis !== state.along);
  return h("div", { className: "controls" },
    state.axes.length > 1 && axisSelect(state, on.axis),
    sliders(others, state.grid, state.fixed, on.move),
    state.directions.length > 1 && directionBoxes(state, on.directions),
    minFlightInput(state.minFlight, on.minFlight));
}

function axisSelect({ axes, along }, onChange) {
  return h("label", { className: "option" }, "Diagram ",
    h("select", { onchange: (event) => onChange(event.target.value), "aria-label": "Axis of the diagram" },
      axes.map((axis) => h("option", { value: axis, selected: axis === along }, `${SYMBOL[axis]}–φ`))));
}

function directionBoxes({ directions, shownDirections }, onChange) {
  const checked = () => directions.filter((_, i) => boxes[i].checked);
  const boxes = directions.map((direction) => h("input", { type: "checkbox", checked: shownDirections.includes(direction), onchange: () => onChange(checked()) }));
  return h("fieldset", { className: "directions" }, h("legend", {}, "Ramp"),
    directions.map((direction, i) => h("label", { className: `direction ${direction}` }, boxes[i], ` ${direction}`)));
}

/** The shortest flight of a view: of its address, or the micro-flight the sweep was classified with. */
export function minFlightOf({ min }, { spec }) {
  const value = (min ?? "") === "" ? NaN : Number(min);
  return value >= 0 && Number.isFinite(value) ? value : spec.micro_flight;
}

/** Which flights count, for points and modes alike. */
export function minFlightInput(minFlight, onChange) {
  const title = "Shorter flights do not count for the mode and are not drawn, unless all flights of a cell are shorter";
  return h("label", { className: "option", title }, "Count flights above ",
    h("input", {
      type: "number", min: 0, step: "any", value: minFlight, required: true,
      onchange: (event) => { if (event.target.value !== "" && event.target.valueAsNumber >= 0) onChange(event.target.valueAsNumber); },
    }), " rad");
}
