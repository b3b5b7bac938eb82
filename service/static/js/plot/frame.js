// What stands round a plot: the frame, its ticks and labels, whole plate periods, the head with its key.

import { stroke } from "./drawing.js";
import { scale, ticks } from "./scale.js";

export const FONT = 13;
const TURN = 2 * Math.PI;

/** Where between the margins the plot lies, and the scales of its axes. */
export function boxOf(pen, content, width, height, theme, dots) {
  const narrow = width < 520;
  const heads = [content.title, content.key?.length].filter(Boolean).length;
  const [top, bottom] = [12 + (narrow ? 22 * heads : heads && 20), 46];
  const [left, right] = [marginOf(pen, content.y, height - top - bottom, theme, narrow), content.y.turns ? 34 : 22];
  return {
    left, top, width: width - left - right, height: height - top - bottom, theme, narrow, dots,
    x: scale(content.x.low, content.x.high, left, width - right, content.x.log),
    y: scale(content.y.low, content.y.high, height - bottom, top, content.y.log),
  };
}

/** Room on the left for the label and the widest number. */
function marginOf(pen, { low, high, log }, height, theme, narrow) {
  pen.font = `${FONT}px ${theme.serif}`;
  const widest = Math.max(0, ...ticksOf(low, high, height, log).map(({ text }) => pen.measureText(text).width));
  return Math.max(narrow ? 46 : 58, Math.ceil(widest) + (narrow ? 26 : 31));
}

const ticksOf = (low, high, height, log) => ticks(low, high, height / 44, log);

/** Whole plate periods as faint lines, counted on the right. */
export function drawTurns(pen, box) {
  const first = Math.max(1, Math.ceil(box.y.low / TURN));
  const last = Math.floor(box.y.high / TURN + 1e-9);
  const step = Math.max(1, Math.ceil((last - first + 1) / 8));
  const right = box.left + box.width;
  pen.font = `${FONT}px ${box.theme.serif}`;
  pen.textAlign = "left";
  pen.textBaseline = "middle";
  for (let k = first; k <= last; k += step) {
    const y = box.y.place(k * TURN);
    stroke(pen, box.theme.rule, 1, [[box.left, y], [right, y]]);
    pen.fillStyle = box.theme.soft;
    pen.fillText(`${2 * k}π`, right + 6, y);
  }
}

export function drawFrame(pen, box, { x, y }) {
  const { left, top, width, height, theme } = box;
  pen.strokeStyle = theme.ink;
  pen.lineWidth = 1;
  pen.strokeRect(left + 0.5, top + 0.5, width - 1, height - 1);
  pen.fillStyle = theme.ink;
  pen.font = `${FONT}px ${theme.serif}`;
  drawTicksBelow(pen, box);
  drawTicksLeft(pen, box, y.turns);
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

/** Ticks point inwards, on both sides, as in the paper's figures. */
function drawTicksBelow(pen, { x, left, top, width, height, narrow, theme }) {
  pen.textBaseline = "top";
  pen.textAlign = "center";
  for (const { value, text } of ticks(x.low, x.high, width / (narrow ? 46 : 62), x.log)) {
    const at = within(Math.round(x.place(value)) + 0.5, left, left + width);
    stroke(pen, theme.ink, 1, [[at, top + height - 6], [at, top + height]]);
    stroke(pen, theme.ink, 1, [[at, top], [at, top + 6]]);
    pen.fillText(text, at, top + height + 7);
  }
}

function drawTicksLeft(pen, { y, left, top, width, height, theme }, turns) {
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  for (const { value, text } of ticksOf(y.low, y.high, height, y.log)) {
    const at = within(Math.round(y.place(value)) + 0.5, top, top + height);
    stroke(pen, theme.ink, 1, [[left, at], [left + 6, at]]);
    if (!turns) stroke(pen, theme.ink, 1, [[left + width - 6, at], [left + width, at]]);
    pen.fillText(text, left - 7, at);
  }
}

const within = (at, low, high) => Math.min(Math.max(at, low + 0.5), high - 0.5);

/** What is shown, on the left above the frame; what the marks mean, on the right. */
export function drawHead(pen, { left, top, width, narrow, theme }, { title = "", key = [] }) {
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

/** A sentence in the middle: why there is nothing to see. */
export function drawMessage(pen, { left, top, width, height, theme }, message) {
  pen.font = `italic ${FONT + 3}px ${theme.serif}`;
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  const wide = Math.min(pen.measureText(message).width + 24, width - 12);
  pen.fillStyle = theme.paper;
  pen.fillRect(left + width / 2 - wide / 2, top + height / 2 - 16, wide, 32);
  pen.fillStyle = theme.soft;
  pen.fillText(message, left + width / 2, top + height / 2, width - 16);
}
