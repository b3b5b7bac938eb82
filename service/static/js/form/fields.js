// The fields of the form. Each is {element, read(), write(value)} with values as a specification has them; read()
// gives null, and write() takes undefined, for the default.

import { h } from "../lib/dom.js";
import { numberIn, plural } from "../lib/format.js";
import { MEANING, SYMBOL, axisText, axisValues } from "../lib/physics.js";

/** Texts of choices, where their names are not enough. */
const CHOICES = {
  axis: SYMBOL,
  direction: { both: "up, then down" },
  by: { mode: "where the mode changes", bouncing: "where bouncing begins" },
  plane: { drop: "drops: heights and phases", contact: "in contact: elongations and velocities" },
  effort: { "": "as in Recording" },
};

/** Values above these are remarked on; of longer axes nothing is said. */
const USUAL = { gamma: 20, omega: 10, xi: 2 };
const MOST_VALUES = 1e5;
export const COMMA = /(?<![\d.]|e[-+−]?)\d+,\d+(?![\d.])/i; // of a decimal, or of two values; not in 0.5,0.6 or 1e-3,2
const NUMBER_INPUT = { type: "text", inputmode: "decimal", autocomplete: "off", size: 8 };
const TEXT_INPUT = { inputmode: "text", maxlength: 200, size: 32 };

/** Typed text as a number; as it is where it is none, for the service to refuse; null where it is empty. */
const parseNumber = (text) => (Number.isFinite(numberIn(text)) ? numberIn(text) : text.trim() || null);

const options = (texts) => Object.entries(texts).map(([value, text]) => h("option", { value }, text));
const labelled = (text, control) => h("label", {}, h("span", {}, text), control);

/** A number, a list, a choice, a check box or a text of the schema; an empty number or list means the default, which is its placeholder. */
export function schemaField(name, { title, about, type, choices, default: initial }, id = name) {
  const input = (attributes) => h("input", { ...NUMBER_INPUT, ...attributes, "data-field": id });
  const placeholder = [initial ?? ""].flat().join(", ");
  const field = (control, read, write) =>
    ({ element: h("label", { className: "plain" }, h("span", {}, title), control, h("small", {}, about)), read, write });
  // Of another control the default is shown as any other value.
  const shown = (control, property) => field(control, () => (control[property] === (initial ?? "") ? null : control[property]),
    (value) => { control[property] = value ?? initial ?? choices?.[0] ?? ""; });

  if (choices) return shown(h("select", { "data-field": id }, choices.map((value) => h("option", { value }, CHOICES[name]?.[value] ?? value))), "value");
  if (type === "boolean") return shown(h("input", { type: "checkbox", "data-field": id }), "checked");
  if (type === "string") return shown(input(TEXT_INPUT), "value");
  const isList = type === "array";
  const control = input({ ...(isList && TEXT_INPUT), placeholder });
  const read = () => (isList ? control.value.match(/[^,;\s]+/g) : parseNumber(control.value));
  return field(control, read, (value) => { control.value = [value ?? ""].flat().join(", "); });
}

/** An object's fields, `parts` of the schema, under a heading; of an object among them, its last number. Its value begins with `fixed`. */
export function objectField(name, heading, about, parts, fixed = {}) {
  const fields = Object.entries(parts).map(([key, schema]) => {
    const inner = Object.keys(schema.parts ?? {}).at(-1);
    const field = schemaField(key, inner ? { ...schema.parts[inner], default: null } : schema, `${name}.${key}`);
    if (!inner) return [key, field];
    const read = () => (field.read() === null ? null : { [inner]: field.read() });
    return [key, { ...field, read, write: (value) => field.write(value?.[inner]) }];
  });
  const elements = fields.map(([, { element }]) => element);
  return {
    elements,
    element: h("fieldset", { "data-group": name, hidden: !fields.length }, h("legend", {}, heading, h("small", {}, about)), elements),
    read: () => ({ ...fixed, ...Object.fromEntries(fields.map(([key, { read }]) => [key, read()]).filter(([, value]) => value !== null)) }),
    write: (value) => fields.forEach(([key, { write }]) => write(value?.[key])),
  };
}

/** The contact model and its parameters; `models` as in catalogue.js. Another model takes over what is typed, where it has it. */
export function modelField(models, { kind: initial }) {
  const options = models.map((model) => h("option", { value: model.kind }, `${model.kind}: ${model.about}`));
  const select = h("select", { "data-field": "model.kind", onchange: () => write({ ...parameters.read(), kind: select.value }) }, options);
  const element = h("fieldset", { "data-group": "model" }, h("legend", {}, "Contact"), labelled("contact model", select));
  let parameters; // of the model shown
  const write = (value = { kind: initial }) => {
    const { kind, fields } = models.find((model) => model.kind === value.kind);
    select.value = kind;
    parameters?.elements.forEach((parameter) => parameter.remove());
    parameters = objectField("model", "Contact", "", fields, { kind });
    parameters.write(value);
    element.append(...parameters.elements);
  };
  return { element, read: () => parameters.read(), write };
}

export function axisField(axis) {
  const input = (name, attributes = {}) => h("input", { ...NUMBER_INPUT, "data-field": name, ...attributes });
  const kind = h("select", { onchange: () => show() }, options({ values: "values", range: "a range" }));
  const values = input(axis, { size: 24 });
  const range = { start: input(`${axis}.start`), stop: input(`${axis}.stop`), num: input(`${axis}.num`, { inputmode: "numeric" }) };
  const spacing = h("select", { "data-field": `${axis}.spacing` }, options({ linear: "linear", log: "log" }));
  const list = labelled("one value, or several separated by commas", values);
  const ofRange = [labelled("start", range.start), labelled("stop", range.stop), labelled("number of values", range.num), labelled("spacing", spacing)];
  const description = h("small", { className: "parsed", role: "status" });
  const legend = h("legend", {}, h("i", {}, SYMBOL[axis]), h("small", {}, MEANING[axis]));
  const read = () => {
    const limits = Object.fromEntries(Object.entries(range).map(([name, { value }]) => [name, parseNumber(value)]));
    if (kind.value === "range") return { ...limits, spacing: spacing.value };
    if (COMMA.test(values.value)) return values.value.trim(); // the service asks
    const numbers = values.value.split(/[,;\s]+/).filter(Boolean).map(parseNumber);
    return numbers.length === 1 ? numbers[0] : numbers;
  };
  const show = () => {
    list.hidden = kind.value !== "values";
    for (const element of ofRange) element.hidden = kind.value === "values";
    description.textContent = describeAxis(axis, read());
  };
  const write = (value = []) => {
    kind.value = typeof value === "number" || Array.isArray(value) ? "values" : "range";
    if (kind.value === "values") values.value = [value].flat().join(", ");
    for (const [name, control] of Object.entries(range)) control.value = String(value[name] ?? "");
    spacing.value = value.spacing ?? "linear";
    show();
  };
  const element = h("fieldset", { "data-group": axis, oninput: show }, legend, labelled("given as", kind), list, ofRange, description);
  return { element, read, write };
}

/** What was understood of an axis, where it is several values, and whether some are far above those of studies. */
function describeAxis(axis, value) {
  const typed = typeof value === "object" && !Array.isArray(value) ? [value.start, value.stop, value.num] : [value].flat();
  if (!typed.length || !typed.every(Number.isFinite) || value.num > MOST_VALUES) return "";
  const values = axisValues(value);
  const shown = values.slice(0, 3).map((item) => axisText(item, values)).join(", ") + (values.length > 3 ? ` … ${axisText(values.at(-1), values)}` : "");
  const text = values.length > 1 && `${plural(values.length, "value")}: ${shown}`;
  return [text, Math.max(...values) > USUAL[axis] && `unusual: studies have ${SYMBOL[axis]} up to ${USUAL[axis]}`].filter(Boolean).join("; ");
}
