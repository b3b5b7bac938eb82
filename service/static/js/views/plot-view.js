// The common part of the diagram, the mode map and the thresholds: a plot with loading, pointing, zooming, downloads.

import { currentQuery, setWindow, windowIn } from "../lib/address.js";
import { isHandledElsewhere } from "../lib/api.js";
import { announce, gestures, h, latest } from "../lib/dom.js";
import { downloads, fileName, netcdf, originOf } from "../lib/downloads.js";
import { isSweep } from "../lib/physics.js";
import { pngOf, svgOf } from "../plot/export.js";
import { listenToInput, magnified } from "../plot/input.js";
import { Plot } from "../plot/plot.js";

const RETRY_MS = 3000; // after 503: results that were damaged are computed again
const KEYS = "Arrow keys step through cells, Enter shows the trajectory, plus and minus zoom, 0 resets the zoom.";

/**
 * A view of one sweep around a Plot. A subclass defines
 *   name             part of the names of its files
 *   request(signal)  loads the data; resolves to the parameters now shown, as an object
 *   content()        what to draw (see Plot), null before anything is loaded
 *   whole()          the window {x0, x1, y0, y1} of all data
 *   nearest(x, y), step(cell, right, up)   the cell at a position, or so many cells further; null without data.
 *                    The views represent cells differently; only their own methods look into one.
 *   describe(cell)   a cell in words
 *   cellOf(cell)     its {gamma, omega, xi, direction}
 *   table()          a Blob of CSV, or a promise of one
 *   pdf(caption)     a promise of a Blob of PDF; optional
 */
export class PlotView {
  window = null; // zoomed to; null for everything
  current = null; // the cell under the pointer or reached by keyboard

  constructor({ job, grid, directions, onSelect, selected }) {
    Object.assign(this, { job, grid, directions, onSelect, selected });
    this.initial = currentQuery();
    this.window = windowIn(this.initial);
  }

  /** Build the view and start loading; `below` is placed between plot and readout. */
  build(root, { controls, label, hint, ratio, below = null }) {
    this.hint = gestures(hint);
    this.readout = h("p", { className: "readout" }, this.hint);
    this.problem = h("p", { className: "problem", role: "alert", hidden: true });
    const figure = h("figure", {});
    this.unzoom = h("button", { type: "button", className: "quiet", hidden: !this.window, onclick: () => this.zoom(null) }, "Show everything");
    root.replaceChildren(controls, this.problem, figure, ...(below ? [below] : []), this.readout, this.unzoom, this.#downloads());
    this.plot = new Plot(figure, { label: `${label}. ${KEYS}`, content: () => this.content(), ratio });
    listenToInput(this.plot, {
      hover: (x, y) => this.#setCurrent(this.nearest(x, y)),
      leave: () => this.#setCurrent(null),
      select: (x, y) => this.#select(this.nearest(x, y)),
      selectCurrent: () => this.#select(this.current),
      step: (right, up) => this.#step(right, up),
      zoom: (window) => this.zoom(window),
      magnify: (factor) => this.zoom(magnified(this.visible(), this.whole(), factor, this.centre())),
    });
    this.load = latest((signal) => this.#load(signal));
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
      const shown = await this.request(signal);
      if (this.closed) return;
      this.#showError(null);
      this.readout.textContent = this.current ? this.describe(this.current) : this.hint;
      this.plot.draw();
      this.plot.element.dataset.shown = JSON.stringify(shown);
    } catch (error) {
      this.#showError(error);
    } finally {
      this.plot.element.removeAttribute("aria-busy");
    }
  }

  /** An error takes the place of the plot unless earlier data are still shown. */
  #showError(error) {
    if (this.closed || (error && isHandledElsewhere(error))) return;
    this.problem.hidden = !error;
    this.problem.textContent = error?.message ?? "";
    this.plot.element.hidden = this.readout.hidden = Boolean(error) && !this.content();
    if (error?.status === 503) this.timer = setTimeout(() => this.load(), RETRY_MS);
    else if (error && !error.status) throw error;
  }

  /** The window on display. */
  visible() {
    return this.window ?? this.whole();
  }

  /** The x value about which the keyboard zooms; undefined for the middle of the window. */
  centre() {}

  zoom(window) {
    this.window = window;
    this.unzoom.hidden = !window;
    setWindow(window);
    this.plot.redraw();
  }

  #setCurrent(cell) {
    this.current = cell;
    this.readout.textContent = cell ? this.describe(cell) : this.hint;
    this.plot.drawCursor();
  }

  #step(right, up) {
    const cell = this.step(this.current, right, up);
    if (!cell) return;
    this.#setCurrent(cell);
    announce(this.readout.textContent);
  }

  #select(cell) {
    const selected = cell && this.cellOf(cell);
    if (!selected) return;
    this.#setCurrent(cell);
    this.onSelect(selected);
  }

  #downloads() {
    const name = (extension) => () => fileName(this.job, this.name, extension);
    const ifLoaded = (make) => () => {
      if (!this.content()) throw new Error("There is nothing to download in this view.");
      return make();
    };
    const caption = h("input", { type: "checkbox", checked: true });
    const options = async () => ({ caption: caption.checked, origin: await originOf(this.job) });
    const element = downloads([
      ["PNG", name("png"), ifLoaded(async () => pngOf(this.plot, await options()))],
      ["SVG", name("svg"), ifLoaded(async () => svgOf(this.plot, await options()))],
      ...(this.pdf ? [["PDF", name("pdf"), ifLoaded(() => this.pdf(caption.checked))]] : []),
      ["CSV", name("csv"), ifLoaded(() => this.table())],
      ...(isSweep(this.job.spec) ? [["NetCDF", () => fileName(this.job, "sweep", "nc"), netcdf(this.job)]] : []),
    ]);
    element.append(h("label", { className: "option" }, caption, " with a caption"));
    return element;
  }
}
