// Pointer and keyboard input on a plot: hover, select, zoom, step from cell to cell.

import { clamp } from "../lib/physics.js";
import { isInBox, polyline } from "./drawing.js";

const DRAG_PX = 6; // shorter movements are clicks
const DOUBLE_MS = 300; // between the presses of a double click, which resets the zoom
const LARGE_STEP = 10; // cells per arrow key with Shift, or PageUp and PageDown
/** The handler that a key calls, and with what. */
const KEYS = {
  __proto__: null,
  ArrowLeft: ["step", -1, 0], ArrowRight: ["step", 1, 0], Home: ["step", -Infinity, 0], End: ["step", Infinity, 0],
  ArrowUp: ["step", 0, 1], ArrowDown: ["step", 0, -1], PageUp: ["step", 0, LARGE_STEP], PageDown: ["step", 0, -LARGE_STEP],
  Enter: ["selectCurrent"], " ": ["selectCurrent"], Escape: ["leave"],
  "+": ["scale", [0.5, 1]], "=": ["scale", [0.5, 1]], "-": ["scale", [2, 1]], 0: ["zoom", null],
};
const WHEEL = 0.0016; // logarithm of the zoom per pixel of the wheel

/** Calls handlers with axis values: hover(x, y), leave(), select(x, y), selectCurrent(), step(right, up), isZoomed(),
 * zoom({x0, x1, y0, y1} or null), scale([factors of width and height], [x, y], where that goes if it does not stay). */
export function listenToInput(plot, handlers) {
  listenToPointers(plot, handlers);
  // Beside the frame the wheel zooms the axis that it is over.
  listen(plot, "wheel", (event) => {
    event.preventDefault();
    const { left, top, width, height } = plot.box;
    const [x, y] = positionOf(event, plot);
    const factor = Math.exp(WHEEL * event.deltaY * (event.deltaMode ? 16 : 1) * (event.ctrlKey ? 6 : 1)); // a pinch has Ctrl
    const nearest = [clamp(x, left, left + width), clamp(y, top, top + height)];
    handlers.scale([x < left ? 1 : factor, y > top + height ? 1 : factor], valuesAt(nearest, plot));
  }, { passive: false });
  listen(plot, "keydown", (event) => {
    const key = KEYS[event.key];
    if (event.ctrlKey || event.metaKey || event.altKey || !key) return;
    event.preventDefault();
    const [name, ...args] = key;
    const isLarge = event.shiftKey && event.key.startsWith("Arrow");
    handlers[name](...(isLarge ? args.map((cells) => cells * LARGE_STEP) : args));
  });
}

/** Listen while something is drawn. */
const listen = (plot, type, handle, options) => plot.element.addEventListener(type, (event) => plot.box && handle(event), options);

function positionOf(event, { element }) {
  const { left, top } = element.getBoundingClientRect();
  return [event.clientX - left, event.clientY - top];
}

const valuesAt = ([x, y], { box }) => [box.x.value(x), box.y.value(y)];

function listenToPointers(plot, handlers) {
  const { element } = plot;
  let drag = null; // {start, end, isPan: with Shift it moves the window}
  let selecting; // a press selects, unless another one follows that makes it a double click
  const pressed = new Map(); // where pointers are down: two pinch
  const position = (event) => positionOf(event, plot);
  const values = (point) => valuesAt(point, plot);
  const isInside = ([x, y]) => isInBox(x, y, plot.box);

  listen(plot, "pointerdown", (event) => {
    clearTimeout(selecting);
    pressed.set(event.pointerId, position(event));
    if (pressed.size > 1) drag = null; // also where the second one is beside the frame
    else if (event.button === 0 && isInside(position(event))) drag = { start: position(event) };
  });
  element.addEventListener("touchmove", (event) => event.touches.length > 1 && event.cancelable && event.preventDefault(), { passive: false }); // no scrolling
  listen(plot, "pointermove", (event) => {
    const point = position(event);
    if (pressed.size === 2 && pressed.has(event.pointerId)) {
      const before = between(pressed);
      const after = between(pressed.set(event.pointerId, point));
      handlers.scale(Array(2).fill(before.length / Math.max(after.length, 1)), values(before.middle), values(after.middle));
    } else if (drag && event.shiftKey) {
      element.setPointerCapture(event.pointerId);
      if (drag.end) handlers.scale([1, 1], values(drag.end), values(point));
      Object.assign(drag, { end: point, isPan: true });
    } else if (drag && Math.hypot(point[0] - drag.start[0], point[1] - drag.start[1]) > DRAG_PX) {
      drag.end = point;
      element.setPointerCapture(event.pointerId);
      plot.drawCursor();
      drawSelection(plot, drag.start, drag.end);
    } else if (isInside(point)) handlers.hover(...values(point));
  });
  listen(plot, "pointerup", (event) => {
    if (drag?.end && !drag.isPan) handlers.zoom(selectedWindow(plot, drag.start, drag.end));
    else if (drag && !drag.end && isInside(position(event))) {
      const [x, y] = values(position(event));
      selecting = setTimeout(() => element.isConnected && handlers.select(x, y), handlers.isZoomed() ? DOUBLE_MS : 0);
    }
    drag = null;
  });
  listen(plot, "pointercancel", () => {
    drag = null;
    plot.drawCursor();
  });
  listen(plot, "pointerleave", () => drag || handlers.leave());
  for (const type of ["pointerup", "pointercancel", "pointerleave"]) element.addEventListener(type, ({ pointerId }) => pressed.delete(pointerId));
  listen(plot, "dblclick", () => {
    clearTimeout(selecting);
    handlers.zoom(null);
  });
}

function between(pointers) {
  const [[ax, ay], [bx, by]] = pointers.values();
  return { length: Math.hypot(ax - bx, ay - by), middle: [(ax + bx) / 2, (ay + by) / 2] };
}

/** The window between two corners of a drag; a drag along one axis keeps the whole range of the other. */
function selectedWindow({ box: { left, top, width, height, x, y } }, [ax, ay], [bx, by]) {
  const side = (from, to, start, length) => {
    const ends = [from, to].map((pixel) => clamp(pixel, start, start + length)).sort((a, b) => a - b);
    return ends[1] - ends[0] < 2 * DRAG_PX ? [start, start + length] : ends;
  };
  const [[x0, x1], [y1, y0]] = [side(ax, bx, left, width), side(ay, by, top, height)];
  return { x0: x.value(x0), x1: x.value(x1), y0: y.value(y0), y1: y.value(y1) };
}

function drawSelection(plot, from, to) {
  const { x0, x1, y0, y1 } = selectedWindow(plot, from, to);
  const { x, y, theme } = plot.box;
  const corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]].map(([column, row]) => [x.pixel(column), y.pixel(row)]);
  polyline(plot.cursor.getContext("2d"), theme.cursor, 1.5, corners, [4, 3]);
}

/** `window` with its sides `factors` times as long, what was at `from` at `to`, within `whole`; null if that is all of it. */
export function scaled({ box }, window, whole, factors, from, to = from) {
  const side = (axis, [low, high], [least, most], i) => {
    const [before, after] = [from, to].map((point) => axis.pixel(point?.[i] ?? axis.value((axis.pixel(low) + axis.pixel(high)) / 2)));
    const room = [axis.pixel(least) - axis.pixel(low), axis.pixel(most) - axis.pixel(high)];
    const moved = clamp(before - after, Math.min(...room), Math.max(...room)); // a window that is moved keeps its size
    const [start, end] = [low, high].map((value) => axis.value(factors[i] === 1 ? axis.pixel(value) + moved : before + factors[i] * (axis.pixel(value) - after)));
    const within = (value, limit) => (Math.abs(axis.pixel(value) - axis.pixel(limit)) < 0.5 ? limit : value); // an address is rounded
    return [within(Math.max(least, start), least), within(Math.min(most, end), most)];
  };
  const [x0, x1] = side(box.x, [window.x0, window.x1], [whole.x0, whole.x1], 0);
  const [y0, y1] = side(box.y, [window.y0, window.y1], [whole.y0, whole.y1], 1);
  return x0 <= whole.x0 && x1 >= whole.x1 && y0 <= whole.y0 && y1 >= whole.y1 ? null : { x0, x1, y0, y1 };
}
