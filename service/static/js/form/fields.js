// The fields of the form. Each is {element, read(), write(value)} with values as a specification has them; read()
// gives null, and write() takes undefined, for the default.

import { h } from "../lib/dom.js";
import { SYMBOL, meaningOf } from "../lib/physics.js";

/** Label and explanation of fields, where those of the schema are not enough. */
const TEXTS = {
  name: ["Name", "a label for the list of sweeps"],
  restitution: ["restitution e", "of an isolated impact, 0 to 1"],
  penetration: ["contact depth d", "plate amplitudes, unless a rest length is given"],
  rest_length: ["rest length Λ", "Lω₀²/g, instead of the depth"],
  adhesive: ["adhesive: the contact may pull", ""],
  steps_per_contact: ["steps per contact", "of the time integration"],
  events: ["take-off and landing", "located in a shortened step, or at the end of a plain one"],
  tolerance: ["tolerance", "rad of flight time"],
  exponents: ["Lyapunov exponents", "0 to 4; they tell quasi-periodic from chaotic cells"],
};

/** What an empty input means where the default is null. */
const NULL_DEFAULTS = { penetration: "0.001", rest_length: "none", restitution: "f(ξ)", until: "5000" };

const NUMBER_INPUT = { type: "text", inputmode: "decimal", autocomplete: "off", size: 8 };

/** Typed text as a number; as it is where it is none, for the service to refuse; null where it is empty. */
function parseNumber(text) {
  const trimmed = text.trim().replace("−", "-");
  if (trimmed === "") return null;
  return Number.isFinite(Number(trimmed)) ? Number(trimmed) : trimmed;
}

const options = (texts) => Object.entries(texts).map(([value, text]) => h("option", { value }, text));
const labelled = (text, control) => h("label", {}, h("span", {}, text), control);

/** A check box, a choice, a text or a number of the schema; an empty input means the default, which is its placeholder. */
export function schemaField(name, { title, about, type, choices, default: initial }, id = name) {
  const [label, explanation] = TEXTS[name] ?? [title, about];
  const isNumber = type !== "boolean" && type !== "string" && !choices;
  const control = choices ? h("select", { "data-field": id }, choices.map((value) => h("option", { value }, value)))
    : type === "boolean" ? h("input", { type: "checkbox", "data-field": id })
    : h("input", { ...NUMBER_INPUT, ...(isNumber ? {} : { inputmode: "text", maxlength: 200, size: 32 }), "data-field": id });
  const property = type === "boolean" ? "checked" : "value";
  const setDefault = (value) => { if (isNumber) control.placeholder = String(value ?? NULL_DEFAULTS[name] ?? ""); };
  setDefault(initial);
  return {
    element: h("label", { className: "plain" }, h("span", {}, label), control, h("small", {}, explanation)),
    read: () => (isNumber ? parseNumber(control.value) : control[property] === (initial ?? "") ? null : control[property]),
    write: (value) => { control[property] = isNumber ? String(value ?? "") : (value ?? initial ?? ""); },
    setDefault,
  };
}

/** The contact model and its parameters; `models` as in catalogue.js. */
export function modelField(models, { kind: defaultKind }) {
  const fieldsOf = (kind) => models.find((model) => model.kind === kind).fields;
  const kind = h("select", { "data-field": "model.kind", onchange: () => show() }, models.map((model) => h("option", { value: model.kind }, `${model.kind}: ${model.about}`)));
  // Models share the parameters of one name, so that a typed value stays when the model changes.
  const shared = Object.fromEntries(models.flatMap(({ fields }) => Object.entries(fields)));
  const parameters = Object.fromEntries(Object.entries(shared).map(([name, field]) => [name, schemaField(name, field, `model.${name}`)]));
  const show = () => {
    for (const [name, { element, setDefault }] of Object.entries(parameters)) {
      const field = fieldsOf(kind.value)[name];
      element.hidden = !field;
      if (field) setDefault(field.default);
    }
  };
  return {
    element: h("fieldset", { "data-group": "model" }, h("legend", {}, "Contact"),
      labelled("contact model", kind), Object.values(parameters).map((each) => each.element)),
    read: () => {
      const values = Object.keys(fieldsOf(kind.value)).map((name) => [name, parameters[name].read()]);
      return { kind: kind.value, ...Object.fromEntries(values.filter(([, value]) => value !== null)) };
    },
    write: (model = { kind: defaultKind }) => {
      kind.value = model.kind;
      for (const [name, { write }] of Object.entries(parameters)) write(model[name]);
      show();
    },
  };
}

const AXIS_DEFAULTS = { gamma: { start: 0.5, stop: 6, num: 551 }, omega: 0.5, xi: 0.26 }; // of the form: a specification has none

/** One axis: a value or several, or a range. */
export function axisField(axis) {
  const input = (field, attributes = {}) => h("input", { ...NUMBER_INPUT, "data-field": field, ...attributes });
  const kind = h("select", { onchange: () => show() }, options({ values: "values", range: "a range" }));
  const values = input(axis, { size: 24 });
  const range = { start: input(`${axis}.start`), stop: input(`${axis}.stop`), num: input(`${axis}.num`, { inputmode: "numeric" }) };
  const spacing = h("select", { "data-field": `${axis}.spacing` }, options({ linear: "linear", log: "log" }));
  const list = labelled("one value, or several separated by commas", values);
  const parts = [labelled("start", range.start), labelled("stop", range.stop), labelled("number of values", range.num), labelled("spacing", spacing)];
  const show = () => {
    list.hidden = kind.value !== "values";
    for (const part of parts) part.hidden = kind.value === "values";
  };
  return {
    element: h("fieldset", { "data-group": axis }, h("legend", {}, h("i", {}, SYMBOL[axis]), h("small", {}, meaningOf(axis))), labelled("given as", kind), list, parts),
    read: () => {
      if (kind.value === "range") return { ...Object.fromEntries(Object.entries(range).map(([name, part]) => [name, parseNumber(part.value)])), spacing: spacing.value };
      if (/\d,\d/.test(values.value)) return values.value.trim(); // a decimal comma, or two values: the service asks
      const numbers = values.value.split(/[,;\s]+/).filter(Boolean).map(parseNumber);
      return numbers.length === 1 ? numbers[0] : numbers;
    },
    write: (value = AXIS_DEFAULTS[axis]) => {
      kind.value = typeof value === "number" || Array.isArray(value) ? "values" : "range";
      if (kind.value === "values") values.value = [value].flat().join(", ");
      for (const [name, part] of Object.entries(range)) part.value = String(value[name] ?? "");
      spacing.value = value.spacing ?? "linear";
      show();
    },
  };
}

const REFINEMENTS = { "": "every cell", mode: "where the mode changes", bouncing: "where bouncing begins" };

/** Every cell, or an adaptive map: only the cells near which it changes. */
export function refineField() {
  const by = h("select", { "data-field": "refine", onchange: () => show() }, options(REFINEMENTS));
  const coarsest = h("input", { ...NUMBER_INPUT, inputmode: "numeric", "data-field": "refine.coarsest" });
  const blocks = labelled("first blocks, cells wide", coarsest);
  const show = () => {
    blocks.hidden = !by.value;
    coarsest.placeholder = by.value === "bouncing" ? "64" : "16";
  };
  return {
    element: h("fieldset", { "data-group": "refine" },
      h("legend", {}, "Cells", h("small", {}, "Skip cells inside regions of one mode; they are filled in")), labelled("compute", by), blocks),
    read: () => {
      const width = parseNumber(coarsest.value);
      return by.value ? { by: by.value, ...(width !== null && { coarsest: width }) } : null;
    },
    write: (refine) => {
      by.value = refine?.by ?? "";
      coarsest.value = String(refine?.coarsest ?? "");
      show();
    },
  };
}

const PROTOCOLS = { rest: "every cell from rest", up: "ramp up", down: "ramp down", both: "ramp up, then down" };
const CYCLES = 12; // plate periods of the cycles that a ramp can begin on

/** Each cell from rest, or a ramp: each cell from the final state of the one before, the first from rest or on a cycle. */
export function protocolField() {
  const kind = h("select", { "data-field": "protocol", onchange: () => show() }, options(PROTOCOLS));
  const axis = h("select", { "data-field": "protocol.axis" }, options(SYMBOL));
  const cycles = Array.from({ length: CYCLES }, (_, i) => h("option", { value: i + 1 }, `on the stable cycle (1, ${i + 1})`));
  const start = h("select", { "data-field": "protocol.start" }, options({ "": "from rest" }), cycles);
  const [along, begins] = [labelled("along", axis), labelled("first cell", start)];
  const show = () => { along.hidden = begins.hidden = kind.value === "rest"; };
  const ramp = () => ({ kind: "ramp", axis: axis.value, direction: kind.value, ...(start.value && { start: { periods: Number(start.value) } }) });
  return {
    element: h("fieldset", { "data-group": "protocol" }, h("legend", {}, "Protocol"), labelled("cells start", kind), along, begins),
    read: () => (kind.value === "rest" ? { kind: "rest" } : ramp()),
    write: (protocol = { kind: "rest" }) => {
      kind.value = protocol.kind === "rest" ? "rest" : protocol.direction;
      axis.value = protocol.axis ?? "gamma";
      start.value = String(protocol.start?.periods ?? "");
      show();
    },
  };
}
