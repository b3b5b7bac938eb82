// The contact model and its parameters, as the API's schema describes them.

import { h } from "../lib/dom.js";
import { NUMBER_INPUT, parseNumber } from "./fields.js";

/** Label and explanation of known parameters; others have the title and description of the schema. */
const LABELS = {
  restitution: ["restitution e", "of an isolated impact, 0 to 1"],
  penetration: ["contact depth d", "plate amplitudes, unless a rest length is given"],
  rest_length: ["rest length Λ", "Lω₀²/g, instead of the depth"],
  adhesive: ["adhesive: the contact may pull", ""],
  steps_per_contact: ["steps per contact", "of the time integration"],
  scheme: ["scheme", ""],
  tolerance: ["tolerance", "rad of flight time"],
};

/** What an empty input means where the schema's default is null. */
const NULL_DEFAULTS = { penetration: "0.001", rest_length: "none", restitution: "f(ξ)" };

/** `models` and `defaultKind` as in catalogue.js. */
export function modelField(models, defaultKind) {
  const modelOf = (kind) => models.find((model) => model.kind === kind);
  const kind = h("select", { "data-field": "model.kind", onchange: () => show() },
    models.map((model) => h("option", { value: model.kind }, `${model.kind}: ${model.about}`)));
  // Models share the parameters of one name, so that a typed value stays when the model changes.
  const fields = new Map(models.flatMap((model) => model.fields).map((field) => [field.name, field]));
  const parameters = new Map([...fields.values()].map((field) => [field.name, parameter(field)]));

  const show = () => {
    for (const { element } of parameters.values()) element.hidden = true;
    for (const field of modelOf(kind.value).fields) {
      const { element, setDefault } = parameters.get(field.name);
      element.hidden = false;
      setDefault(field.default);
    }
  };
  const read = () => {
    const values = modelOf(kind.value).fields.map(({ name }) => [name, parameters.get(name).read()]);
    return { kind: kind.value, ...Object.fromEntries(values.filter(([, value]) => value !== null)) };
  };
  const write = (model = { kind: defaultKind }) => {
    kind.value = model.kind;
    for (const [name, { write: writeParameter }] of parameters) {
      writeParameter(model[name] ?? (fields.get(name).choices ? fields.get(name).default : null));
    }
    show();
  };
  const element = h("fieldset", { "data-group": "model" }, h("legend", {}, "Contact"),
    h("label", {}, h("span", {}, "contact model"), kind), [...parameters.values()].map((each) => each.element));
  return { element, read, write };
}

/** One parameter: a checkbox, a choice, or a number. */
function parameter({ name, title, about, choices }) {
  const [label, explanation] = LABELS[name] ?? [title, about];
  const field = `model.${name}`;
  if (typeof choices?.[0] === "boolean") {
    const box = h("input", { type: "checkbox", "data-field": field });
    return {
      element: h("label", { className: "check" }, box, ` ${label}`),
      read: () => box.checked, write: (value) => { box.checked = value; }, setDefault() {},
    };
  }
  if (choices) {
    const select = h("select", { "data-field": field }, choices.map((value) => h("option", { value }, value)));
    return {
      element: h("label", {}, h("span", {}, label), select),
      read: () => select.value, write: (value) => { select.value = value; }, setDefault() {},
    };
  }
  const input = h("input", { ...NUMBER_INPUT, "data-field": field });
  return {
    element: h("label", { className: "plain" }, h("span", {}, label), input, h("small", {}, explanation)),
    read: () => parseNumber(input.value),
    write: (value) => { input.value = value ?? ""; },
    setDefault: (value) => { input.placeholder = value === null ? (NULL_DEFAULTS[name] ?? "") : String(value); },
  };
}
