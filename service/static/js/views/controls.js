// Controls above the plots. Each writes the query of the page's address, which the views follow.

import { addressValue, currentQuery, queryChanges, setQuery } from "../lib/address.js";
import { h } from "../lib/dom.js";
import { numberIn } from "../lib/format.js";
import { MEANING, SYMBOL, axisText, nearestIndex } from "../lib/physics.js";

/** Sliders for `axes` of a view's grid, but not the one of its plot. An axis of one value has none: the plot's title shows it. */
export function sliders(view, axes) {
  if (view.isFollower) return false;
  const movable = axes.filter((axis) => view.valuesOf(axis).length > 1 && view.compared.some(({ grid }) => grid[axis].length > 1));
  return movable.length > 0 && h("div", { className: "sliders" }, movable.map((axis) => slider(view, axis)));
}

function slider(view, axis) {
  const values = view.valuesOf(axis);
  const id = `slider-${axis}`;
  const take = (value) => setQuery({ [axis]: addressValue(view.isContinuous ? value : values[nearestIndex(values, value)]) });
  const typed = typedNumber(take, view.isContinuous ? { min: values[0], max: values.at(-1) } : {}, { size: 1, "aria-label": `Value of ${SYMBOL[axis]}` });
  const input = h("input", {
    id, type: "range", min: 0, max: values.length - 1, step: 1, title: MEANING[axis],
    oninput: () => setQuery({ [axis]: addressValue(values[input.valueAsNumber]) }),
  });
  const show = () => {
    const value = view.place[axis];
    input.value = String(nearestIndex(values, value));
    typed.value = axisText(value, values);
    typed.style.minWidth = `calc(${typed.value.length}ch + .9rem)`;
    typed.setCustomValidity("");
    input.setAttribute("aria-valuetext", `${SYMBOL[axis]} = ${typed.value}`);
    element.hidden = axis === view.along;
  };
  const element = h("div", { className: "slider" }, h("label", { for: id }, h("i", {}, SYMBOL[axis]), " ="), typed, input);
  show();
  queryChanges.addEventListener("change", show, { signal: view.signal });
  return element;
}

/** The number from `min` to `max` that the address has as `name`; `otherwise` where it has none. */
export function queryNumber(name, otherwise, { min = 0, max = Number.MAX_VALUE } = {}) {
  const value = Number(currentQuery()[name] || NaN);
  return value >= min && value <= max ? value : otherwise;
}

/** An input for a number from `min` to `max`, which `take(value)` gets; of another text it says why it is none. */
function typedNumber(take, { min = -Infinity, max = Infinity }, attributes) {
  const onchange = ({ target }) => {
    const text = target.value.trim();
    const value = numberIn(text);
    const lowest = min > -Infinity ? ` of ${min} or more` : "";
    const limits = max < Infinity ? ` from ${min} to ${max}` : lowest;
    const rule = /^[-−]?\d*,\d+$/.test(text) ? `Write a decimal point, not a comma: ${text.replace(",", ".")}` : `Type a number${limits}.`;
    target.setCustomValidity(Number.isFinite(value) && value >= min && value <= max ? "" : rule);
    if (target.reportValidity()) take(value);
  };
  return h("input", { type: "text", inputmode: "decimal", onchange, ...attributes });
}

/** An input for such a number of the address. */
export const numberInput = (label, name, otherwise, limits = {}, attributes = {}) => h("label", { className: "option" }, `${label} `, typedNumber(
  (value) => setQuery({ [name]: value === otherwise ? null : value }), { min: 0, ...limits }, { value: queryNumber(name, otherwise, limits), size: 5, ...attributes }));

/** The shortest flight that counts: of the address, or the micro-flight the sweep was classified with. */
export const minFlightOf = ({ spec }) => queryNumber("min", spec.micro_flight);

/** Which flights count, for points and modes alike. */
export const minFlightInput = ({ spec }) => numberInput("Count flights above, rad", "min", spec.micro_flight, {}, {
  "data-service": true, title: "Shorter flights do not count for the mode and are not drawn, unless all flights of a cell are shorter",
});
