// The masses, the spring and the plate at one instant, at the heights of the trace beside them.

import { disc, stroke } from "../plot/drawing.js";
import { fit } from "../plot/plot.js";
import { scale } from "../plot/scale.js";
import { theme } from "../plot/theme.js";

const RADIUS = 11;
const COILS = 9;

/** Draw `trace` at `phase` on a canvas as high as the plot beside it. */
export function drawStage(canvas, trace, phase, height) {
  const width = canvas.clientWidth;
  const pen = fit(canvas, width, height);
  const colours = theme();
  const y = scale(trace.low, trace.high, height - 46, 12).place;
  const { plate, lower, upper, flying } = trace.at(phase);
  const middle = width / 2;
  drawPlate(pen, middle, y(plate), width, colours);
  if (lower === null) return;
  // A mass stands on its lower edge, so that what touches the plate is seen to.
  const low = y(lower) - RADIUS;
  const high = trace.ball ? low : Math.min(y(upper) - RADIUS, low - 2 * RADIUS - 4);
  if (!trace.ball) {
    drawSpring(pen, middle, low - RADIUS, high + RADIUS, colours);
    disc(pen, colours.up, middle, high, RADIUS);
  }
  disc(pen, colours.mass, middle, low, RADIUS);
  pen.fillStyle = colours.soft;
  pen.font = `italic ${Math.min(13, width / 6.5)}px ${colours.serif}`;
  pen.textAlign = "center";
  pen.fillText(flying ? "in flight" : "on the plate", middle, height - 8);
}

function drawPlate(pen, middle, y, width, colours) {
  const half = Math.min(width / 2 - 8, 60);
  pen.fillStyle = colours.ink;
  pen.fillRect(middle - half, y, 2 * half, 5);
  pen.fillRect(middle - 2, y, 4, 26);
}

function drawSpring(pen, x, from, to, colours) {
  const points = [[x, from]];
  const lead = (to - from) * 0.08;
  for (let i = 0; i <= COILS * 2; i++) {
    const part = (i + 0.5) / (COILS * 2 + 1);
    points.push([x + (i % 2 ? 8 : -8), from + lead + (to - from - 2 * lead) * part]);
  }
  points.push([x, to]);
  stroke(pen, colours.soft, 1.6, points);
}
