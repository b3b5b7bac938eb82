// Pointer and keyboard input on a plot: hover, select, zoom, step from cell to cell.

import { polyline } from "./drawing.js";

const DRAG_PX = 6; // shorter movements are clicks
const LARGE_STEP = 10; // cells per arrow key with Shift

/**
 * Calls these handlers, with positions in axis values: hover(x, y), leave(), select(x, y), selectCurrent(),
 * step(right, up), zoom({x0, x1, y0, y1} or null for everything), magnify(factor of the window's width).
 */
export function listenToInput(plot, handlers) {
  const { element } = plot;
  let dragStart = null;
  let dragEnd = null;

  const position = (event) => {
    const bounds = element.getBoundingClientRect();
    return [event.clientX - bounds.left, event.clientY - bounds.top];
  };
  const values = ([x, y]) => [plot.box.x.value(x), plot.box.y.value(y)];
  const isInside = ([x, y], { left, top, width, height }) =>
    x >= left && x <= left + width && y >= top && y <= top + height;

  const listen = (type, handle) => element.addEventListener(type, (event) => plot.box && handle(event));

  listen("pointerdown", (event) => {
    if (event.button !== 0 || !isInside(position(event), plot.box)) return;
    dragStart = position(event);
    dragEnd = null;
  });
  listen("pointermove", (event) => {
    const point = position(event);
    if (dragStart && Math.hypot(point[0] - dragStart[0], point[1] - dragStart[1]) > DRAG_PX) {
      dragEnd = point;
      element.setPointerCapture(event.pointerId);
      plot.drawCursor();
      drawSelection(plot, dragStart, dragEnd);
    } else if (isInside(point, plot.box)) handlers.hover(...values(point));
  });
  listen("pointerup", (event) => {
    if (dragStart && dragEnd) handlers.zoom(selectedWindow(plot, dragStart, dragEnd));
    else if (dragStart && isInside(position(event), plot.box)) handlers.select(...values(position(event)));
    dragStart = dragEnd = null;
  });
  listen("pointercancel", () => {
    dragStart = dragEnd = null;
    plot.drawCursor();
  });
  listen("pointerleave", () => dragStart || handlers.leave());
  listen("dblclick", () => handlers.zoom(null));

  const keys = {
    ArrowLeft: (cells) => handlers.step(-cells, 0),
    ArrowRight: (cells) => handlers.step(cells, 0),
    ArrowUp: (cells) => handlers.step(0, cells),
    ArrowDown: (cells) => handlers.step(0, -cells),
    Enter: () => handlers.selectCurrent(),
    " ": () => handlers.selectCurrent(),
    "+": () => handlers.magnify(0.5),
    "=": () => handlers.magnify(0.5),
    "-": () => handlers.magnify(2),
    0: () => handlers.zoom(null),
  };
  listen("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !keys[event.key]) return;
    event.preventDefault();
    keys[event.key](event.shiftKey ? LARGE_STEP : 1);
  });
}

/** The window between two corners of a drag; a drag along one axis keeps the whole range of the other. */
function selectedWindow({ box }, [ax, ay], [bx, by]) {
  const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
  const x = [ax, bx].map((value) => clamp(value, box.left, box.left + box.width)).sort((a, b) => a - b);
  const y = [ay, by].map((value) => clamp(value, box.top, box.top + box.height)).sort((a, b) => b - a);
  if (x[1] - x[0] < 2 * DRAG_PX) [x[0], x[1]] = [box.left, box.left + box.width];
  if (y[0] - y[1] < 2 * DRAG_PX) [y[0], y[1]] = [box.top + box.height, box.top];
  return { x0: box.x.value(x[0]), x1: box.x.value(x[1]), y0: box.y.value(y[0]), y1: box.y.value(y[1]) };
}

function drawSelection(plot, from, to) {
  const { x0, x1, y0, y1 } = selectedWindow(plot, from, to);
  const { x, y, theme } = plot.box;
  const corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]].map(([column, row]) => [x.pixel(column), y.pixel(row)]);
  polyline(plot.cursor.getContext("2d"), theme.cursor, 1.5, corners, [4, 3]);
}

/** `window` made `factor` times as wide about `centre`, within `whole`; null if that is all of it. */
export function magnified(window, whole, factor, centre = (window.x0 + window.x1) / 2) {
  const half = ((window.x1 - window.x0) / 2) * factor;
  const x0 = Math.max(whole.x0, centre - half);
  const x1 = Math.min(whole.x1, centre + half);
  return x0 <= whole.x0 && x1 >= whole.x1 ? null : { ...window, x0, x1 };
}
