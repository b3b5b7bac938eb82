// The spatio-temporal diagram of the paper's Fig. 2 (a–d): the spring in grey above the plate.

import { TURN } from "../lib/physics.js";
import { area, stroke, upright } from "../plot/drawing.js";

const ROOM = 0.06; // of the height, above and below

/** What to draw of a trajectory, its spring drawn at a length that can be looked at. */
export function traceOf(path) {
  const ball = path.model.kind === "ball";
  const length = ball ? 0 : drawnLength(path);
  const lower = path.z2;
  const upper = path.z1.map((z1, i) => (z1 === null ? null : ball ? lower[i] : z1 - path.rest_length + length));
  const heights = [...path.plate, ...lower, ...upper].filter((value) => value !== null);
  const [low, high] = [Math.min(...heights), Math.max(...heights)];
  const trace = {
    ball, length, phase: path.phase, plate: path.plate, lower, upper, flying: path.in_flight,
    low: low - ROOM * (high - low) - 0.4, high: high + ROOM * (high - low) + 0.4,
  };
  trace.content = (now) => content(trace, now);
  trace.at = (phase) => at(trace, phase);
  return trace;
}

/** The model does not say how long the spring is: as long as the service says, or so that its ends stay apart. */
function drawnLength({ z1, z2, rest_length: rest }) {
  const shortest = Math.min(...z1.map((one, i) => (one === null ? 0 : one - rest - z2[i])));
  const least = Math.max(2, 1 - 1.3 * shortest);
  return Math.min(Math.max(rest, least), Math.max(least, 6));
}

function content(trace, now) {
  const { phase, plate, lower, upper } = trace;
  const periods = phase.map((one) => one / TURN);
  const path = (box, values) => values.map((value, i) => [box.x.place(periods[i]), box.y.place(value ?? NaN)]).filter(([, y]) => Number.isFinite(y));
  return {
    x: { label: "time (plate periods)", low: 0, high: periods[periods.length - 1] },
    y: { label: "height / A", low: trace.low, high: trace.high },
    layers: [
      (pen, box) => {
        const below = path(box, plate);
        area(pen, box.theme.ink, [...below, [box.left + box.width, box.top + box.height], [box.left, box.top + box.height]], box.theme.dark ? 0.62 : 0.85);
        stroke(pen, box.theme.ink, 1.5, below);
      },
      (pen, box) => {
        if (!trace.ball) area(pen, box.theme.soft, [...path(box, upper), ...path(box, lower).reverse()], box.theme.dark ? 0.25 : 0.35);
        stroke(pen, box.theme.up, 1.6, path(box, upper));
        stroke(pen, box.theme.mass, 1.6, path(box, lower));
      },
    ],
    cursor: (pen, box) => upright(pen, box, box.x.place(now() / TURN), box.theme.cursor),
  };
}

/** Heights at a phase, between two samples; null beyond where the motion could be followed. */
function at({ phase, plate, lower, upper, flying }, now) {
  const step = phase[1] - phase[0];
  const i = Math.min(Math.floor(now / step), phase.length - 2);
  const part = Math.min(Math.max((now - phase[i]) / step, 0), 1);
  const between = (values) => (values[i] === null || values[i + 1] === null ? null : values[i] + part * (values[i + 1] - values[i]));
  return { plate: between(plate), lower: between(lower), upper: between(upper), flying: flying[i] };
}
