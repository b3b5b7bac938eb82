// Controls above the plots. Each writes the query of the page's address, which the views follow.

import { addressValue, currentQuery, queryChanges, setQuery } from "../lib/address.js";
import { h } from "../lib/dom.js";
import { numberIn } from "../lib/format.js";
import { SYMBOL, axisText, clamp, meaningOf, nearestIndex } from "../lib/physics.js";

/** Sliders for `axes` of a view's grid, but not the one of its plot. An axis of one value has none: the plot's title shows it. */
export function sliders(view, axes) {
  if (view.isFollower) return false;
  const movable = axes.filter((axis) => view.valuesOf(axis).length > 1);
  return movable.length > 0 && h("div", { className: "sliders" }, movable.map((axis) => slider(view, axis)));
}

function slider(view, axis) {
  const values = view.valuesOf(axis);
  const id = `slider-${axis}`;
  const typed = h("input", {
    type: "text", inputmode: "decimal", size: 1, "aria-label": `Value of ${SYMBOL[axis]}`,
    onchange: () => {
      const value = typedIn(typed);
      const nearest = view.isContinuous ? clamp(value, values[0], values.at(-1)) : values[nearestIndex(values, value)];
      if (value !== null) setQuery({ [axis]: addressValue(nearest) });
    },
  });
  const input = h("input", {
    id, type: "range", min: 0, max: values.length - 1, step: 1, title: meaningOf(axis),
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

/** The number from `min` to `max` that was typed; null of another text, and the input says why. */
function typedIn(input, { min = -Infinity, max = Infinity } = {}) {
  const text = input.value.trim().replaceAll("−", "-");
  const value = numberIn(text);
  const lowest = min > -Infinity ? ` of ${min} or more` : "";
  const limits = max < Infinity ? ` from ${min} to ${max}` : lowest;
  const rule = /^-?\d*,\d+$/.test(text) ? `Write a decimal point, not a comma: ${text.replace(",", ".")}` : `Type a number${limits}.`;
  input.setCustomValidity(Number.isFinite(value) && value >= min && value <= max ? "" : rule);
  return input.reportValidity() ? value : null;
}

/** An input for such a number. */
export const numberInput = (label, name, otherwise, limits = {}, attributes = {}) => h("label", { className: "option" }, `${label} `, h("input", {
  type: "text", inputmode: "decimal", value: queryNumber(name, otherwise, limits), ...attributes,
  onchange: ({ target }) => {
    const value = typedIn(target, { min: 0, ...limits });
    if (value !== null) setQuery({ [name]: value === otherwise ? null : value });
  },
}));

/** The shortest flight that counts: of the address, or the micro-flight the sweep was classified with. */
export const minFlightOf = ({ spec }) => queryNumber("min", spec.micro_flight);

/** Which flights count, for points and modes alike. */
export const minFlightInput = ({ spec }) => numberInput("Count flights above, rad", "min", spec.micro_flight, {}, {
  "data-service": true, title: "Shorter flights do not count for the mode and are not drawn, unless all flights of a cell are shorter",
});
