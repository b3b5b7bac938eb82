// The fields of the form. Each is {element, read(), write(value)} with values as a specification has them; read()
// gives null, and write() takes undefined, for the default.

import { h } from "../lib/dom.js";
import { number, plural } from "../lib/format.js";
import { SYMBOL, axisValues, meaningOf } from "../lib/physics.js";

/** Texts of choices, where their names are not enough. */
const CHOICES = {
  axis: SYMBOL,
  direction: { both: "up, then down" },
  by: { mode: "where the mode changes", bouncing: "where bouncing begins" },
  plane: { drop: "drops: heights and phases", contact: "in contact: elongations and velocities" },
  effort: { "": "as set below" },
};

/** Values above these are remarked on; of longer axes nothing is said. */
const USUAL = { gamma: 20, omega: 10, xi: 2 };
const MOST_VALUES = 1e5;

const NUMBER_INPUT = { type: "text", inputmode: "decimal", autocomplete: "off", size: 8 };

/** Typed text as a number; as it is where it is none, for the service to refuse; null where it is empty. */
function parseNumber(text) {
  const trimmed = text.trim().replace("−", "-");
  if (trimmed === "") return null;
  return Number.isFinite(Number(trimmed)) ? Number(trimmed) : trimmed;
}

const options = (texts) => Object.entries(texts).map(([value, text]) => h("option", { value }, text));
const labelled = (text, control) => h("label", {}, h("span", {}, text), control);

/** A check box, a choice, a text, a list or a number of the schema; an empty input means the default, which is its placeholder. */
export function schemaField(name, { title, about, type, choices, default: initial }, id = name) {
  const isList = type === "array";
  const isNumber = type !== "boolean" && type !== "string" && !choices && !isList;
  const control = choices ? h("select", { "data-field": id }, choices.map((value) => h("option", { value }, CHOICES[name]?.[value] ?? value)))
    : type === "boolean" ? h("input", { type: "checkbox", "data-field": id })
    : h("input", { ...NUMBER_INPUT, ...(isNumber ? {} : { inputmode: "text", maxlength: 200, size: 32 }), "data-field": id });
  const property = type === "boolean" ? "checked" : "value";
  if (isNumber || isList) control.placeholder = [initial ?? ""].flat().join(", ");
  return {
    element: h("label", { className: "plain" }, h("span", {}, title), control, h("small", {}, about)),
    read: () => (isList ? (control.value.match(/[^,;\s]+/g) ?? null) : isNumber ? parseNumber(control.value) : control[property] === (initial ?? "") ? null : control[property]),
    write: (value) => { control[property] = isNumber ? String(value ?? "") : isList ? (value ?? []).join(", ") : (value ?? initial ?? choices?.[0] ?? ""); },
  };
}

/** An object's fields, `parts` of the schema, under a heading; of an object among them, its last number. It begins with `fixed`. */
export function objectField(name, heading, about, parts, fixed = {}) {
  const fields = Object.entries(parts).map(([key, part]) => {
    const inner = Object.keys(part.parts ?? {}).at(-1);
    const field = schemaField(key, inner ? { ...part.parts[inner], default: null } : part, `${name}.${key}`);
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
  const select = h("select", { "data-field": "model.kind", onchange: () => write({ ...field.read(), kind: select.value }) }, options);
  const element = h("fieldset", { "data-group": "model" }, h("legend", {}, "Contact"), labelled("contact model", select));
  let field; // the parameters of the model shown
  const write = (model = { kind: initial }) => {
    const { kind, fields } = models.find((each) => each.kind === model.kind);
    select.value = kind;
    field?.elements.forEach((each) => each.remove());
    field = objectField("model", "Contact", "", fields, { kind });
    field.write(model);
    element.append(...field.elements);
  };
  return { element, read: () => field.read(), write };
}

/** One axis: a value or several, or a range. */
export function axisField(axis) {
  const input = (field, attributes = {}) => h("input", { ...NUMBER_INPUT, "data-field": field, ...attributes });
  const kind = h("select", { onchange: () => show() }, options({ values: "values", range: "a range" }));
  const values = input(axis, { size: 24 });
  const range = { start: input(`${axis}.start`), stop: input(`${axis}.stop`), num: input(`${axis}.num`, { inputmode: "numeric" }) };
  const spacing = h("select", { "data-field": `${axis}.spacing` }, options({ linear: "linear", log: "log" }));
  const list = labelled("one value, or several separated by commas", values);
  const parts = [labelled("start", range.start), labelled("stop", range.stop), labelled("number of values", range.num), labelled("spacing", spacing)];
  const said = h("small", { className: "parsed", role: "status" });
  const show = () => {
    list.hidden = kind.value !== "values";
    for (const part of parts) part.hidden = kind.value === "values";
    said.textContent = describeAxis(axis, field.read());
  };
  const field = {
    element: h("fieldset", { "data-group": axis, oninput: () => show() }, h("legend", {}, h("i", {}, SYMBOL[axis]), h("small", {}, meaningOf(axis))), labelled("given as", kind), list, parts, said),
    read: () => {
      if (kind.value === "range") return { ...Object.fromEntries(Object.entries(range).map(([name, part]) => [name, parseNumber(part.value)])), spacing: spacing.value };
      if (/\d,\d/.test(values.value)) return values.value.trim(); // a decimal comma, or two values: the service asks
      const numbers = values.value.split(/[,;\s]+/).filter(Boolean).map(parseNumber);
      return numbers.length === 1 ? numbers[0] : numbers;
    },
    write: (value = []) => {
      kind.value = typeof value === "number" || Array.isArray(value) ? "values" : "range";
      if (kind.value === "values") values.value = [value].flat().join(", ");
      for (const [name, part] of Object.entries(range)) part.value = String(value[name] ?? "");
      spacing.value = value.spacing ?? "linear";
      show();
    },
  };
  return field;
}

/** What was understood of an axis, where it is several values, and whether some are far above those of studies. */
function describeAxis(axis, value) {
  const given = typeof value === "object" && !Array.isArray(value) ? [value.start, value.stop, value.num] : [value].flat();
  if (!given.length || !given.every(Number.isFinite) || value.num > MOST_VALUES) return "";
  const values = axisValues(value);
  const text = values.length > 1 ? `${plural(values.length, "value")}: ${values.slice(0, 3).map((each) => number(each)).join(", ")}${values.length > 3 ? ` … ${number(values.at(-1))}` : ""}` : "";
  return [text, Math.max(...values) > USUAL[axis] && `unusual: studies have ${SYMBOL[axis]} up to ${USUAL[axis]}`].filter(Boolean).join("; ");
}
