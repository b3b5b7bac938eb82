// The fields of a sweep that are no axes: plain numbers, how cells start, the contact.

import { numeric } from "./axis-field.js";
import { h } from "../lib/dom.js";
import { SYMBOL } from "../lib/physics.js";

/** One input of its own. */
export function plainField(name, label, about, given = {}) {
  const text = given.type === "text";
  const input = h("input", { type: "text", inputmode: text ? "text" : "decimal", autocomplete: "off", size: 8, "data-field": name, ...given });
  const element = h("label", { className: "plain" }, h("span", {}, label), input, h("small", {}, about));
  return {
    element,
    read: () => (text ? input.value : numeric(input.value)),
    write: (value) => { input.value = String(value); },
  };
}

const STARTS = { rest: "every cell from rest", up: "ramp up", down: "ramp down", both: "ramp up, then down" };

/** Every cell from rest, or the state carried from cell to cell. */
export function protocolField() {
  const kind = h("select", { "data-field": "protocol", onchange: () => show() }, Object.entries(STARTS).map(([value, text]) => h("option", { value }, text)));
  const axis = h("select", { "data-field": "protocol.axis" }, Object.entries(SYMBOL).map(([value, text]) => h("option", { value }, text)));
  const along = h("label", {}, h("span", {}, "along"), axis);
  const element = h("fieldset", { "data-group": "protocol" }, h("legend", {}, "Start"), h("label", {}, h("span", {}, "cells start"), kind), along);
  const show = () => { along.hidden = kind.value === "rest"; };
  return {
    element,
    read: () => (kind.value === "rest" ? { kind: "rest" } : { kind: "ramp", axis: axis.value, direction: kind.value }),
    write: (protocol) => {
      kind.value = protocol.kind === "rest" ? "rest" : protocol.direction;
      axis.value = protocol.axis ?? "gamma";
      show();
    },
  };
}

const MODELS = {
  soft: ["soft: spring–dashpot contact, exact", ["restitution", "penetration", "rest_length", "adhesive"]],
  rigid: ["rigid: ideal plate", ["restitution"]],
  stepped: ["stepped: soft by time steps, as in the paper", ["restitution", "penetration", "rest_length", "adhesive", "steps_per_contact", "scheme"]],
  ball: ["ball: one mass, no spring", ["restitution"]],
  auto: ["auto: the cheapest within a tolerance of soft", ["restitution", "penetration", "rest_length", "adhesive", "tolerance"]],
};

const LABELS = {
  restitution: ["restitution", "of an isolated impact, 0 to 1; empty: the usual"],
  penetration: ["depth", "of the contact, plate amplitudes; empty: 0.001"],
  rest_length: ["rest length", "in place of the depth; mostly empty"],
  steps_per_contact: ["steps a contact", "empty: 20"],
  tolerance: ["tolerance", "rad of flight time; empty: 0.001"],
};

/** The contact model and the fields that it has. */
export function modelField() {
  const kind = h("select", { "data-field": "model.kind", onchange: () => show() }, Object.entries(MODELS).map(([value, [text]]) => h("option", { value }, text)));
  const adhesive = h("input", { type: "checkbox", "data-field": "model.adhesive", checked: true });
  const scheme = h("select", { "data-field": "model.scheme" }, ["verlet", "euler"].map((value) => h("option", { value }, value)));
  const inputs = Object.fromEntries(Object.keys(LABELS).map((name) => [name, h("input", { type: "text", inputmode: "decimal", autocomplete: "off", size: 8, "data-field": `model.${name}` })]));
  const labels = {
    ...Object.fromEntries(Object.entries(LABELS).map(([name, [title, about]]) => [name, h("label", { className: "plain" }, h("span", {}, title), inputs[name], h("small", {}, about))])),
    adhesive: h("label", { className: "check" }, adhesive, " the contact may pull (adhesive)"),
    scheme: h("label", {}, h("span", {}, "scheme"), scheme),
  };
  const element = h("fieldset", { "data-group": "model" }, h("legend", {}, "Contact"), h("label", {}, h("span", {}, "model"), kind), Object.values(labels));
  const fields = () => MODELS[kind.value][1];
  const show = () => Object.entries(labels).forEach(([name, label]) => { label.hidden = !fields().includes(name); });

  const read = () => {
    const model = { kind: kind.value };
    for (const name of fields()) {
      if (name === "adhesive") model.adhesive = adhesive.checked;
      else if (name === "scheme") model.scheme = scheme.value;
      else if (inputs[name].value.trim() !== "") model[name] = numeric(inputs[name].value);
    }
    return model;
  };
  const write = (model) => {
    kind.value = model.kind;
    for (const [name, input] of Object.entries(inputs)) input.value = model[name] ?? "";
    adhesive.checked = model.adhesive ?? true;
    scheme.value = model.scheme ?? "verlet";
    show();
  };
  return { element, read, write };
}
