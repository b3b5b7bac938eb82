// The motion of a cell in the plane: the return map of its flights, and the phase portrait of the spring.

import { h } from "../lib/dom.js";
import { plural } from "../lib/format.js";
import { TWO_PI } from "../lib/physics.js";
import { disc, polyline } from "../plot/drawing.js";
import { Plot } from "../plot/plot.js";
import { extent } from "../plot/scale.js";

/** Shorter flights are neither on the map nor listed; rad. */
export const MIN_FLIGHT = 1e-3;
const MARGIN = 0.06; // of the range, on each side
const MIN_RANGE = 0.2; // rad, of the return map: a cycle of one flight is one point in its middle
const SAME = 2e-3; // rad: points of the map this near to each other are counted as one

export class Portraits {
  flights = null; // flight times in order
  trajectory = null;

  constructor(signal) {
    const [map, portrait] = [h("figure", {}), h("figure", {})];
    this.mapNote = h("p", { className: "note" });
    this.element = h("div", { className: "portraits" },
      h("div", {}, h("h3", {}, "Return map"), map, this.mapNote),
      h("div", {}, h("h3", {}, "Phase portrait"), portrait, h("p", { className: "note" }, "Dots: once per plate period.")));

    this.map = new Plot(map, { signal, takesInput: false, label: "Return map: each flight time over the one before", content: () => this.flights && returnMap(this.flights) });
    this.portrait = new Plot(portrait, { signal, takesInput: false, label: "Phase portrait: velocity of the spring’s elongation over its elongation", content: () => this.trajectory && phasePortrait(this.trajectory) });
  }

  /** `flights`: of many plate periods; `trajectory`: of a few, finely sampled. Either may come later than the other. */
  show({ flights = this.flights, trajectory = this.trajectory }) {
    this.flights = flights && flights.filter((time) => time > MIN_FLIGHT);
    this.trajectory = trajectory;
    this.mapNote.textContent = this.flights?.length > 1 ? mapText(this.flights) : "";
    this.map.draw();
    this.portrait.draw();
  }
}

const pairsOf = (flights) => flights.slice(1).map((time, i) => [flights[i], time]);

function mapText(flights) {
  const points = new Set(pairsOf(flights).map((pair) => pair.map((time) => Math.round(time / SAME)).join()));
  return `${plural(points.size, "point")} of ${plural(flights.length - 1, "pair")} of flights.`;
}

function returnMap(flights) {
  const points = pairsOf(flights);
  const missing = Math.max(0, MIN_RANGE - (Math.max(...flights) - Math.min(...flights))) / 2;
  const [low, high] = flights.length ? widened(Math.min(...flights) - missing, Math.max(...flights) + missing) : [0, TWO_PI];
  const axis = (label) => ({ label, low, high });
  return {
    x: axis("flight φₙ (rad)"), y: axis("next φₙ₊₁ (rad)"),
    message: points.length ? null : "No two flights in a row",
    layers: [
      (ctx, box) => polyline(ctx, box.theme.border, 1, pixels(box, [[low, low], [high, high]])),
      (ctx, box) => pixels(box, points).forEach(([x, y]) => disc(ctx, box.theme["upper-mass"], x, y, 2.4)),
    ],
  };
}

/** The elongation of the spring and its velocity, interrupted where an impact changes it, and once per plate period a dot. */
function phasePortrait({ model, phase, z1, z2, velocity, in_flight: flies, takeoff, flights, rest_length: rest }) {
  const points = model === "ball" ? [] : phase.map((_, i) => [z1[i] - z2[i] - rest, velocity[i]]);
  const isKnown = (point) => point.every(Number.isFinite);
  const known = points.filter(isKnown);
  const step = phase[1] - phase[0];
  const met = new Set(takeoff.flatMap((time, i) => [time, time + flights[i]]).map((time) => Math.ceil(time / step))); // contacts between samples, too
  const line = points.flatMap((point, i) => (flies[i - 1] && (!flies[i] || met.has(i)) ? [null, point] : [point])).map((point) => point && (isKnown(point) ? point : null));
  const section = points.filter((point, i) => isKnown(point) && i % Math.round(TWO_PI / step) === 0);
  const range = (values) => (values.length ? widened(Math.min(...values), Math.max(...values)) : [-1, 1]);
  const [[x0, x1], [y0, y1]] = [range(known.map(([x]) => x)), range(known.map(([, y]) => y))];
  return {
    x: { label: "elongation / A", low: x0, high: x1 }, y: { label: "velocity / (Aω)", low: y0, high: y1 },
    message: known.length ? null : "A ball has no spring",
    layers: [
      (ctx, box) => polyline(ctx, box.theme["upper-mass"], 1.4, pixels(box, line)),
      (ctx, box) => pixels(box, section).forEach(([x, y]) => disc(ctx, box.theme.cursor, x, y, 3.4)),
    ],
  };
}

const pixels = (box, points) => points.map((point) => point && [box.x.pixel(point[0]), box.y.pixel(point[1])]);

function widened(low, high) {
  const [a, b] = extent(low, high);
  return [a - MARGIN * (b - a), b + MARGIN * (b - a)];
}
