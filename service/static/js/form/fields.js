// The fields of the form. Each is {element, read(), write(value)} with values as a specification has them; read()
// gives null, and write() takes undefined, for the default.

import { h } from "../lib/dom.js";
import { AXES, SYMBOL, meaningOf } from "../lib/physics.js";

export const NUMBER_INPUT = { type: "text", inputmode: "decimal", autocomplete: "off", size: 8 };

/** Typed text as a number; as it is where it is none, for the service to refuse; null where it is empty. */
export function parseNumber(text) {
  const trimmed = text.trim().replace("−", "-");
  if (trimmed === "") return null;
  return Number.isFinite(Number(trimmed)) ? Number(trimmed) : trimmed;
}

/** A number; an empty input means the default, which is its placeholder. */
export function numberField(name, label, about, defaultValue) {
  const input = h("input", { ...NUMBER_INPUT, placeholder: String(defaultValue), "data-field": name });
  return {
    element: h("label", { className: "plain" }, h("span", {}, label), input, h("small", {}, about)),
    read: () => parseNumber(input.value),
    write: (value) => { input.value = value === undefined || value === null ? "" : String(value); },
  };
}

/** Yes or no. */
export function checkField(name, label, about, defaultValue) {
  const input = h("input", { type: "checkbox", checked: defaultValue, "data-field": name });
  return {
    element: h("label", { className: "plain" }, h("span", {}, label), input, h("small", {}, about)),
    read: () => (input.checked === defaultValue ? null : input.checked),
    write: (value) => { input.checked = value ?? defaultValue; },
  };
}

export function nameField() {
  const input = h("input", { type: "text", autocomplete: "off", maxlength: 200, size: 32, "data-field": "name" });
  return {
    element: h("label", { className: "plain" }, h("span", {}, "Name"), input, h("small", {}, "a label for the list of sweeps")),
    read: () => input.value,
    write: (value) => { input.value = value ?? ""; },
  };
}

const AXIS_KINDS = { single: "one value", list: "a list of values", range: "a range" };
const AXIS_DEFAULTS = { gamma: { start: 0.5, stop: 6, num: 551 }, omega: 0.5, xi: 0.26 }; // of the form: a specification has none

/** One axis: a single value, a list of values, or a range. */
export function axisField(axis) {
  const input = (field, label, attributes = {}) => {
    const element = h("input", { ...NUMBER_INPUT, "data-field": field, ...attributes });
    return { element, label: h("label", {}, h("span", {}, label), element) };
  };
  const kind = h("select", { onchange: () => show() },
    Object.entries(AXIS_KINDS).map(([value, text]) => h("option", { value }, text)));
  const single = input(axis, "value");
  const list = input(axis, "values, separated by commas", { size: 24 });
  const start = input(`${axis}.start`, "start");
  const stop = input(`${axis}.stop`, "stop");
  const num = input(`${axis}.num`, "number of values", { inputmode: "numeric" });
  const spacing = h("select", { "data-field": `${axis}.spacing` }, ["linear", "log"].map((value) => h("option", { value }, value)));
  const spacingLabel = h("label", {}, h("span", {}, "spacing"), spacing);
  const labels = { single: [single.label], list: [list.label], range: [start.label, stop.label, num.label, spacingLabel] };
  const show = () => Object.entries(labels).forEach(([name, group]) => group.forEach((label) => { label.hidden = name !== kind.value; }));

  const read = () => {
    if (kind.value === "single") return parseNumber(single.element.value);
    if (kind.value === "list") return list.element.value.split(/[,;\s]+/).filter(Boolean).map(parseNumber);
    return { start: parseNumber(start.element.value), stop: parseNumber(stop.element.value), num: parseNumber(num.element.value), spacing: spacing.value };
  };
  const write = (value = AXIS_DEFAULTS[axis]) => {
    kind.value = typeof value === "number" ? "single" : Array.isArray(value) ? "list" : "range";
    if (kind.value === "single") single.element.value = String(value);
    else if (kind.value === "list") list.element.value = value.join(", ");
    else {
      for (const [name, part] of Object.entries({ start, stop, num })) part.element.value = String(value[name]);
      spacing.value = value.spacing ?? "linear";
    }
    show();
  };
  const element = h("fieldset", { "data-group": axis },
    h("legend", {}, h("i", {}, SYMBOL[axis]), h("small", {}, meaningOf(axis))),
    h("label", {}, h("span", {}, "given as"), kind), Object.values(labels).flat());
  return { element, read, write };
}

const PROTOCOLS = { rest: "every cell from rest", up: "ramp up", down: "ramp down", both: "ramp up, then down" };

const REFINEMENTS = { "": "every cell", mode: "where the mode changes", bouncing: "where bouncing begins" };

/** Every cell, or an adaptive map: only the cells near which it changes. */
export function refineField() {
  const by = h("select", { "data-field": "refine", onchange: () => show() }, Object.entries(REFINEMENTS).map(([value, text]) => h("option", { value }, text)));
  const coarsest = h("input", { ...NUMBER_INPUT, inputmode: "numeric", "data-field": "refine.coarsest" });
  const margin = h("input", { type: "checkbox", "data-field": "refine.margin" });
  const blocks = h("label", {}, h("span", {}, "first blocks, cells wide"), coarsest);
  const wider = h("label", {}, h("span", {}, "and the blocks beside"), margin);
  const show = () => {
    blocks.hidden = wider.hidden = !by.value;
    coarsest.placeholder = by.value === "bouncing" ? "64" : "16";
  };
  return {
    element: h("fieldset", { "data-group": "refine" },
      h("legend", {}, "Cells", h("small", {}, "of a map from rest; those left out take the mode of their block")),
      h("label", {}, h("span", {}, "compute"), by), blocks, wider),
    read: () => {
      const width = parseNumber(coarsest.value);
      return by.value ? { by: by.value, ...(width !== null && { coarsest: width }), ...(margin.checked && { margin: true }) } : null;
    },
    write: (refine) => {
      by.value = refine?.by ?? "";
      coarsest.value = String(refine?.coarsest ?? "");
      margin.checked = Boolean(refine?.margin);
      show();
    },
  };
}

const CYCLES = 12; // plate periods of the cycles that a ramp can begin on

/** Each cell from rest, or a ramp: each cell from the final state of the one before, the first from rest or on a cycle. */
export function protocolField() {
  const kind = h("select", { "data-field": "protocol", onchange: () => show() }, Object.entries(PROTOCOLS).map(([value, text]) => h("option", { value }, text)));
  const axis = h("select", { "data-field": "protocol.axis" }, AXES.map((value) => h("option", { value }, SYMBOL[value])));
  const along = h("label", {}, h("span", {}, "along"), axis);
  const start = h("select", { "data-field": "protocol.start" }, h("option", { value: "" }, "from rest"),
    Array.from({ length: CYCLES }, (_, i) => h("option", { value: i + 1 }, `on the stable cycle (1, ${i + 1})`)));
  const begins = h("label", {}, h("span", {}, "first cell"), start);
  const show = () => { along.hidden = begins.hidden = kind.value === "rest"; };
  const ramp = () => ({ kind: "ramp", axis: axis.value, direction: kind.value, ...(start.value && { start: { periods: Number(start.value) } }) });
  return {
    element: h("fieldset", { "data-group": "protocol" }, h("legend", {}, "Protocol"), h("label", {}, h("span", {}, "cells start"), kind), along, begins),
    read: () => (kind.value === "rest" ? { kind: "rest" } : ramp()),
    write: (protocol = { kind: "rest" }) => {
      kind.value = protocol.kind === "rest" ? "rest" : protocol.direction;
      axis.value = protocol.axis ?? "gamma";
      start.value = String(protocol.start?.periods ?? "");
      show();
    },
  };
}
