// What a new sweep can be made of: contact models and defaults from the API's schema, and presets to start from.

import { requestJson } from "../lib/api.js";

/** Requests `path` once for the life of the page; after an error, the next call requests it again. */
function cachedRequest(path) {
  let response = null;
  return () => {
    response ??= requestJson(path).catch((error) => {
      response = null;
      throw error;
    });
    return response;
  };
}

const loadOpenApi = cachedRequest("/openapi.json");
const loadFigures = cachedRequest("/v1/figures");

/**
 * The form's view of a specification: {fields: {settle: {title, about, default, type, choices (of an enum)}, …},
 * models: [{kind, about, fields}, …]}.
 *
 * Fields and contact models are those of the API's schema: a new one appears in the form without any change to the
 * page. TEXTS in fields.js can give it a symbol and unit; without, its title and description in the schema are shown.
 */
export async function loadSchema() {
  const { schemas } = (await loadOpenApi()).components;
  const resolve = (schema) => (schema.$ref ? schemas[schema.$ref.split("/").pop()] : schema);
  const fieldsOf = (properties) => Object.fromEntries(Object.entries(properties).map(([name, schema]) => {
    const { type, enum: choices, title = name, description = "", default: own, "x-default": shown } = { ...resolve(schema), ...schema };
    const optional = schema.anyOf?.find((each) => each.enum)?.enum; // a choice that may be left open
    return [name, { title: title.toLowerCase(), about: description.replace(/\.$/, ""), default: own ?? shown ?? null, type, choices: choices ?? (optional && ["", ...optional]) }];
  }));
  const { properties } = schemas.SweepSpec;
  const models = (properties.model.oneOf ?? properties.model.anyOf).map(resolve).map(({ description = "", properties: { kind, ...own } }) =>
    ({ kind: kind.const, about: firstClause(description), fields: fieldsOf(own) }));
  return { fields: fieldsOf(properties), models };
}

/** "Ideal plate (no penetration); restitution 0 sticks." → "ideal plate" */
function firstClause(description) {
  const clause = description.replace(/\s*\([^)]*\)|`/g, "").split(/[;:\n]|\.(?:\s|$)/)[0].trim();
  return clause.charAt(0).toLowerCase() + clause.slice(1);
}

/** What a sweep of a figure is: the figure's title, or how the sweep differs: "figure 7, hardly settled" → "hardly settled". */
function variant({ name }, title) {
  const [, ...words] = name.split(", ");
  return words.join(", ") || title;
}

const MODE_MAP = {
  number: "map", label: "Mode map", title: "Γ–Ω plane at ξ = 0.05",
  sweeps: [{
    name: "mode map", gamma: { start: 0.1, stop: 5, num: 197 }, omega: { start: 0.3, stop: 1.7, num: 141 }, xi: 0.05,
    model: { kind: "rigid" }, keep: 48,
  }],
};

/**
 * The sweeps of the paper's figures and one more: [{label, title, sweeps: [{key, spec, text}, …]}, …]. `key` is the value
 * of `figure` in an address: "7", or "7.2" for the second sweep of a figure.
 */
export async function loadPresets() {
  const figures = (await loadFigures()).map((figure) => ({ ...figure, label: `Fig. ${figure.number}` }));
  return [...figures, MODE_MAP].map(({ number, label, title, sweeps }) => ({
    label, title,
    sweeps: sweeps.map((spec, i) => ({ spec, key: i ? `${number}.${i + 1}` : String(number), text: `${label}: ${variant(spec, title)}` })),
  }));
}
