// What the diagram, the mode map and the thresholds have in common: a plot that is loaded, pointed at, zoomed and taken away.

import { noted } from "../lib/address.js";
import { toldElsewhere } from "../lib/api.js";
import { h, newest, say } from "../lib/dom.js";
import { downloads, fileName, netcdf } from "../lib/downloads.js";
import { gestures, zoomed } from "../plot/input.js";
import { pngOf, svgOf } from "../plot/export.js";
import { Plot } from "../plot/plot.js";
import { askWindow, noteWindow } from "../lib/zoom.js";

const AGAIN = 3000; // ms, after which results that were damaged are asked for once more
export const KEYS = "Arrow keys step, Enter shows the cell in motion, plus and minus zoom, 0 shows all.";

/**
 * A view of one sweep. What extends it says
 *   ask(signal): load; resolves to what is shown then, as an object     whole(): the window that shows all
 *   content(): what to draw (plot.js), null before anything is loaded   name: of its files
 *   nearest(x, y), step(at, right, up): a place `at`, or null           describe(at): the place in words
 *   cellOf(at): {gamma, omega, xi, direction}                           table(): a Blob of CSV, or a promise of one
 */
export class PlotView {
  window = null; // what is zoomed to
  at = null; // the place under the cursor

  constructor({ job, grid, directions, choose, chosen }) {
    Object.assign(this, { job, grid, directions, chosen });
    this.chooses = choose;
    this.asked = noted();
    this.window = askWindow(this.asked);
  }

  /** Lay the view out and begin to load; `below` stands between the plot and the words on the place pointed at. */
  build(root, { controls, label, hint, ratio, below = null }) {
    this.hint = hint;
    this.readout = h("p", { className: "readout" }, hint);
    this.problem = h("p", { className: "problem", role: "alert", hidden: true });
    const figure = h("figure", {});
    root.replaceChildren(controls, this.problem, figure, ...(below ? [below] : []), this.readout, this.#downloads());
    this.plot = new Plot(figure, { label: `${label}. ${KEYS}`, content: () => this.content(), ratio });
    gestures(this.plot, {
      hover: (x, y) => this.point(this.nearest(x, y)),
      leave: () => this.point(null),
      pick: (x, y) => this.#choose(this.nearest(x, y)),
      choose: () => this.#choose(this.at),
      step: (right, up) => this.#step(right, up),
      zoom: (window) => this.zoom(window),
      closer: (factor) => this.zoom(zoomed(this.shown(), this.whole(), factor, this.middle())),
    });
    this.load = newest((signal) => this.#load(signal));
    this.load();
  }

  close() {
    this.closed = true;
    clearTimeout(this.timer);
    this.plot.close();
  }

  update(job) {
    this.job = job;
    this.load();
  }

  async #load(signal) {
    clearTimeout(this.timer);
    this.plot.element.setAttribute("aria-busy", "true");
    try {
      const shows = await this.ask(signal);
      if (this.closed) return;
      this.#tell(null);
      this.readout.textContent = this.at ? this.describe(this.at) : this.hint;
      this.plot.draw();
      this.plot.element.dataset.shows = JSON.stringify(shows);
    } catch (error) {
      this.#tell(error);
    } finally {
      this.plot.element.removeAttribute("aria-busy");
    }
  }

  /** What the service refuses is said where it would have been shown. */
  #tell(error) {
    if (this.closed || (error && toldElsewhere(error))) return;
    this.problem.hidden = !error;
    this.problem.textContent = error?.message ?? "";
    this.plot.element.hidden = this.readout.hidden = Boolean(error) && !this.content(); // nothing to point at
    if (error?.status === 503) this.timer = setTimeout(() => this.load(), AGAIN);
    else if (error && !error.status) throw error;
  }

  /** The window that is seen. */
  shown() {
    return this.window ?? this.whole();
  }

  /** About what the keyboard zooms; the middle if there is nothing better. */
  middle() {}

  zoom(window) {
    this.window = window;
    noteWindow(window);
    this.plot.redraw();
  }

  point(at) {
    this.at = at;
    this.readout.textContent = at ? this.describe(at) : this.hint;
    this.plot.drawCursor();
  }

  #step(right, up) {
    const at = this.step(this.at, right, up);
    if (!at) return;
    this.point(at);
    say(this.readout.textContent);
  }

  #choose(at) {
    const cell = at && this.cellOf(at);
    if (!cell) return;
    this.point(at);
    this.chooses(cell);
  }

  #downloads() {
    const name = (kind) => () => fileName(this.job, this.name, kind);
    const shown = (make) => () => {
      if (!this.content()) throw new Error("Nothing is shown here.");
      return make();
    };
    return downloads([
      ["PNG", name("png"), shown(() => pngOf(this.plot))],
      ["SVG", name("svg"), shown(() => svgOf(this.plot))],
      ["CSV", name("csv"), shown(() => this.table())],
      ["NetCDF", () => fileName(this.job, "sweep", "nc"), netcdf(this.job)],
    ]);
  }
}

/** `value` where it lies between 0 and n - 1, else the nearer of them. */
export const within = (value, n) => Math.min(Math.max(value, 0), n - 1);
