// A plot: layers drawn between axes on one canvas, the cursor on a second one above it.

import { h } from "../lib/dom.js";
import { axisText } from "../lib/physics.js";
import { onThemeChange, theme } from "./colours.js";
import { clipped, described, pixelRatio, resizedContext } from "./drawing.js";
import { boxOf, drawFrame, drawHeadings, drawPeriods, drawTexts } from "./frame.js";

const PNG_RATIO = 3; // pixels of a file per CSS pixel

let plots = 0;

/** `content()` returns what to draw, null before anything is loaded:
 *   x: {label, low, high, log, single (value, of its only tick)}, y: {label, low, high, log, periods (mark whole plate periods), isTitled (title names it)},
 *   layers: [(ctx, box) => …],
 *   title, message (shown in the middle of an empty plot), above: {height, draw: (ctx, box) => …}, of strips above the box,
 *   margins: [left, right], in px, where they are those of another plot,
 *   legend: [[name, (ctx, x, y, theme) => draws a symbol 24 px wide, if it has one], …].
 * `drawMark(ctx, box)` draws the cursor. Dispatches "drawn" on its element after each drawing. It follows its size and the theme until `signal` aborts. */
export class Plot {
  constructor(root, { label, content, drawMark = () => {}, signal, takesInput = true }) {
    Object.assign(this, { content, drawMark });
    this.canvas = h("canvas", { "aria-hidden": "true" });
    this.cursor = h("canvas", { "aria-hidden": "true", className: "cursor" });
    this.message = h("p", { className: "message" });
    this.texts = h("div", { className: "texts visually-hidden" }); // what the canvas has as a picture
    this.axes = h("p", { className: "visually-hidden", id: `axes-${(plots += 1)}` });
    this.element = h("div", { className: "plot", ...(takesInput ? { tabindex: "0", role: "application" } : { role: "img" }), "aria-label": label, "aria-describedby": this.axes.id }, this.canvas, this.cursor, this.texts, this.message, this.axes);
    root.append(this.element);
    const observer = new ResizeObserver(() => this.redraw());
    observer.observe(this.element);
    signal.addEventListener("abort", () => observer.disconnect());
    onThemeChange(() => this.draw(), signal); // at once, before it is printed
  }

  redraw() {
    cancelAnimationFrame(this.frame);
    this.frame = requestAnimationFrame(() => this.draw());
  }

  draw() {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (!width) return;
    const ctx = resizedContext(this.canvas, width, height);
    const content = this.content();
    this.box = content && this.#paint(ctx, content, pixelRatio());
    if (content) {
      this.texts.replaceChildren(...this.box.texts.flatMap(({ text }) => [h("span", {}, text), " "]));
      const axis = ({ label, low, high }) => `${label} from ${axisText(low, [low, high])} to ${axisText(high, [low, high])}`;
      this.axes.textContent = [content.title, axis(content.x), axis(content.y)].filter(Boolean).join(". ");
    }
    this.message.textContent = content?.message ?? "";
    this.drawCursor();
    this.element.dispatchEvent(new Event("drawn"));
  }

  #paint(ctx, content, ratio, height = this.element.clientHeight) {
    const box = boxOf(ctx, content, this.element.clientWidth, height, theme(), ratio);
    ctx.fillStyle = box.theme.surface;
    ctx.fillRect(0, 0, ctx.canvas.width, ctx.canvas.height);
    if (content.y.periods) drawPeriods(ctx, box);
    clipped(ctx, box, () => content.layers.forEach((layer) => layer(ctx, box)));
    drawFrame(ctx, box, content);
    content.above?.draw(ctx, box);
    drawHeadings(ctx, box);
    drawTexts(ctx, box);
    return box;
  }

  /** What is drawn, as a PNG of more pixels: with more entries of the legend, for which it is higher, other plots below, a text on what it is. */
  async png(entries = [], below = [], text = "") {
    const canvas = h("canvas");
    const plots = [this, ...below].map((plot) => {
      const [shown, { clientWidth: width, clientHeight }] = [plot.content(), plot.element];
      const content = { ...shown, legend: [...(shown.legend ?? []), ...(plot === this ? entries : [])] };
      const { top } = boxOf(canvas.getContext("2d"), content, width, clientHeight, theme(), PNG_RATIO);
      return { plot, content, height: clientHeight + top - plot.box.top };
    });
    const ctx = resizedContext(canvas, this.element.clientWidth, plots.reduce((sum, { height }) => sum + height, 0), PNG_RATIO);
    for (const { plot, content, height } of plots) {
      plot.#paint(ctx, content, PNG_RATIO, height);
      ctx.translate(0, height);
    }
    return described(await new Promise((resolve) => canvas.toBlob(resolve, "image/png")), text);
  }

  drawCursor() {
    const ctx = resizedContext(this.cursor, this.canvas.clientWidth, this.canvas.clientHeight);
    if (this.box) clipped(ctx, this.box, () => this.drawMark(ctx, this.box));
  }
}
