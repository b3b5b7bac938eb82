// The heights of plate and masses over time, as in the paper's Fig. 2 (a–d): the spring in grey above the plate.

import { TWO_PI } from "../lib/physics.js";
import { polygon, polyline, verticalLine } from "../plot/drawing.js";

const MARGIN = 0.06; // of the height range, above and below
const MIN_LENGTH = 2; // plate amplitudes
const MAX_LENGTH = 6;

/**
 * What to draw of a trajectory. Lengths are in plate amplitudes. `content(phase)` is for a Plot, where `phase()` is
 * the current phase; `at(phase)` gives the heights at a phase in rad.
 */
export function heightsOf(trajectory) {
  const isBall = trajectory.model === "ball";
  const length = isBall ? 0 : drawnLength(trajectory);
  const lower = trajectory.z2;
  const upper = isBall ? lower : trajectory.z1.map((z1) => z1 - trajectory.rest_length + length);
  const values = [...trajectory.plate, ...lower, ...upper].filter(Number.isFinite);
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const heights = {
    isBall, phase: trajectory.phase, plate: trajectory.plate, lower, upper, inFlight: trajectory.in_flight,
    low: low - MARGIN * (high - low) - 0.4, high: high + MARGIN * (high - low) + 0.4,
  };
  heights.content = (phase) => contentOf(heights, phase);
  heights.at = (phase) => interpolated(heights, phase);
  return heights;
}

/**
 * The length the spring is drawn with. The dynamics do not depend on the rest length, so it is the one of the
 * trajectory where that can be seen, and long enough for the ends not to cross.
 */
function drawnLength({ z1, z2, rest_length: rest }) {
  const maxCompression = -Math.min(...z1.map((value, i) => value - rest - z2[i]).filter(Number.isFinite));
  const minLength = Math.max(MIN_LENGTH, 1 + 1.3 * maxCompression);
  return Math.min(Math.max(rest, minLength), Math.max(minLength, MAX_LENGTH));
}

function contentOf(heights, currentPhase) {
  const { phase, plate, lower, upper, isBall } = heights;
  const periods = phase.map((value) => value / TWO_PI);
  const points = (box, values) => values.map((value, i) => [box.x.pixel(periods[i]), box.y.pixel(value)]).filter(([, y]) => Number.isFinite(y));
  return {
    x: { label: "time (plate periods)", low: 0, high: periods[periods.length - 1] },
    y: { label: "height / A", low: heights.low, high: heights.high },
    layers: [
      (ctx, box) => {
        const surface = points(box, plate);
        polygon(ctx, box.theme.text, [...surface, [box.left + box.width, box.top + box.height], [box.left, box.top + box.height]], box.theme.dark ? 0.62 : 0.85);
        polyline(ctx, box.theme.text, 1.5, surface);
      },
      (ctx, box) => {
        if (!isBall) polygon(ctx, box.theme.muted, [...points(box, upper), ...points(box, lower).reverse()], box.theme.dark ? 0.25 : 0.35);
        polyline(ctx, box.theme.up, 1.6, points(box, upper));
        polyline(ctx, box.theme["lower-mass"], 1.6, points(box, lower));
      },
    ],
    cursor: (ctx, box) => verticalLine(ctx, box, box.x.pixel(currentPhase() / TWO_PI), box.theme.cursor),
  };
}

/** Heights at a phase, linear between two samples; NaN after the end of the computed trajectory. */
function interpolated({ phase, plate, lower, upper, inFlight }, at) {
  const step = phase[1] - phase[0];
  const i = Math.min(Math.floor(at / step), phase.length - 2);
  const fraction = Math.min(Math.max((at - phase[i]) / step, 0), 1);
  const between = (values) => values[i] + fraction * (values[i + 1] - values[i]);
  return { plate: between(plate), lower: between(lower), upper: between(upper), inFlight: inFlight[i] };
}
