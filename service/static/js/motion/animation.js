// The masses, the spring and the plate at one instant, at the heights of the plot beside them.

import { theme } from "../plot/colours.js";
import { disc, polyline, resizedContext } from "../plot/drawing.js";
import { scale } from "../plot/scale.js";

const RADIUS = 11; // of a mass, px
const COILS = 9;

/** Draw the `heights` of height-plot.js at `phase` on a canvas as high as the plot beside it. */
export function drawInstant(canvas, heights, phase, height) {
  const width = canvas.clientWidth;
  const ctx = resizedContext(canvas, width, height);
  const colours = theme();
  const y = scale(heights.low, heights.high, height - 46, 12).pixel; // the margins of the plot
  const { plate, lower, upper, inFlight } = heights.at(phase);
  const middle = width / 2;
  drawPlate(ctx, middle, y(plate), width, colours);
  if (lower === null) return;
  // The height of a mass is that of its lower edge, so that contact with the plate is visible.
  const lowerY = y(lower) - RADIUS;
  const upperY = heights.isBall ? lowerY : Math.min(y(upper) - RADIUS, lowerY - 2 * RADIUS - 4);
  if (!heights.isBall) {
    drawSpring(ctx, middle, lowerY - RADIUS, upperY + RADIUS, colours);
    disc(ctx, colours.up, middle, upperY, RADIUS);
  }
  disc(ctx, colours["lower-mass"], middle, lowerY, RADIUS);
  ctx.fillStyle = colours.muted;
  ctx.font = `italic ${Math.min(13, width / 6.5)}px ${colours.serif}`;
  ctx.textAlign = "center";
  ctx.fillText(inFlight ? "in flight" : "on the plate", middle, height - 8);
}

function drawPlate(ctx, middle, y, width, colours) {
  const half = Math.min(width / 2 - 8, 60);
  ctx.fillStyle = colours.text;
  ctx.fillRect(middle - half, y, 2 * half, 5);
  ctx.fillRect(middle - 2, y, 4, 26);
}

function drawSpring(ctx, x, from, to, colours) {
  const points = [[x, from]];
  const straight = (to - from) * 0.08; // at each end
  for (let i = 0; i <= COILS * 2; i++) {
    const fraction = (i + 0.5) / (COILS * 2 + 1);
    points.push([x + (i % 2 ? 8 : -8), from + straight + (to - from - 2 * straight) * fraction]);
  }
  points.push([x, to]);
  polyline(ctx, colours.muted, 1.6, points);
}
