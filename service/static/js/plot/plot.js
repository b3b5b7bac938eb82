// A framed plot: layers that draw between axes, and a second sheet for the cursor.

import { h } from "../lib/dom.js";
import { boxOf, drawFrame, drawHead, drawMessage, drawTurns } from "./frame.js";
import { clipped } from "./drawing.js";
import { onThemeChange, theme } from "./theme.js";

const OF_THE_WINDOW = 0.66; // no plot is higher than this part of the window

/**
 * `content()` says what to draw, null while there is nothing: {x: {label, low, high, log}, y: {…, turns},
 * layers: [(pen, box) => …], cursor: (pen, box) => …, title, message (instead of an empty plot),
 * key: [[name, (pen, x, y, theme) => draws a mark 24 wide], …],
 * colours: [[name, theme => colour], …] (explained under the plot in files)}.
 */
export class Plot {
  constructor(root, { label, content, ratio = 0.52, least = 290 }) {
    this.content = content;
    this.ratio = ratio;
    this.least = least;
    this.sheet = h("canvas", { "aria-hidden": "true" });
    this.cursor = h("canvas", { "aria-hidden": "true", className: "cursor" });
    this.element = h("div", { className: "plot", tabindex: "0", role: "application", "aria-label": label }, this.sheet, this.cursor);
    root.append(this.element);
    this.ending = new AbortController();
    this.observer = new ResizeObserver(() => this.redraw());
    this.observer.observe(this.element);
    onThemeChange(() => this.redraw(), this.ending.signal);
  }

  close() {
    this.ending.abort();
    this.observer.disconnect();
    cancelAnimationFrame(this.frame);
  }

  /** Draw all of it in the next frame. */
  redraw() {
    cancelAnimationFrame(this.frame);
    this.frame = requestAnimationFrame(() => this.draw());
  }

  draw() {
    const width = this.element.clientWidth;
    if (!width) return;
    const height = Math.round(Math.max(this.least, Math.min(width * this.ratio, innerHeight * OF_THE_WINDOW)));
    const pen = fit(this.sheet, width, height);
    this.box = this.paint(pen, width, height, theme(), dots());
    this.drawCursor();
    this.element.dispatchEvent(new Event("drawn"));
  }

  drawCursor() {
    if (!this.sheet.width) return;
    const pen = fit(this.cursor, this.sheet.clientWidth, this.sheet.clientHeight);
    const content = this.content();
    if (!this.box || !content?.cursor) return;
    clipped(pen, this.box, () => content.cursor(pen, this.box));
  }

  /** Draw the whole plot with `pen`, pictures at `dots` to a pixel; returns the box between the axes. */
  paint(pen, width, height, theme, dots) {
    pen.fillStyle = theme.paper;
    pen.fillRect(0, 0, width, height);
    const content = this.content();
    if (!content) return null;
    const box = boxOf(pen, content, width, height, theme, dots);
    if (content.y.turns) drawTurns(pen, box);
    clipped(pen, box, () => content.layers.forEach((layer) => layer(pen, box)));
    if (content.message) drawMessage(pen, box, content.message);
    drawFrame(pen, box, content);
    drawHead(pen, box, content);
    return box;
  }
}

export const dots = () => Math.min(devicePixelRatio || 1, 2);

/** A canvas's pen, the canvas made as large as that. */
export function fit(canvas, width, height) {
  const [wide, high] = [Math.round(width * dots()), Math.round(height * dots())];
  if (canvas.width !== wide || canvas.height !== high) {
    [canvas.width, canvas.height] = [wide, high];
    canvas.style.height = `${height}px`;
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(dots(), 0, 0, dots(), 0, 0);
  pen.clearRect(0, 0, width, height);
  return pen;
}
