// Playback of a trajectory: the animated spring, its heights over time as in the paper's Fig. 2 (a–d), and the controls.

import { choice, h } from "../lib/dom.js";
import { TWO_PI, clamp } from "../lib/physics.js";
import { disc, polygon, polyline, resizedContext, verticalLine } from "../plot/drawing.js";
import { Plot } from "../plot/plot.js";

const SECONDS_PER_PERIOD = 1.6; // at full speed
const SPEEDS = [1, 0.5, 0.25, 0.1];
const RADIUS = 11; // of a mass, px
const COILS = 9;
const MARGIN = 0.06; // of the height range, above and below
const LENGTH = 6; // of the spring at rest, plate amplitudes
export const periodsOf = ({ phase }) => Math.round(phase.at(-1) / TWO_PI);

export class Player {
  heights = null; // of the trajectory
  phase = 0; // rad since the first sample
  speed = 1;
  playing = !matchMedia("(prefers-reduced-motion: reduce)").matches;

  constructor(signal) {
    this.canvas = h("canvas", { className: "animation", role: "img", "aria-label": "Animation of the masses, the spring and the plate" });
    const figure = h("figure", { className: "heights" });
    this.button = h("button", { type: "button", onclick: () => this.play(!this.playing) });
    this.position = h("input", {
      type: "range", min: 0, max: 1, step: 0.005, value: 0, "aria-label": "Plate periods since the first sample",
      oninput: () => {
        this.play(false);
        this.phase = this.position.valueAsNumber * TWO_PI;
        this.#draw();
      },
    });
    const speeds = choice("Speed", SPEEDS.map((speed) => [speed, `× ${speed}`]), 1, (speed) => { this.speed = Number(speed); });
    this.element = h("div", { className: "player" },
      h("div", { className: "instant" }, this.canvas, figure),
      h("div", { className: "controls" }, this.button, speeds, this.position));
    this.plot = new Plot(figure, {
      signal, takesInput: false, label: "Heights of the masses and the plate over plate periods",
      content: () => this.heights && contentOf(this.heights),
      drawMark: (ctx, box) => verticalLine(ctx, box, box.x.pixel(this.phase / TWO_PI), box.theme.cursor),
    });
    this.plot.element.addEventListener("drawn", () => this.#draw());
  }

  show(trajectory) {
    this.heights = heightsOf(trajectory);
    this.position.max = String(this.heights.periods);
    this.phase %= this.heights.periods * TWO_PI;
    this.plot.draw();
    this.play(this.playing);
  }

  play(on) {
    this.playing = on;
    this.button.textContent = on ? "Pause" : "Play";
    this.stop();
    if (!on) return;
    let previous = performance.now();
    const step = (now) => {
      this.phase = (this.phase + (Math.max(0, now - previous) / 1000 / SECONDS_PER_PERIOD) * TWO_PI * this.speed) % (this.heights.periods * TWO_PI);
      previous = now;
      this.#draw();
      this.frame = requestAnimationFrame(step);
    };
    this.frame = requestAnimationFrame(step);
  }

  stop() {
    cancelAnimationFrame(this.frame);
  }

  #draw() {
    if (!this.plot.box || !this.heights) return;
    drawInstant(this.canvas, this.heights, this.phase, this.plot);
    this.plot.drawCursor();
    this.position.value = String(this.phase / TWO_PI);
    this.element.dataset.phase = this.phase.toFixed(3);
  }
}

/** Draw `heights` at `phase` on a canvas as high as the plot beside it, in its scale and colours. */
function drawInstant(canvas, heights, phase, { canvas: { clientHeight: height }, box: { y: { pixel: y }, theme: colours } }) {
  const width = canvas.clientWidth;
  const ctx = resizedContext(canvas, width, height);
  const { plate, lower, upper, inFlight } = heightsAt(heights, phase);
  const middle = width / 2;
  const half = Math.min(width / 2 - 8, 60); // of the plate
  ctx.fillStyle = colours.text;
  ctx.fillRect(middle - half, y(plate), 2 * half, 5);
  ctx.fillRect(middle - 2, y(plate), 4, 26);
  if (Number.isNaN(lower)) return;
  // The height of a mass is that of its lower edge, so that contact with the plate is visible; at the top it stays in view.
  const lowerY = Math.max(RADIUS + 1, y(lower) - RADIUS);
  const upperY = heights.isBall ? lowerY : Math.max(RADIUS + 1, Math.min(y(upper) - RADIUS, lowerY - 2 * RADIUS - 4));
  if (!heights.isBall) {
    drawSpring(ctx, middle, lowerY - RADIUS, upperY + RADIUS, colours);
    disc(ctx, colours["upper-mass"], middle, upperY, RADIUS);
  }
  disc(ctx, colours["lower-mass"], middle, lowerY, RADIUS);
  ctx.fillStyle = colours.muted;
  ctx.font = `italic ${Math.min(13, width / 6.5)}px ${colours.serif}`;
  ctx.textAlign = "center";
  ctx.fillText(inFlight ? "in flight" : "on the plate", middle, height - 8);
}

function drawSpring(ctx, x, from, to, colours) {
  const straight = (to - from) * 0.08; // at each end
  const step = (to - from - 2 * straight) / (2 * COILS + 1);
  const coils = Array.from({ length: 2 * COILS + 1 }, (_, i) => [x + (i % 2 ? 8 : -8), from + straight + (i + 0.5) * step]);
  polyline(ctx, colours.muted, 1.6, [[x, from], ...coils, [x, to]]);
}

/** The heights of a trajectory to draw, in plate amplitudes, and the ends of their axis. */
function heightsOf(trajectory) {
  const { phase, plate, z1, z2: lower, in_flight: inFlight, rest_length: rest } = trajectory;
  const isBall = trajectory.model === "ball";
  const compression = -Math.min(...z1.map((height, i) => height - rest - lower[i]).filter(Number.isFinite));
  const length = isBall ? 0 : Math.max(LENGTH, 1 + 1.3 * compression); // the motion does not depend on it; its ends do not cross
  const upper = isBall ? lower : z1.map((height) => height - rest + length);
  const values = [...plate, ...lower, ...upper].filter(Number.isFinite);
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const margin = MARGIN * (high - low) + 0.4;
  return { isBall, phase, periods: periodsOf(trajectory), plate, lower, upper, inFlight, low: low - margin, high: high + margin };
}

function contentOf(heights) {
  const { phase, plate, lower, upper, isBall } = heights;
  const periods = phase.map((value) => value / TWO_PI);
  const points = (box, values) => values.map((value, i) => [box.x.pixel(periods[i]), box.y.pixel(value)]).filter(([, y]) => Number.isFinite(y));
  return {
    x: { label: "plate periods", low: 0, high: periods[periods.length - 1] },
    y: { label: "height / A", low: heights.low, high: heights.high },
    layers: [
      (ctx, box) => {
        const [surface, bottom] = [points(box, plate), box.top + box.height];
        polygon(ctx, box.theme.text, [...surface, [box.left + box.width, bottom], [box.left, bottom]], box.theme.dark ? 0.62 : 0.85);
        polyline(ctx, box.theme.text, 1.5, surface);
      },
      (ctx, box) => {
        if (!isBall) polygon(ctx, box.theme.muted, [...points(box, upper), ...points(box, lower).reverse()], box.theme.dark ? 0.25 : 0.35);
        polyline(ctx, box.theme["upper-mass"], 1.6, points(box, upper));
        polyline(ctx, box.theme["lower-mass"], 1.6, points(box, lower));
      },
    ],
  };
}

/** Heights at a phase, linear between two samples; NaN after the end of the computed trajectory. */
function heightsAt({ phase, plate, lower, upper, inFlight }, current) {
  const step = phase[1] - phase[0];
  const i = Math.min(Math.floor(current / step), phase.length - 2);
  const fraction = clamp((current - phase[i]) / step, 0, 1);
  const between = (values) => values[i] + fraction * (values[i + 1] - values[i]);
  return { plate: between(plate), lower: between(lower), upper: between(upper), inFlight: inFlight[i] };
}
