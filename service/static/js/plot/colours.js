// Colours of modes: the hue says how many plate periods; lighter are fewer bounces than that, darker are more.
//
// Hues are those of Okabe and Ito, which colour-blind people tell apart; the legend and the readout say it in words.
// All cells of one colour are one class, a small number: an outcome, or below it a hue and a shade.

import { OUTCOME, modeText } from "../lib/physics.js";

const HUES = [
  ["#9fd3f5", "#3d9bd6", "#0b5f96"], // 1 period
  ["#f8cd7a", "#e69f00", "#a36c00"], // 2
  ["#8fd8c0", "#009e73", "#00644a"], // 3
  ["#efc1da", "#cc79a7", "#8e3f6b"], // 4
  ["#f7ef9a", "#e2d21f", "#97890a"], // 5
];
const LONGER = "#6b6459";

const OTHERS = { // on light paper, on dark
  [OUTCOME.aperiodic]: ["#27221e", "#000000"],
  [OUTCOME.atRest]: ["#ece8e0", "#4a5058"],
  [OUTCOME.unresolved]: ["#d55e00", "#d55e00"],
  [OUTCOME.diverged]: ["#d55e00", "#d55e00"],
  [OUTCOME.missing]: ["#ffffff", "#16181b"],
};

const SHADES = 3;
const FIRST = 6; // class of the first shade of the first hue: the outcomes come before
const LONG = FIRST + SHADES * HUES.length;
const CLASSES = LONG + 1;
/** What is shown first in a legend: at rest, modes from the simplest on, aperiodic, the rest. */
const ORDER = [OUTCOME.atRest, ...Array.from({ length: CLASSES - FIRST }, (_, i) => FIRST + i),
  OUTCOME.aperiodic, OUTCOME.unresolved, OUTCOME.diverged, OUTCOME.missing];

function classOf(outcome, bounces, periods) {
  if (outcome !== OUTCOME.periodic) return outcome;
  return periods > HUES.length ? LONG : FIRST + SHADES * (periods - 1) + 1 + Math.sign(bounces - periods);
}

/** The class of every cell, and the classes that there are: {of: Uint8Array, found: [{kind, name, cells}, …]}. */
export function classes({ outcome, bounces, periods }) {
  const of = new Uint8Array(outcome.length);
  const cells = new Uint32Array(CLASSES);
  const fewest = new Int32Array(CLASSES).fill(2 ** 30);
  const most = new Int32Array(CLASSES);
  for (let i = 0; i < of.length; i++) {
    const kind = classOf(outcome[i], bounces[i], periods[i]);
    of[i] = kind;
    cells[kind]++;
    if (bounces[i] < fewest[kind]) fewest[kind] = bounces[i];
    if (bounces[i] > most[kind]) most[kind] = bounces[i];
  }
  const found = ORDER.filter((kind) => cells[kind]);
  return { of, found: found.map((kind) => ({ kind, name: nameOf(kind, fewest[kind], most[kind]), cells: cells[kind] })) };
}

function nameOf(kind, fewest, most) {
  if (kind < FIRST) return modeText(kind).replace(" on the plate", "");
  if (kind === LONG) return `over ${HUES.length} periods`;
  const periods = Math.floor((kind - FIRST) / SHADES) + 1;
  return `(${fewest === most ? fewest : `${fewest}–${most}`}, ${periods})`;
}

/** The colour of a class of cells. */
export function colour(kind, dark) {
  if (kind < FIRST) return OTHERS[kind][dark ? 1 : 0];
  return kind === LONG ? LONGER : HUES[Math.floor((kind - FIRST) / SHADES)][(kind - FIRST) % SHADES];
}
