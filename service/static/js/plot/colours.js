// Colours: the theme of the style sheet, and the meanings of `palette.json`, which the service's pictures have too.

import palette from "../../palette.json" with { type: "json" };
import { LABEL_NAMES, OUTCOME, outcomeText } from "../lib/physics.js";

const DARK = "screen and (prefers-color-scheme: dark)"; // paper is white
const PROPERTIES = ["surface", "text", "muted", "border", ...Object.keys(palette.lines)];

for (const [name, [light, dark]] of Object.entries(palette.lines)) document.documentElement.style.setProperty(`--${name}`, `light-dark(${light}, ${dark})`);

const style = getComputedStyle(document.documentElement);
const colourOf = (name, dark) => style.getPropertyValue(`--${name}`).match(/#\w+/g)[Number(dark)]; // light-dark(a, b)
const THEMES = [false, true].map((dark) => ({ ...Object.fromEntries(PROPERTIES.map((name) => [name, colourOf(name, dark)])), dark, serif: style.getPropertyValue("--serif") }));

/** The style sheet's colours and font for drawing, of the current colour scheme. */
export const theme = () => THEMES[Number(matchMedia(DARK).matches)];

/** Attractors of a plane with a colour of their own; the others share one. */
export const COLOURED = palette.attractors.length;

/** The colour of the attractor of a map, or compared sweep, with this number from 1. */
export const numberedColour = (id, dark) => (palette.attractors[id - 1] ?? palette.other_attractors)[Number(dark)];

/** The colour of the attractor of a basin with this number from 1: there colours are used again. */
export const attractorColour = (id, dark) => numberedColour(((id - 1) % COLOURED) + 1, dark);

export const onThemeChange = (listener, signal) => matchMedia(DARK).addEventListener("change", listener, { signal });

// The hue of a mode is its number of plate periods; lighter shades have fewer bounces than periods, darker ones more.
// Cells of one colour form a class: an outcome code, or FIRST plus an index of hue and shade.

const HUES = palette.periods;
const SHADES = [["<", "fewer"], ["", "equal"], [">", "more"]];
const MARGINS = [0.2, 0.4, 0.6, 0.8, 0.95, 1];
/** Of each class its name, which does not depend on its cells, its colours, light and dark, and how queries name it. */
const CLASSES = [
  ...LABEL_NAMES.map((query, code) => ({ name: outcomeText(code)?.replace(" on the plate", ""), colours: palette.labels[query], query })),
  // "(<2, 2)" are modes of two periods with fewer bounces.
  ...HUES.flatMap((shades, i) => SHADES.map(([sign, query], k) => ({ name: `(${sign}${i + 1}, ${i + 1})`, colours: [shades[k], shades[k]], query: `${i + 1}-${query}` }))),
  { name: `over ${HUES.length} periods`, colours: palette.longer, query: "longer" },
  // Certified cells by the modulus of their multiplier, up to these.
  ...MARGINS.map((margin, i) => ({ name: `|μ| ${MARGINS[i - 1] ?? 0} to ${margin}`, colours: [palette.margins[i], palette.margins[i]], query: `multiplier-${margin}` })),
];
const FIRST = LABEL_NAMES.length; // the class of the first shade of the first hue
const MARGIN = CLASSES.length - MARGINS.length; // the first class of certified cells
/** Order of the legend: at rest, modes by period, the cells without a mode, the rest. */
const ORDER = [OUTCOME.atRest, ...Array.from({ length: CLASSES.length - FIRST }, (_, i) => FIRST + i),
  ...["unstable", "quasi-periodic", "chaotic", "aperiodic", "settling", "unresolved", "diverged", "missing"].map((name) => LABEL_NAMES.indexOf(name))];

function classOf(label, bounces, periods, multiplier) {
  if (Number.isFinite(multiplier)) return MARGIN + MARGINS.findIndex((margin) => multiplier < margin);
  if (label !== OUTCOME.periodic) return label;
  return periods > HUES.length ? MARGIN - 1 : FIRST + SHADES.length * (periods - 1) + 1 + Math.sign(bounces - periods);
}

/** Classes of cells by colour, by their multipliers if those are given: {ofCell: Uint8Array, present: [{id, name}, …]}, `present` in legend order. */
export function modeClasses({ outcome, label: labels = outcome, bounces, periods, multiplier }) {
  const [ofCell, isPresent] = [new Uint8Array(labels.length), new Uint8Array(CLASSES.length)];
  for (let i = 0; i < ofCell.length; i++) {
    ofCell[i] = classOf(labels[i], bounces[i], periods[i], multiplier?.[i]);
    isPresent[ofCell[i]] = 1;
  }
  return { ofCell, present: ORDER.filter((id) => isPresent[id]).map((id) => ({ id, name: CLASSES[id].name })) };
}

/** How queries of the service name a class; null where they have no name for it. */
export const classQuery = (id) => CLASSES[id]?.query ?? null;
export const modeColour = (id, dark) => CLASSES[id].colours[Number(dark)];
