// What a new study can be made of: kinds, fields and contact models from the API's schema, and presets to start from.

import { requestJson } from "../lib/api.js";

/** Kinds of study in their order, and the fields that a form begins with where the API's example is not meant for it. */
const SWEEP = { gamma: { start: 0.5, stop: 6, num: 551 }, omega: 0.5, xi: 0.26 };
const PLANE = { gamma: { start: 0.1, stop: 5, num: 197 }, omega: { start: 0.3, stop: 1.7, num: 141 }, xi: 0.05, model: { kind: "rigid" } };
const KINDS = {
  rest: ["Sweep: every cell from rest", SWEEP],
  ramp: ["Ramp: each cell from the one before", { ...SWEEP, protocol: { axis: "gamma", direction: "both" } }],
  map: ["Adaptive map: dense only where it changes", { ...PLANE, refine: { by: "mode" } }],
  exponents: ["Lyapunov exponents, every cell from rest", { ...SWEEP, exponents: 1 }],
  basin: ["Basins: where each start of a cell leads"],
  multistability: ["Multistability: all attractors of a grid"],
  orbits: ["Cycles in closed form, stable and unstable"],
};
/** Kinds of the form whose protocol is "rest". */
export const OF_REST = ["rest", "map", "exponents"];
/** Fields that a kind does not have, though its specification can. */
const WITHOUT = { rest: ["refine", "exponents"], ramp: ["refine"], exponents: ["refine"] };

export function kindOf({ protocol: { kind = "rest" } = {}, refine, exponents }) {
  if (kind === "rest" && refine) return "map";
  return kind === "rest" && exponents ? "exponents" : kind;
}

/** The studies that the API declares: {kind: {title, begin, fields, parts, models}, …}. `fields` are {settle: {title,
 * about, default, type, choices (of an enum), parts (of an object, its fields)}, …}, `parts` those of the protocol,
 * `models` [{kind, about, fields}, …], `begin` the specification that a form begins with. New ones need no change here. */
export async function loadStudies() {
  const { schemas } = (await requestJson("/openapi.json")).components;
  const resolve = (schema) => (schema.$ref ? schemas[schema.$ref.split("/").pop()] : schema);
  const alternatives = (schema) => (schema.oneOf ?? schema.anyOf ?? [schema]).map(resolve);
  const fieldOf = (name, schema) => {
    const { type, enum: choices, title = name, description = "", default: initial, "x-default": shown } = { ...resolve(schema), ...schema };
    const optional = schema.anyOf?.find((alternative) => alternative.enum)?.enum; // a choice that may be left open
    const parts = alternatives(schema).find(({ properties }) => properties)?.properties;
    return {
      title: title.replace(/[A-Z]/g, (letter) => letter.toLowerCase()), about: description.replace(/\.$/, ""),
      default: initial ?? shown ?? null, type, choices: choices ?? (optional && ["", ...optional]), parts: parts && fieldsOf(parts),
    };
  };
  const fieldsOf = (properties) => Object.fromEntries(Object.entries(properties)
    .filter(([, schema]) => !("const" in schema)).map(([name, schema]) => [name, fieldOf(name, schema)]));
  const modelOf = ({ properties, description = "" }) =>
    ({ kind: properties.kind.const, about: firstClause(description), fields: fieldsOf(properties) });
  const studiesOf = ({ properties: { protocol, parent, ...own }, description, examples = [{}] }) => {
    const fields = Object.entries(fieldsOf(own));
    const models = own.model && alternatives(own.model).map(modelOf).sort((a, b) => (b.kind === "auto") - (a.kind === "auto"));
    const studyOf = (kind, parts) => {
      const [title = firstClause(description), begin = examples[0]] = KINDS[kind] ?? [];
      const kept = fields.filter(([name]) => !WITHOUT[kind]?.includes(name));
      return [kind, { title, begin, fields: Object.fromEntries(kept), parts: fieldsOf(parts), models }];
    };
    return alternatives(protocol).flatMap(({ properties: parts }) =>
      (parts.kind.const === "rest" ? OF_REST : [parts.kind.const]).map((kind) => studyOf(kind, parts)));
  };
  const studies = Object.values(schemas).filter(({ properties }) => properties?.protocol && properties.xi).flatMap(studiesOf);
  const order = (kind) => (Object.keys(KINDS).indexOf(kind) + 100) % 100; // unknown kinds last
  return Object.fromEntries(studies.sort(([a], [b]) => order(a) - order(b)));
}

/** "Ideal plate (no penetration); restitution 0 sticks." → "ideal plate" */
function firstClause(description) {
  const clause = description.replace(/\s*\([^)]*\)|`/g, "").split(/[;:\n]|\.(?:\s|$)/)[0].trim();
  return clause.charAt(0).toLowerCase() + clause.slice(1);
}

/** The sweeps of the paper's figures: [{title, sweeps: [{key: "7", or "7.2" of the second sweep of a figure, spec, text}, …]}, …]. */
export async function loadPresets() {
  return (await requestJson("/v1/figures")).map(({ number, title, sweeps }) => ({
    title: `Fig. ${number}: ${title}`,
    sweeps: sweeps.map((spec, i) => {
      const variant = spec.name.split(", ").slice(1).join(", "); // of "figure 7, hardly settled"
      return { spec, key: i ? `${number}.${i + 1}` : String(number), text: `Fig. ${number}: ${variant || title}` };
    }),
  }));
}
