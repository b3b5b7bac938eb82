// What surrounds a plot's data: frame, ticks, labels, title and legend.

import { number } from "../lib/format.js";
import { TWO_PI, clamp } from "../lib/physics.js";
import { polyline } from "./drawing.js";
import { scale, ticks } from "./scale.js";

const FONT_SIZE = 13;
const LEGEND_SPACE = 50; // px, of an entry's symbol and the spaces around it
const HEADING_HEIGHT = 22; // px, of a line of the title or the legend
const HEADING_MARGIN = 72; // px, left and right of them, without the space after the last one
const LABEL_SPACE = 14; // px, between two texts of ticks
const NARROW = 520; // px: below this width, margins and ticks are smaller

/** The plot box: the data area between the margins, in pixels, the scales of its axes, and its texts once it is drawn. */
export function boxOf(ctx, content, width, height, theme, ratio) {
  const narrow = width < NARROW;
  const headings = headingsOf(ctx, content, width, theme);
  const [top, bottom] = [12 + HEADING_HEIGHT * ((headings.at(-1)?.line ?? -1) + 1) + (content.above?.height ?? 0), content.x.label ? 46 : 26];
  const [left, right] = content.margins ?? [leftMargin(ctx, content.y, height - top - bottom, theme, narrow), content.y.periods ? 34 : 22];
  return {
    left, top, width: width - left - right, height: height - top - bottom, theme, narrow, headings, ratio, texts: [],
    x: { ...scale(content.x.low, content.x.high, left, width - right, content.x.log), single: content.x.single },
    y: { ...scale(content.y.low, content.y.high, height - bottom, top, content.y.log), single: content.y.single },
  };
}

/** Parts of the title, three spaces apart, and legend from left to right, in as many lines as they need: [{name, drawSymbol, x, line}, …]. */
function headingsOf(ctx, { title, legend = [] }, width, theme) {
  ctx.font = `${FONT_SIZE + 1}px ${theme.serif}`;
  let [x, line] = [0, 0];
  const parts = title ? title.split(/(?<= {3})/).map((part, i, all) => (i < all.length - 1 ? [part, null, 0] : [part])) : [];
  return [...parts, ...legend].map(([name, drawSymbol, space = drawSymbol ? LEGEND_SPACE : HEADING_HEIGHT]) => {
    const size = ctx.measureText(name).width + space;
    if (x && x + size > width - HEADING_MARGIN) [x, line] = [0, line + 1];
    x += size;
    return { name, drawSymbol, x: x - size, line };
  });
}

/** The left margin fits the label and the widest tick. */
function leftMargin(ctx, y, height, theme, narrow) {
  ctx.font = `${FONT_SIZE}px ${theme.serif}`;
  const widest = Math.max(0, ...yTicks(y, height).map(({ text }) => ctx.measureText(text).width));
  return Math.max(narrow ? 46 : 58, Math.ceil(widest) + (narrow ? 26 : 31));
}

/** About `n` ticks of an axis; of one with a single value, that. */
const ticksOf = ({ low, high, log, single }, n) => (single === undefined ? ticks(low, high, n, log) : [{ value: single, text: number(single) }]);
const yTicks = (y, height) => ticksOf(y, height / 44);

/** Ticks about `distance` px apart, or further where their texts are wider. */
function xTicks(ctx, x, width, theme, distance) {
  ctx.font = `${FONT_SIZE}px ${theme.serif}`;
  const marks = ticksOf(x, width / distance);
  const widest = Math.max(0, ...marks.map(({ text }) => ctx.measureText(text).width)) + LABEL_SPACE;
  const isTight = marks.some(({ value }, i) => i && x.pixel(value) - x.pixel(marks[i - 1].value) < widest);
  return isTight && distance < width ? xTicks(ctx, x, width, theme, 1.5 * distance) : marks;
}

/** Faint lines at whole plate periods (multiples of 2π), labelled on the right. */
export function drawPeriods(ctx, box) {
  const first = Math.max(1, Math.ceil(box.y.low / TWO_PI));
  const last = Math.floor(box.y.high / TWO_PI + 1e-9);
  const step = Math.max(1, Math.ceil((last - first + 1) / 8));
  const right = box.left + box.width;
  for (let k = first; k <= last; k += step) {
    const y = box.y.pixel(k * TWO_PI);
    polyline(ctx, box.theme.border, 1, [[box.left, y], [right, y]]);
    box.texts.push({ text: `${2 * k}π`, x: right + 6, y, colour: box.theme.muted });
  }
}

export function drawFrame(ctx, box, { x, y }) {
  const { left, top, width, height, theme, texts } = box;
  ctx.strokeStyle = theme.text;
  ctx.lineWidth = 1;
  ctx.strokeRect(left + 0.5, top + 0.5, width - 1, height - 1);
  drawTicks(ctx, box, y.periods);
  const title = { align: "center", size: FONT_SIZE + 3, italic: true };
  ctx.font = `italic ${title.size}px ${theme.serif}`;
  const fitting = (label, room) => ({ ...title, room, text: ctx.measureText(label).width < room ? label : label.replace(/.* (?=[ΓΩξφ])/, "") }); // or its symbol alone
  if (x.label) texts.push({ ...fitting(x.label, width + 44), x: left + width / 2, y: top + height + 36 });
  if (y.label && !y.isTitled) texts.push({ ...fitting(y.label, height + 24), x: box.narrow ? 9 : 12, y: top + height / 2, turned: true });
}

/** Ticks point inwards on both sides, as in the paper's figures; on the right there may be labels of plate periods instead. */
function drawTicks(ctx, { x, y, left, top, width, height, narrow, ratio, theme, texts }, periods) {
  const [right, bottom, end] = [left + width, top + height, ctx.canvas.width / ratio];
  for (const { value, text } of xTicks(ctx, x, width, theme, narrow ? 46 : 62)) {
    const [px, half] = [clamp(Math.round(x.pixel(value)), left, right - 1) + 0.5, ctx.measureText(text).width / 2];
    polyline(ctx, theme.text, 1, [[px, bottom - 6], [px, bottom], null, [px, top], [px, top + 6]]);
    texts.push({ text, x: clamp(px, half, end - half), y: bottom + 14, align: "center" });
  }
  for (const { value, text } of yTicks(y, height)) {
    const py = clamp(Math.round(y.pixel(value)), top, bottom - 1) + 0.5;
    polyline(ctx, theme.text, 1, [[left, py], [left + 6, py], null, ...(periods ? [] : [[right - 6, py], [right, py]])]);
    texts.push({ text, x: left - 7, y: py, align: "right" });
  }
}

export function drawHeadings(ctx, { left, width, headings, theme, texts }) {
  for (const { name, drawSymbol, x, line } of headings) {
    const [start, y] = [left + x + (drawSymbol ? 30 : 0), 18 + HEADING_HEIGHT * line];
    drawSymbol?.(ctx, left + x, y, theme);
    texts.push({ text: name, x: start, y, size: FONT_SIZE + 1, room: left + width + 16 - start });
  }
}

/** The texts of a box; `align` is what of a text is at its x, its middle is at y; one longer than its `room`, in px, is drawn narrower. */
export function drawTexts(ctx, { texts, theme }) {
  ctx.textBaseline = "middle";
  for (const { text, x, y, align = "left", size = FONT_SIZE, italic = false, turned = false, colour = theme.text, room } of texts) {
    ctx.save();
    ctx.translate(x, y);
    if (turned) ctx.rotate(-Math.PI / 2);
    Object.assign(ctx, { font: `${italic ? "italic " : ""}${size}px ${theme.serif}`, textAlign: align, fillStyle: colour });
    ctx.fillText(text, 0, 0, room);
    ctx.restore();
  }
}
