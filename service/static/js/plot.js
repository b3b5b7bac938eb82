// A framed plot: axes, ticks, layers that draw between them, and a second sheet for the cursor.
//
// What draws gets a "pen": a canvas's own context, or svg.js's, which takes the same strokes into a file.

import { h } from "./dom.js";
import { scale, ticks } from "./scale.js";
import { SvgPen } from "./svg.js";
import { onThemeChange, theme } from "./theme.js";

const FONT = 13;
const ROW = 24; // of explained colours
const IN_A_ROW = 7;

/**
 * `content()` says what to draw: {x: {label, low, high, log}, y: {…, turns}, layers: [(pen, box) => …],
 * cursor: (pen, box) => …, colours: [[name, theme => colour], …] (explained under the plot in files), title: text, key: [[name, (pen, x, y, theme) => draws a mark 24 wide], …]}; null while
 * there is nothing.
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
    const height = Math.round(Math.max(this.least, width * this.ratio));
    const pen = this.#fit(this.sheet, width, height);
    this.box = this.paint(pen, width, height, theme());
    this.drawCursor();
    this.element.dispatchEvent(new Event("drawn"));
  }

  drawCursor() {
    if (!this.sheet.width) return;
    const [width, height] = [this.sheet.clientWidth, this.sheet.clientHeight];
    const pen = this.#fit(this.cursor, width, height);
    const content = this.content();
    if (!this.box || !content?.cursor) return;
    clipped(pen, this.box, () => content.cursor(pen, this.box));
  }

  /** Draw the whole plot with `pen`; returns the box between the axes. */
  paint(pen, width, height, theme) {
    pen.fillStyle = theme.paper;
    pen.fillRect(0, 0, width, height);
    const content = this.content();
    if (!content) return null;
    const box = boxOf(content, width, height, theme);
    if (content.y.turns) drawTurns(pen, box);
    clipped(pen, box, () => content.layers.forEach((layer) => layer(pen, box)));
    drawFrame(pen, box, content);
    drawHead(pen, box, content);
    return box;
  }

  /** What is shown, as a file on white paper. */
  async png() {
    const { width, height, rows } = this.#sheetSize();
    const canvas = h("canvas", { width: 2 * width, height: 2 * (height + rows) });
    const pen = canvas.getContext("2d");
    pen.scale(2, 2);
    this.#paintFile(pen, width, height, rows);
    return new Promise((done) => canvas.toBlob(done, "image/png"));
  }

  svg() {
    const { width, height, rows } = this.#sheetSize();
    const pen = new SvgPen(width, height + rows);
    this.#paintFile(pen, width, height, rows);
    return pen.blob();
  }

  #sheetSize() {
    const colours = this.content()?.colours?.length ?? 0;
    return { width: 1000, height: Math.round(1000 * this.ratio), rows: Math.ceil(colours / IN_A_ROW) * ROW };
  }

  #paintFile(pen, width, height, rows) {
    const paper = theme(true);
    this.paint(pen, width, height, paper);
    pen.fillStyle = paper.paper;
    pen.fillRect(0, height, width, rows);
    pen.font = `${FONT}px ${paper.serif}`;
    pen.textAlign = "left";
    pen.textBaseline = "middle";
    (this.content()?.colours ?? []).forEach(([name, colour], i) => {
      const [x, y] = [58 + (i % IN_A_ROW) * ((width - 80) / IN_A_ROW), height + (Math.floor(i / IN_A_ROW) + 0.4) * ROW];
      pen.fillStyle = colour(paper);
      pen.fillRect(x, y - 6, 12, 12);
      pen.fillStyle = paper.ink;
      pen.fillText(name, x + 18, y);
    });
  }

  #fit(canvas, width, height) {
    const dots = Math.min(devicePixelRatio || 1, 2);
    if (canvas.width !== Math.round(width * dots) || canvas.height !== Math.round(height * dots)) {
      canvas.width = Math.round(width * dots);
      canvas.height = Math.round(height * dots);
      canvas.style.height = `${height}px`;
    }
    const pen = canvas.getContext("2d");
    pen.setTransform(dots, 0, 0, dots, 0, 0);
    pen.clearRect(0, 0, width, height);
    return pen;
  }
}

function boxOf(content, width, height, theme) {
  const narrow = width < 520;
  const [left, right] = [narrow ? 46 : 58, content.y.turns ? 34 : 22];
  const heads = [content.title, content.key?.length].filter(Boolean).length;
  const [top, bottom] = [12 + (narrow ? 22 * heads : heads && 20), 46];
  return {
    left, top, width: width - left - right, height: height - top - bottom, theme, narrow,
    x: scale(content.x.low, content.x.high, left, width - right, content.x.log),
    y: scale(content.y.low, content.y.high, height - bottom, top, content.y.log),
  };
}

function clipped(pen, box, draw) {
  pen.save();
  pen.beginPath();
  pen.rect(box.left, box.top, box.width, box.height);
  pen.clip();
  draw();
  pen.restore();
}

/** Whole plate periods as faint lines, counted on the right. */
function drawTurns(pen, box) {
  const turn = 2 * Math.PI;
  const first = Math.max(1, Math.ceil(box.y.low / turn));
  const last = Math.floor(box.y.high / turn + 1e-9);
  const step = Math.max(1, Math.ceil((last - first + 1) / 8));
  pen.font = `${FONT - 1}px ${box.theme.serif}`;
  pen.textAlign = "left";
  pen.textBaseline = "middle";
  for (let k = first; k <= last; k += step) {
    const y = box.y.place(k * turn);
    stroke(pen, box.theme.rule, 1, [[box.left, y], [box.left + box.width, y]]);
    pen.fillStyle = box.theme.soft;
    pen.fillText(`${2 * k}π`, box.left + box.width + 6, y);
  }
}

function drawFrame(pen, box, { x, y }) {
  const { left, top, width, height, theme } = box;
  pen.strokeStyle = theme.ink;
  pen.lineWidth = 1;
  pen.strokeRect(left + 0.5, top + 0.5, width - 1, height - 1);
  pen.fillStyle = theme.ink;
  pen.font = `${FONT}px ${theme.serif}`;
  pen.textBaseline = "top";
  pen.textAlign = "center";
  for (const { value, text } of ticks(box.x.low, box.x.high, width / (box.narrow ? 46 : 62), box.x.log)) {
    const at = Math.round(box.x.place(value)) + 0.5;
    stroke(pen, theme.ink, 1, [[at, top + height - 6], [at, top + height]]);
    pen.fillText(text, at, top + height + 7);
  }
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  for (const { value, text } of ticks(box.y.low, box.y.high, height / 44, box.y.log)) {
    const at = Math.round(box.y.place(value)) + 0.5;
    stroke(pen, theme.ink, 1, [[left, at], [left + 6, at]]);
    pen.fillText(text, left - 7, at);
  }
  pen.font = `italic ${FONT + 3}px ${theme.serif}`;
  pen.textAlign = "center";
  pen.textBaseline = "alphabetic";
  pen.fillText(x.label, left + width / 2, top + height + 41);
  pen.save();
  pen.translate(box.narrow ? 12 : 16, top + height / 2);
  pen.rotate(-Math.PI / 2);
  pen.fillText(y.label, 0, 0);
  pen.restore();
}

/** What is shown, on the left above the frame; what the marks mean, on the right. */
function drawHead(pen, { left, top, width, narrow, theme }, { title = "", key = [] }) {
  pen.font = `${FONT + 1}px ${theme.serif}`;
  pen.textBaseline = "middle";
  pen.textAlign = "left";
  pen.fillStyle = theme.ink;
  pen.fillText(title, left, narrow && key.length ? top - 37 : top - 15); // a line of its own where it is narrow
  pen.textAlign = "right";
  let x = left + width;
  for (const [name, mark] of [...key].reverse()) {
    pen.fillStyle = theme.ink;
    pen.fillText(name, x, top - 15);
    x -= pen.measureText(name).width + 34;
    mark(pen, x + 4, top - 15, theme);
    x -= 12;
  }
}

/** A line through points, [x, y] in pixels; dashed if `dash` says so. */
export function stroke(pen, colour, width, points, dash = []) {
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.setLineDash(dash);
  pen.beginPath();
  points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
  pen.stroke();
  pen.setLineDash([]);
}
