// A plot as a PNG or SVG file: dark on white, whatever the colour scheme of the screen. Files tell where they come from.

import { theme } from "./colours.js";
import { FONT_SIZE } from "./frame.js";
import { withText } from "./png-text.js";

const WIDTH = 1000;
const RATIO = 2; // pixels per unit of bitmaps
const LEGEND_ROW = 24;
const LEGEND_COLUMNS = 7;

/** `origin`: what the metadata hold, as an object; `caption`: with the title above the plot. */
export async function pngOf(original, { origin, caption = true } = {}) {
  const plot = caption ? original : uncaptioned(original);
  const { height, legend } = sizeOf(plot);
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [RATIO * WIDTH, RATIO * (height + legend)];
  const ctx = canvas.getContext("2d");
  ctx.scale(RATIO, RATIO);
  paint(plot, ctx, height, legend);
  const png = await new Promise((resolve) => canvas.toBlob(resolve, "image/png"));
  return origin ? withText(png, "Description", JSON.stringify(origin)) : png;
}

/** The plot without the title above it. */
const uncaptioned = (plot) => Object.create(plot, { content: { value: () => plot.content() && { ...plot.content(), title: "" } } });

/** As pngOf; text stays text. */
export function svgOf(original, { origin, caption = true } = {}) {
  const plot = caption ? original : uncaptioned(original);
  const { height, legend } = sizeOf(plot);
  const ctx = new SvgContext(WIDTH, height + legend);
  paint(plot, ctx, height, legend);
  return ctx.blob(origin);
}

/** The heights of the plot and of the legend of its colours below it. */
function sizeOf(plot) {
  const colours = plot.content()?.colours?.length ?? 0;
  return { height: Math.round(WIDTH * plot.ratio), legend: Math.ceil(colours / LEGEND_COLUMNS) * LEGEND_ROW };
}

function paint(plot, ctx, height, legend) {
  const print = theme(true);
  plot.paint(ctx, WIDTH, height, print, RATIO);
  ctx.fillStyle = print.surface;
  ctx.fillRect(0, height, WIDTH, legend);
  ctx.font = `${FONT_SIZE}px ${print.serif}`;
  ctx.textAlign = "left";
  ctx.textBaseline = "middle";
  (plot.content()?.colours ?? []).forEach(([name, colour], i) => {
    const [x, y] = [58 + (i % LEGEND_COLUMNS) * ((WIDTH - 80) / LEGEND_COLUMNS), height + (Math.floor(i / LEGEND_COLUMNS) + 0.4) * LEGEND_ROW];
    ctx.fillStyle = colour(print);
    ctx.fillRect(x, y - 6, 12, 12);
    ctx.fillStyle = print.text;
    ctx.fillText(name, x + 18, y);
  });
}

const escaped = (text) => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;");
const rounded = (value) => String(Math.round(value * 100) / 100);
const ANCHOR = { left: "start", center: "middle", right: "end" };
const BASELINE_SHIFT = { top: "0.9em", middle: "0.35em", alphabetic: "0", bottom: "-0.2em" };

/** The part of CanvasRenderingContext2D that plots use, recorded as SVG. */
class SvgContext {
  fillStyle = "#000";
  strokeStyle = "#000";
  lineWidth = 1;
  globalAlpha = 1;
  font = "13px serif";
  textAlign = "left";
  textBaseline = "alphabetic";
  #elements = [];
  #path = "";
  #dash = [];
  #saved = [];
  #clips = 0;
  #open = 0; // groups to close at the next restore

  constructor(width, height) {
    this.width = width;
    this.height = height;
  }

  save() {
    this.#saved.push([this.#open, this.#dash, this.globalAlpha]);
    this.#open = 0;
  }
  restore() {
    this.#elements.push("</g>".repeat(this.#open));
    [this.#open, this.#dash, this.globalAlpha] = this.#saved.pop();
  }
  beginPath() {
    this.#path = "";
  }
  moveTo(x, y) {
    this.#path += `M${rounded(x)} ${rounded(y)}`;
  }
  lineTo(x, y) {
    this.#path += `L${rounded(x)} ${rounded(y)}`;
  }
  closePath() {
    this.#path += "Z";
  }
  rect(x, y, w, h) {
    this.#path += `M${rounded(x)} ${rounded(y)}h${rounded(w)}v${rounded(h)}h${rounded(-w)}Z`;
  }
  arc(x, y, r) {
    this.#path += `M${rounded(x - r)} ${rounded(y)}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0`; // full circles only
  }
  clip() {
    const id = `clip${++this.#clips}`;
    this.#group(`clip-path="url(#${id})"`, `<clipPath id="${id}"><path d="${this.#path}"/></clipPath>`);
  }
  translate(x, y) {
    this.#group(`transform="translate(${rounded(x)} ${rounded(y)})"`);
  }
  rotate(angle) {
    this.#group(`transform="rotate(${rounded((angle * 180) / Math.PI)})"`);
  }
  setLineDash(dash) {
    this.#dash = dash;
  }
  stroke() {
    const dash = this.#dash.length ? ` stroke-dasharray="${this.#dash.join(" ")}"` : "";
    this.#elements.push(
      `<path d="${this.#path}" fill="none" stroke="${this.strokeStyle}" stroke-width="${this.lineWidth}" stroke-linejoin="round"${dash}${this.#alpha()}/>`,
    );
  }
  fill() {
    this.#elements.push(`<path d="${this.#path}" fill="${this.fillStyle}"${this.#alpha()}/>`);
  }
  fillRect(x, y, w, h) {
    this.#elements.push(
      `<rect x="${rounded(x)}" y="${rounded(y)}" width="${rounded(w)}" height="${rounded(h)}" fill="${this.fillStyle}"${this.#alpha()}/>`,
    );
  }
  strokeRect(x, y, w, h) {
    this.beginPath();
    this.rect(x, y, w, h);
    this.stroke();
  }
  fillText(text, x, y) {
    const [, italic = "", size, family] = /^(italic )?([\d.]+)px (.*)$/.exec(this.font);
    const style = italic ? ' font-style="italic"' : "";
    this.#elements.push(
      `<text x="${rounded(x)}" y="${rounded(y)}" dy="${BASELINE_SHIFT[this.textBaseline]}" font-size="${size}" font-family="${family.replaceAll('"', "'")}"${style} text-anchor="${ANCHOR[this.textAlign]}" fill="${this.fillStyle}"${this.#alpha()}>${escaped(text)}</text>`,
    );
  }
  /** An estimate: the width depends on the fonts of whoever opens the file. */
  measureText(text) {
    return { width: 0.55 * parseFloat(/([\d.]+)px/.exec(this.font)[1]) * text.length };
  }
  /** Bitmaps are embedded unsmoothed. */
  drawImage(canvas, x, y, w, h) {
    this.#elements.push(
      `<image x="${rounded(x)}" y="${rounded(y)}" width="${rounded(w)}" height="${rounded(h)}" preserveAspectRatio="none" style="image-rendering:pixelated" href="${canvas.toDataURL("image/png")}"/>`,
    );
  }
  blob(origin) {
    const head = `<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 ${this.width} ${this.height}" width="${this.width}" height="${this.height}">${origin ? `<metadata>${escaped(JSON.stringify(origin))}</metadata>` : ""}`;
    return new Blob([head, ...this.#elements, "</svg>\n"], { type: "image/svg+xml" });
  }

  #group(attributes, definition = "") {
    this.#elements.push(`${definition}<g ${attributes}>`);
    this.#open++;
  }
  #alpha() {
    return this.globalAlpha < 1 ? ` opacity="${rounded(this.globalAlpha)}"` : "";
  }
}
