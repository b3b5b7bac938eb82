// What moves the explorer: the axis, the sliders, the ramps that are shown, the shortest flight.

import { h } from "../lib/dom.js";
import { SYMBOL } from "../lib/physics.js";
import { sliders } from "./sliders.js";

/**
 * The controls for a view of the grid. `state`: {axes (longer than one), along, grid, fixed, directions, chosenRamps, least};
 * `on`: {turn(axis), move(axis, value), show(directions), least(rad)}.
 */
export function controls(state, on) {
  const others = Object.keys(SYMBOL).filter((axis) => axis !== state.along);
  return h("div", { className: "controls" },
    state.axes.length > 1 && axisChoice(state, on.turn),
    sliders(others, state.grid, state.fixed, on.move),
    state.directions.length > 1 && ramps(state, on.show),
    shortest(state.least, on.least));
}

function axisChoice({ axes, along }, turn) {
  return h("label", { className: "pick" }, "Diagram ",
    h("select", { onchange: (event) => turn(event.target.value), "aria-label": "Axis of the diagram" },
      axes.map((axis) => h("option", { value: axis, selected: axis === along }, `${SYMBOL[axis]}–φ`))));
}

function ramps({ directions, chosenRamps }, show) {
  const boxes = directions.map((one) => h("input", { type: "checkbox", checked: chosenRamps.includes(one), onchange: () => show(directions.filter((_, i) => boxes[i].checked)) }));
  return h("fieldset", { className: "directions" }, h("legend", {}, "Ramp"),
    directions.map((one, i) => h("label", { className: `key ${one}` }, boxes[i], ` ${one}`)));
}

function shortest(least, change) {
  return h("label", { className: "pick" }, "Hide flights under ",
    h("input", {
      type: "number", min: 0, step: "any", value: least || "", placeholder: "0",
      onchange: (event) => change(Math.max(0, Number(event.target.value) || 0)),
    }), " rad");
}
