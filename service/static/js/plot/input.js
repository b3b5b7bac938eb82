// Mouse, finger and keyboard on a plot: hover, pick, zoom, step from cell to cell.

import { stroke } from "./drawing.js";

const DRAG = 6; // pixels that make a drag

/**
 * Calls of `on`: hover(x, y) in values, leave(), pick(x, y), step(right, up), choose(), zoom({x0, x1, y0, y1} or
 * null for all), closer(factor).
 */
export function gestures(plot, on) {
  const { element } = plot;
  let from = null;
  let to = null;

  const at = (event) => {
    const area = element.getBoundingClientRect();
    return [event.clientX - area.left, event.clientY - area.top];
  };
  const values = ([x, y]) => [plot.box.x.value(x), plot.box.y.value(y)];
  const inside = ([x, y], { left, top, width, height }) =>
    x >= left && x <= left + width && y >= top && y <= top + height;

  const listen = (kind, work) => element.addEventListener(kind, (event) => plot.box && work(event));

  listen("pointerdown", (event) => {
    if (event.button !== 0 || !inside(at(event), plot.box)) return;
    from = at(event);
    to = null;
  });
  listen("pointermove", (event) => {
    const here = at(event);
    if (from && Math.hypot(here[0] - from[0], here[1] - from[1]) > DRAG) {
      to = here;
      element.setPointerCapture(event.pointerId);
      plot.drawCursor();
      drawFrame(plot, from, to);
    } else if (inside(here, plot.box)) on.hover(...values(here));
  });
  listen("pointerup", (event) => {
    if (from && to) on.zoom(windowOf(plot, from, to));
    else if (from && inside(at(event), plot.box)) on.pick(...values(at(event)));
    from = to = null;
  });
  listen("pointercancel", () => {
    from = to = null;
    plot.drawCursor();
  });
  listen("pointerleave", () => from || on.leave());
  listen("dblclick", () => on.zoom(null));

  const keys = {
    ArrowLeft: (many) => on.step(-many, 0),
    ArrowRight: (many) => on.step(many, 0),
    ArrowUp: (many) => on.step(0, many),
    ArrowDown: (many) => on.step(0, -many),
    Enter: () => on.choose(),
    " ": () => on.choose(),
    "+": () => on.closer(0.5),
    "=": () => on.closer(0.5),
    "-": () => on.closer(2),
    0: () => on.zoom(null),
  };
  listen("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || !keys[event.key]) return;
    event.preventDefault();
    keys[event.key](event.shiftKey ? 10 : 1);
  });
}

function windowOf({ box }, [ax, ay], [bx, by]) {
  const within = (value, low, high) => Math.min(Math.max(value, low), high);
  const x = [ax, bx].map((one) => within(one, box.left, box.left + box.width)).sort((a, b) => a - b);
  const y = [ay, by].map((one) => within(one, box.top, box.top + box.height)).sort((a, b) => b - a);
  // A drag along one axis only leaves the other as it is.
  if (x[1] - x[0] < 2 * DRAG) [x[0], x[1]] = [box.left, box.left + box.width];
  if (y[0] - y[1] < 2 * DRAG) [y[0], y[1]] = [box.top + box.height, box.top];
  return { x0: box.x.value(x[0]), x1: box.x.value(x[1]), y0: box.y.value(y[0]), y1: box.y.value(y[1]) };
}

function drawFrame(plot, from, to) {
  const pen = plot.cursor.getContext("2d");
  const window = windowOf(plot, from, to);
  const { x, y, theme } = plot.box;
  const [left, right] = [x.place(window.x0), x.place(window.x1)];
  const [low, high] = [y.place(window.y0), y.place(window.y1)];
  stroke(pen, theme.cursor, 1.5, [[left, low], [right, low], [right, high], [left, high], [left, low]], [4, 3]);
}

/** The window `factor` times as wide about the middle of `window`, within `whole`; null for all of it. */
export function zoomed(window, whole, factor, centre = (window.x0 + window.x1) / 2) {
  const half = ((window.x1 - window.x0) / 2) * factor;
  const x0 = Math.max(whole.x0, centre - half);
  const x1 = Math.min(whole.x1, centre + half);
  return x0 <= whole.x0 && x1 >= whole.x1 ? null : { ...window, x0, x1 };
}
