// A pen that writes SVG: as much of a canvas's context as plot.js and its layers use.

const escaped = (text) => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;");
const short = (value) => String(Math.round(value * 100) / 100);
const ALIGN = { left: "start", center: "middle", right: "end" };
const SHIFT = { top: "0.9em", middle: "0.35em", alphabetic: "0", bottom: "-0.2em" };

export class SvgPen {
  fillStyle = "#000";
  strokeStyle = "#000";
  lineWidth = 1;
  globalAlpha = 1;
  font = "13px serif";
  textAlign = "left";
  textBaseline = "alphabetic";
  #out = [];
  #path = "";
  #dash = [];
  #saved = [];
  #clips = 0;
  #open = 0; // groups to be closed by the next restore

  constructor(width, height) {
    this.width = width;
    this.height = height;
  }

  save() {
    this.#saved.push([this.#open, this.#dash, this.globalAlpha]);
    this.#open = 0;
  }
  restore() {
    this.#out.push("</g>".repeat(this.#open));
    [this.#open, this.#dash, this.globalAlpha] = this.#saved.pop();
  }
  beginPath() {
    this.#path = "";
  }
  moveTo(x, y) {
    this.#path += `M${short(x)} ${short(y)}`;
  }
  lineTo(x, y) {
    this.#path += `L${short(x)} ${short(y)}`;
  }
  closePath() {
    this.#path += "Z";
  }
  rect(x, y, w, h) {
    this.#path += `M${short(x)} ${short(y)}h${short(w)}v${short(h)}h${short(-w)}Z`;
  }
  arc(x, y, r) {
    this.#path += `M${short(x - r)} ${short(y)}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0`; // always whole
  }
  clip() {
    const id = `clip${++this.#clips}`;
    this.#group(`clip-path="url(#${id})"`, `<clipPath id="${id}"><path d="${this.#path}"/></clipPath>`);
  }
  translate(x, y) {
    this.#group(`transform="translate(${short(x)} ${short(y)})"`);
  }
  rotate(angle) {
    this.#group(`transform="rotate(${short((angle * 180) / Math.PI)})"`);
  }
  setLineDash(dash) {
    this.#dash = dash;
  }
  stroke() {
    const dash = this.#dash.length ? ` stroke-dasharray="${this.#dash.join(" ")}"` : "";
    this.#out.push(
      `<path d="${this.#path}" fill="none" stroke="${this.strokeStyle}" stroke-width="${this.lineWidth}" stroke-linejoin="round"${dash}${this.#alpha()}/>`,
    );
  }
  fill() {
    this.#out.push(`<path d="${this.#path}" fill="${this.fillStyle}"${this.#alpha()}/>`);
  }
  fillRect(x, y, w, h) {
    this.#out.push(
      `<rect x="${short(x)}" y="${short(y)}" width="${short(w)}" height="${short(h)}" fill="${this.fillStyle}"${this.#alpha()}/>`,
    );
  }
  strokeRect(x, y, w, h) {
    this.beginPath();
    this.rect(x, y, w, h);
    this.stroke();
  }
  fillText(text, x, y) {
    const [, slant = "", size, family] = /^(italic )?([\d.]+)px (.*)$/.exec(this.font);
    const style = slant ? ' font-style="italic"' : "";
    this.#out.push(
      `<text x="${short(x)}" y="${short(y)}" dy="${SHIFT[this.textBaseline]}" font-size="${size}" font-family="${family.replaceAll('"', "'")}"${style} text-anchor="${ALIGN[this.textAlign]}" fill="${this.fillStyle}"${this.#alpha()}>${escaped(text)}</text>`,
    );
  }
  /** About how wide a text is, which only a reader of the file knows. */
  measureText(text) {
    return { width: 0.55 * parseFloat(/([\d.]+)px/.exec(this.font)[1]) * text.length };
  }
  /** Pictures go in as they are, a pixel staying a pixel. */
  drawImage(canvas, x, y, w, h) {
    this.#out.push(
      `<image x="${short(x)}" y="${short(y)}" width="${short(w)}" height="${short(h)}" preserveAspectRatio="none" style="image-rendering:pixelated" href="${canvas.toDataURL("image/png")}"/>`,
    );
  }
  blob() {
    const head = `<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 ${this.width} ${this.height}" width="${this.width}" height="${this.height}">`;
    return new Blob([head, ...this.#out, "</svg>\n"], { type: "image/svg+xml" });
  }

  #group(attributes, before = "") {
    this.#out.push(`${before}<g ${attributes}>`);
    this.#open++;
  }
  #alpha() {
    return this.globalAlpha < 1 ? ` opacity="${short(this.globalAlpha)}"` : "";
  }
}
