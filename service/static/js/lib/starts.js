// Starts of a motion other than a cell's own: their names in addresses, in place of a direction.

const NUMBERS = { cycle: ["periods", "flight_time"], drop: ["height", "phase"], contact: ["elongation", "velocity"], attractor: ["number"] };

/** The name of a start: on a cycle ("cycle", its plate periods, its flight time), with a drop, in contact, on an attractor. */
export const startName = (kind, ...values) => [kind, ...values.map((value) => Number(value.toPrecision(12)))].join(":");

/** The start of such a name, as trajectories take it; null for a direction. */
export function startOf(name) {
  const [kind, ...values] = name.split(":");
  const fields = NUMBERS[kind];
  return fields && values.length === fields.length ? { kind, ...Object.fromEntries(fields.map((field, i) => [field, Number(values[i])])) } : null;
}
