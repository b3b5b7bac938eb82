// Colours: the theme of the style sheet, the directions of a sweep, and the modes of a map.

import { LABEL, OUTCOME, outcomeText } from "../lib/physics.js";

const DARK = "(prefers-color-scheme: dark)";
const PROPERTIES = ["surface", "text", "muted", "border", "up", "down", "single", "threshold", "branch", "cursor", "lower-mass"];
const SERIF = "'STIX Two Text', 'Iowan Old Style', Palatino, Georgia, 'DejaVu Serif', serif";
const themes = new Map();

/** The style sheet's colours and font for drawing, of the current colour scheme. */
export function theme() {
  const dark = matchMedia(DARK).matches;
  if (!themes.has(dark)) {
    const style = getComputedStyle(document.documentElement);
    const colours = PROPERTIES.map((name) => [name, style.getPropertyValue(`--${name}`).match(/#\w+/g)[Number(dark)]]); // light-dark(a, b)
    themes.set(dark, { ...Object.fromEntries(colours), dark, serif: SERIF });
  }
  return themes.get(dark);
}

// Of attractors by their number, as in the service's pictures (Okabe and Ito).
const ATTRACTORS = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#666666"];

/** The colour of the attractor of a cell with this number, from 1; repeated beyond the eighth. */
export const attractorColour = (id) => ATTRACTORS[(id - 1) % ATTRACTORS.length];

/** Attractors of a plane with a colour of their own; the others share one. */
export const COLOURED = ATTRACTORS.length - 1;

// Blues that differ from each other and from a dark background.
const ON_DARK = { "#0072b2": "#2f8be0", "#56b4e9": "#9bd7f7" };

/** The colour of the attractor, or compared sweep, with this number from 1, in a dark or light scheme. */
export function branchColour(id, dark) {
  if (id > COLOURED) return "#999999";
  return (dark && ON_DARK[ATTRACTORS[id - 1]]) || ATTRACTORS[id - 1];
}

export function onThemeChange(listener, signal) {
  matchMedia(DARK).addEventListener("change", listener, { signal });
}

/** The colour of one direction of a sweep. */
export const directionColour = (direction, theme) => theme[direction === "rest" ? "single" : direction];

// Modes. The hue is the number of plate periods; lighter than the middle shade are fewer bounces than periods, darker
// are more. The hues are those of Okabe and Ito, which colour-blind readers can tell apart. Cells of one colour form a
// class: a small integer, either an outcome code or FIRST plus an index of hue and shade.

const HUES = [
  ["#9fd3f5", "#3d9bd6", "#0b5f96"], // 1 period
  ["#f8cd7a", "#e69f00", "#a36c00"], // 2
  ["#8fd8c0", "#009e73", "#00644a"], // 3
  ["#efc1da", "#cc79a7", "#8e3f6b"], // 4
  ["#f7ef9a", "#e2d21f", "#97890a"], // 5
];
const MORE_PERIODS = "#6b6459";

const OUTCOME_COLOURS = { // [light scheme, dark scheme]
  [OUTCOME.aperiodic]: ["#27221e", "#000000"],
  [OUTCOME.atRest]: ["#ece8e0", "#4a5058"],
  [OUTCOME.unresolved]: ["#d55e00", "#d55e00"],
  [OUTCOME.diverged]: ["#d55e00", "#d55e00"],
  [OUTCOME.settling]: ["#b7aed0", "#716794"],
  [LABEL.quasiPeriodic]: ["#5e3c99", "#9a7fd1"],
  [LABEL.chaotic]: ["#7a1f2b", "#5c1520"],
  [LABEL.unstable]: ["#c2185b", "#e0559a"],
  [OUTCOME.missing]: ["#ffffff", "#16181b"],
};

const SHADES = 3;
const FIRST = 10; // the class of the first shade of the first hue; codes of outcomes and labels are below
const LONG = FIRST + SHADES * HUES.length;
const CLASSES = LONG + 1;
/** Order of the legend: at rest, modes by period, the cells without a mode, the rest. */
const ORDER = [OUTCOME.atRest, ...Array.from({ length: CLASSES - FIRST }, (_, i) => FIRST + i),
  LABEL.unstable, LABEL.quasiPeriodic, LABEL.chaotic, OUTCOME.aperiodic, OUTCOME.settling, OUTCOME.unresolved, OUTCOME.diverged, OUTCOME.missing];

function classOf(label, bounces, periods) {
  if (label !== OUTCOME.periodic) return label;
  return periods > HUES.length ? LONG : FIRST + SHADES * (periods - 1) + 1 + Math.sign(bounces - periods);
}

/**
 * Classes of cells by colour: {ofCell: Uint8Array, present: [{id, name, cells}, …]}, `present` in legend order.
 */
export function modeClasses({ outcome, label: labels = outcome, bounces, periods }) {
  const ofCell = new Uint8Array(labels.length);
  const cells = new Uint32Array(CLASSES);
  const minBounces = new Int32Array(CLASSES).fill(2 ** 30);
  const maxBounces = new Int32Array(CLASSES);
  for (let i = 0; i < ofCell.length; i++) {
    const id = classOf(labels[i], bounces[i], periods[i]);
    ofCell[i] = id;
    cells[id]++;
    if (bounces[i] < minBounces[id]) minBounces[id] = bounces[i];
    if (bounces[i] > maxBounces[id]) maxBounces[id] = bounces[i];
  }
  const present = ORDER.filter((id) => cells[id]);
  return { ofCell, present: present.map((id) => ({ id, name: className(id, minBounces[id], maxBounces[id]), cells: cells[id] })) };
}

function className(id, minBounces, maxBounces) {
  if (id < FIRST) return outcomeText(id).replace(" on the plate", "");
  if (id === LONG) return `over ${HUES.length} periods`;
  const periods = Math.floor((id - FIRST) / SHADES) + 1;
  return `(${minBounces === maxBounces ? minBounces : `${minBounces}–${maxBounces}`}, ${periods})`;
}

/** The colour of a class of cells. */
export function modeColour(id, dark) {
  if (id < FIRST) return OUTCOME_COLOURS[id][dark ? 1 : 0];
  return id === LONG ? MORE_PERIODS : HUES[Math.floor((id - FIRST) / SHADES)][(id - FIRST) % SHADES];
}
