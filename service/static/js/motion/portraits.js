// The motion of a cell in the plane: the return map of its flights, and the phase portrait of the spring.

import { h } from "../lib/dom.js";
import { plural } from "../lib/format.js";
import { TWO_PI } from "../lib/physics.js";
import { disc, polyline } from "../plot/drawing.js";
import { Plot } from "../plot/plot.js";
import { extent } from "../plot/scale.js";

const MIN_FLIGHT = 1e-3; // rad: shorter flights are left out of the map
const MARGIN = 0.06; // of the range, on each side
const MIN_RANGE = 0.2; // rad, of the return map: a cycle of one flight is one point in its middle
const SAME = 2e-3; // rad: points of the map this near to each other are one

/** A return map and a phase portrait side by side. */
export class Portraits {
  flights = null; // flight times in order
  trajectory = null;

  constructor(root) {
    const [map, portrait] = [h("figure", {}), h("figure", {})];
    this.mapNote = h("p", { className: "note" });
    this.element = h("div", { className: "portraits" },
      h("div", {}, h("h3", {}, "Return map"), map, this.mapNote),
      h("div", {}, h("h3", {}, "Phase portrait"), portrait, h("p", { className: "note" }, "Line: the spring over the plate periods shown. Dots: the Poincaré section, once per plate period.")));
    root.append(this.element);
    this.map = new Plot(map, { label: "Return map: each flight time over the one before", content: () => this.flights && returnMap(this.flights), ratio: 0.9, minHeight: 240 });
    this.portrait = new Plot(portrait, { label: "Phase portrait: velocity of the spring’s elongation over its elongation", content: () => this.trajectory && phasePortrait(this.trajectory), ratio: 0.9, minHeight: 240 });
  }

  /** `flights`: of many plate periods; `trajectory`: of a few, finely sampled. Either may come later than the other. */
  show({ flights = this.flights, trajectory = this.trajectory }) {
    this.flights = flights && flights.filter((time) => time > MIN_FLIGHT);
    this.trajectory = trajectory;
    if (this.flights) this.mapNote.textContent = mapText(this.flights);
    this.map.draw();
    this.portrait.draw();
  }

  /** Why there is no return map. */
  fail(error) {
    this.mapNote.textContent = error.message;
  }

  close() {
    this.map.close();
    this.portrait.close();
  }
}

/** The pairs of successive flights, (φₙ, φₙ₊₁). */
export const pairsOf = (flights) => flights.slice(1).map((time, i) => [flights[i], time]);

function mapText(flights) {
  if (flights.length < 2) return "The spring makes no two flights in a row.";
  const points = new Set(pairsOf(flights).map((pair) => pair.map((time) => Math.round(time / SAME)).join()));
  return `${plural(points.size, "point")} of ${plural(flights.length - 1, "pair")} of successive flights.`;
}

function returnMap(flights) {
  const pairs = pairsOf(flights);
  const [least, greatest] = [Math.min(...flights), Math.max(...flights)];
  const missing = Math.max(0, MIN_RANGE - (greatest - least)) / 2;
  const [low, high] = widened(least - missing, greatest + missing);
  const axis = (label) => ({ label, low: flights.length ? low : 0, high: flights.length ? high : TWO_PI });
  return {
    x: axis("flight time φₙ (rad)"), y: axis("next flight time φₙ₊₁ (rad)"),
    message: pairs.length ? null : "No two flights in a row",
    layers: [
      (ctx, box) => polyline(ctx, box.theme.border, 1, [[box.x.pixel(low), box.y.pixel(low)], [box.x.pixel(high), box.y.pixel(high)]]),
      (ctx, box) => pairs.forEach(([x, y]) => disc(ctx, box.theme.up, box.x.pixel(x), box.y.pixel(y), 2.4)),
    ],
  };
}

/** The elongation of the spring and its velocity, in plate amplitudes, and once per plate period a dot. */
function phasePortrait({ phase, z1, z2, rest_length: rest }) {
  const elongation = z1.map((value, i) => (value === null ? null : value - z2[i] - rest));
  const step = phase[1] - phase[0];
  const points = [];
  const section = [];
  const perPeriod = Math.round(TWO_PI / step);
  for (let i = 1; i < phase.length - 1; i++) {
    if (elongation[i - 1] === null || elongation[i + 1] === null) continue;
    const point = [elongation[i], (elongation[i + 1] - elongation[i - 1]) / (2 * step)];
    points.push(point);
    if (i % perPeriod === 0) section.push(point);
  }
  const range = (k) => widened(Math.min(...points.map((point) => point[k])), Math.max(...points.map((point) => point[k])));
  const [[x0, x1], [y0, y1]] = points.length ? [range(0), range(1)] : [[-1, 1], [-1, 1]];
  const pixels = (box, list) => list.map(([x, y]) => [box.x.pixel(x), box.y.pixel(y)]);
  return {
    x: { label: "elongation / A", low: x0, high: x1 }, y: { label: "velocity / (Aω)", low: y0, high: y1 },
    message: points.length ? null : "A ball has no spring",
    layers: [
      (ctx, box) => points.length && polyline(ctx, box.theme.up, 1.4, pixels(box, points)),
      (ctx, box) => pixels(box, section).forEach(([x, y]) => disc(ctx, box.theme.cursor, x, y, 3.4)),
    ],
  };
}

function widened(low, high) {
  const [a, b] = extent(low, high);
  return [a - MARGIN * (b - a), b + MARGIN * (b - a)];
}

