// Strokes that all drawings share. A "pen" is a canvas's own context, or svg.js's, which takes the same strokes into a file.

/** A line through points, [x, y] in pixels; dashed if `dash` says so. */
export function stroke(pen, colour, width, points, dash = []) {
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.setLineDash(dash);
  path(pen, points);
  pen.stroke();
  pen.setLineDash([]);
}

/** What the points go round, filled. */
export function area(pen, colour, points, opacity = 1) {
  pen.fillStyle = colour;
  pen.globalAlpha = opacity;
  path(pen, points);
  pen.closePath();
  pen.fill();
  pen.globalAlpha = 1;
}

export function disc(pen, colour, x, y, radius) {
  pen.fillStyle = colour;
  pen.beginPath();
  pen.arc(x, y, radius, 0, 2 * Math.PI);
  pen.fill();
}

export function circle(pen, colour, width, x, y, radius) {
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.beginPath();
  pen.arc(x, y, radius, 0, 2 * Math.PI);
  pen.stroke();
}

export const upright = (pen, box, x, colour, width = 1, dash = []) =>
  stroke(pen, colour, width, [[x, box.top], [x, box.top + box.height]], dash);

/** Whatever `draw` draws, within the box only. */
export function clipped(pen, { left, top, width, height }, draw) {
  pen.save();
  pen.beginPath();
  pen.rect(left, top, width, height);
  pen.clip();
  draw();
  pen.restore();
}

/** A picture of width × height pixels, `fill(pixels)` as 32 bits each in the machine's order, stretched over [x0, x1] × [y0, y1]. */
export function picture(pen, width, height, fill, x0, y0, x1, y1) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [width, height];
  const sheet = canvas.getContext("2d");
  const image = sheet.createImageData(width, height);
  fill(new Uint32Array(image.data.buffer));
  sheet.putImageData(image, 0, 0);
  pen.imageSmoothingEnabled = false;
  pen.drawImage(canvas, x0, y0, x1 - x0, y1 - y0);
}

/** "#rrggbb" and an opacity as 32 bits (little-endian). */
export function packed(colour, opacity = 1) {
  const [r, g, b] = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
  return ((Math.round(255 * opacity) << 24) | (b << 16) | (g << 8) | r) >>> 0;
}

function path(pen, points) {
  pen.beginPath();
  points.forEach(([x, y], i) => (i ? pen.lineTo(x, y) : pen.moveTo(x, y)));
}
