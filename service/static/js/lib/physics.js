// The few words and the one formula that the page knows by itself.

export const SYMBOL = { gamma: "Γ", omega: "Ω", xi: "ξ" };

export const MEANING = {
  gamma: "plate acceleration over gravity",
  omega: "plate frequency over the spring's own",
  xi: "damping of the spring",
};

export const TURN = 2 * Math.PI;

export const OUTCOME = { missing: 0, periodic: 1, aperiodic: 2, atRest: 3, unresolved: 4, diverged: 5 };

/** Eq. 25: the Γ at which a spring at rest on the plate begins to bounce. */
export function threshold(omega, xi) {
  const [w, x] = [omega ** 2, xi ** 2];
  return 2 * Math.sqrt(((1 - w) ** 2 + 4 * x * w) / ((2 - w) ** 2 + 16 * x * w));
}

/** The values of an axis as a specification writes it: a number, a list, or a range. */
export function axisValues(axis) {
  if (typeof axis === "number") return [axis];
  if (Array.isArray(axis)) return axis;
  const { start, stop, num, spacing } = axis;
  if (num === 1) return [start];
  const log = spacing === "log";
  const [from, to] = log ? [Math.log(start), Math.log(stop)] : [start, stop];
  return Array.from({ length: num }, (_, i) => {
    if (i === 0) return start;
    if (i === num - 1) return stop;
    const value = from + ((to - from) * i) / (num - 1);
    return log ? Math.exp(value) : value;
  });
}

export const isLog = (axis) => axis?.spacing === "log";

/** The index of the value nearest to `wanted`; values increase. */
export function nearest(values, wanted) {
  let [low, high] = [0, values.length - 1];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (values[middle] <= wanted) low = middle;
    else high = middle;
  }
  return wanted - values[low] <= values[high] - wanted ? low : high;
}

/** The value of an axis nearest to the one that an address asks for, or the middle one. */
export function startOf(values, asked) {
  const wanted = asked === undefined ? NaN : Number(asked);
  return values[Number.isFinite(wanted) ? nearest(values, wanted) : values.length >> 1];
}

/** Whether two values are the same but for how they were written. */
export const same = (one, two) => Math.abs(one - two) <= 1e-8 * Math.max(Math.abs(one), Math.abs(two));

/** The directions of a sweep, as the service names them. */
export function directionsOf({ protocol }) {
  if (protocol.kind === "rest") return ["rest"];
  return protocol.direction === "both" ? ["up", "down"] : [protocol.direction];
}

/** What became of a cell, in words. */
export function modeText(outcome, bounces, periods) {
  switch (outcome) {
    case OUTCOME.periodic:
      return `mode (${bounces}, ${periods})`;
    case OUTCOME.aperiodic:
      return "aperiodic";
    case OUTCOME.atRest:
      return "at rest on the plate";
    case OUTCOME.unresolved:
      return "unresolved";
    case OUTCOME.diverged:
      return "diverged";
    default:
      return "not computed yet";
  }
}
