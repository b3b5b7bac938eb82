// Colours of modes: the hue says how many plate periods; lighter are fewer bounces than that, darker are more.
//
// Hues are those of Okabe and Ito, which colour-blind people tell apart; the legend and the readout say it in words.

import { OUTCOME, modeText } from "./physics.js";

const HUES = [
  ["#9fd3f5", "#3d9bd6", "#0b5f96"], // 1 period
  ["#f8cd7a", "#e69f00", "#a36c00"], // 2
  ["#8fd8c0", "#009e73", "#00644a"], // 3
  ["#efc1da", "#cc79a7", "#8e3f6b"], // 4
  ["#f7ef9a", "#e2d21f", "#97890a"], // 5
];
const LONGER = ["#cfc6ba", "#a59a8c", "#6e655a"];

const OTHERS = {
  [OUTCOME.aperiodic]: ["#27221e", "#000000"],
  [OUTCOME.atRest]: ["#ece8e0", "#4a5058"],
  [OUTCOME.unresolved]: ["#d55e00", "#d55e00"],
  [OUTCOME.diverged]: ["#d55e00", "#d55e00"],
  [OUTCOME.missing]: ["#ffffff", "#16181b"],
};

/** The colour of a cell. */
export function colour(outcome, bounces, periods, dark) {
  if (outcome !== OUTCOME.periodic) return OTHERS[outcome][dark ? 1 : 0];
  const shades = HUES[periods - 1] ?? LONGER;
  return shades[1 + Math.sign(bounces - periods)];
}

/** A number for what became of a cell, the same for all that look the same in the legend. */
export const kind = (outcome, bounces, periods) =>
  outcome === OUTCOME.periodic ? (Math.min(periods, 999) << 12) | (Math.min(bounces, 4095) & 4095) : -1 - outcome;

export function partsOf(key) {
  return key < 0 ? [-1 - key, 0, 0] : [OUTCOME.periodic, key & 4095, key >> 12];
}

/** The kinds of cells that there are, the simplest first: [[key, cells], …]. */
export function kinds({ outcome, bounces, periods }) {
  const found = new Map();
  for (let i = 0; i < outcome.length; i++) {
    const key = kind(outcome[i], bounces[i], periods[i]);
    found.set(key, (found.get(key) ?? 0) + 1);
  }
  return [...found].sort(([one], [two]) => one - two);
}

export const nameOf = (key) => modeText(...partsOf(key)).replace("mode ", "").replace(" on the plate", "");
