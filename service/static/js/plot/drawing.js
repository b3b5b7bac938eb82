// Drawing on the 2D context of a canvas.

const PIECE = 6; // px, of a smooth curve drawn as a line

/** Canvas pixels per CSS pixel, at most two: more costs time and shows no difference. */
export const pixelRatio = () => Math.min(devicePixelRatio || 1, 2);

/** The cleared context of a canvas resized to `width` × `height` CSS pixels. */
export function resizedContext(canvas, width, height, ratio = pixelRatio()) {
  const [columns, rows] = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== columns || canvas.height !== rows) {
    [canvas.width, canvas.height] = [columns, rows];
    canvas.style.height = `${height}px`;
  }
  const ctx = canvas.getContext("2d");
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  ctx.clearRect(0, 0, width, height);
  return ctx;
}

/** A PNG that says what it shows, in an iTXt chunk after its header of 33 bytes. */
export function described(png, text) {
  const chunk = new TextEncoder().encode(`iTXtDescription\0\0\0\0\0${text}`);
  const divided = (rest) => (rest >>> 1) ^ (rest & 1 ? 0xedb88320 : 0); // by the polynomial of CRC-32
  const crc = chunk.reduce((rest, byte) => Array(8).fill().reduce(divided, rest ^ byte), -1);
  const [length, check] = [chunk.length - 4, ~crc].map((value) => [24, 16, 8, 0].map((bits) => (value >> bits) & 255));
  return new Blob([png.slice(0, 33), Uint8Array.from(length), chunk, Uint8Array.from(check), png.slice(33)], { type: "image/png" });
}

/** A polyline through `points`, [x, y] in pixels, interrupted where one is null; `dash` as in setLineDash. */
export function polyline(ctx, colour, width, points, dash = []) {
  ctx.strokeStyle = colour;
  ctx.lineWidth = width;
  ctx.setLineDash(dash);
  path(ctx, points);
  ctx.stroke();
  ctx.setLineDash([]);
}

/** The smooth curve through `points`, [x, y] in axis values or null, in pixels; null where it is outside the box. */
export function curve(points, box) {
  const pixels = [];
  const add = (piece, halvings) => { // within the hull of its four points
    const [xs, ys] = [piece.map(([x]) => box.x.pixel(x)), piece.map(([, y]) => box.y.pixel(y))];
    const [left, right, top, bottom] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    if (right < box.left || left > box.left + box.width || bottom < box.top || top > box.top + box.height) pixels.push(null);
    else if (halvings && Math.max(right - left, bottom - top) > PIECE) for (const half of halves(piece)) add(half, halvings - 1);
    else pixels.push(...(pixels.at(-1) ? [] : [[xs[0], ys[0]]]), [xs[3], ys[3]]);
  };
  for (let i = 1; i < points.length; i++) {
    if (points[i - 1] && points[i]) add(cubic(points, i), 50);
    else pixels.push(null);
  }
  return pixels;
}

const mixed = (a, b) => [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2];

/** Both halves of a Bézier curve. */
function halves([a, b, c, d]) {
  const [ab, bc, cd] = [mixed(a, b), mixed(b, c), mixed(c, d)];
  const [abc, bcd] = [mixed(ab, bc), mixed(bc, cd)];
  const middle = mixed(abc, bcd);
  return [[a, ab, abc, middle], [middle, bcd, cd, d]];
}

/** The Bézier curve from the point before `i` to that at `i`, of the cubic through their neighbours too: of y, as closed forms are. */
function cubic(points, i) {
  const [from, to] = [points[i - 1], points[i]];
  const distance = (a, b) => Math.hypot(0.01 * (a[0] - b[0]), a[1] - b[1]); // where y is the same, of x
  const nodes = [[0, from], [1, to]];
  const add = (neighbour, end, at) => {
    const beyond = neighbour ? distance(neighbour, end) / distance(from, to) : 0;
    if (beyond > 0.01 && beyond < 100) nodes.push([at(beyond), neighbour]); // others add rounding
  };
  add(points[i - 2], from, (beyond) => -beyond);
  add(points[i + 1], to, (beyond) => 1 + beyond);
  const weight = (t, node) => nodes.reduce((product, [other]) => (other === node ? product : (product * (t - other)) / (node - other)), 1);
  const [first, second] = [1 / 3, 2 / 3].map((t) => [0, 1].map((axis) => nodes.reduce((sum, [node, point]) => sum + weight(t, node) * point[axis], 0)));
  const control = (near, far, a, b) => [0, 1].map((axis) => (-5 * near[axis] + 18 * a[axis] - 9 * b[axis] + 2 * far[axis]) / 6);
  return [from, control(from, to, first, second), control(to, from, second, first), to];
}

export function polygon(ctx, colour, points, opacity = 1) {
  ctx.fillStyle = colour;
  ctx.globalAlpha = opacity;
  path(ctx, points);
  ctx.closePath();
  ctx.fill();
  ctx.globalAlpha = 1;
}

export function disc(ctx, colour, x, y, radius) {
  ctx.fillStyle = colour;
  ctx.beginPath();
  ctx.arc(x, y, radius, 0, 2 * Math.PI);
  ctx.fill();
}

export const isInBox = (x, y, { left, top, width, height }) => x >= left && x <= left + width && y >= top && y <= top + height;
export const CURVE_DASH = [7, 4]; // px, of the threshold over Ω
export const legendLine = (ctx, colour, width, x, y, dash = []) => polyline(ctx, colour, width, [[x, y], [x + 24, y]], dash);

export function circle(ctx, colour, width, x, y, radius) {
  ctx.strokeStyle = colour;
  ctx.lineWidth = width;
  ctx.beginPath();
  ctx.arc(x, y, radius, 0, 2 * Math.PI);
  ctx.stroke();
}

export const verticalLine = (ctx, box, x, colour, width = 1, dash = []) =>
  polyline(ctx, colour, width, [[x, box.top], [x, box.top + box.height]], dash);

export function clipped(ctx, { left, top, width, height }, draw) {
  ctx.save();
  ctx.beginPath();
  ctx.rect(left, top, width, height);
  ctx.clip();
  draw();
  ctx.restore();
}

/** A bitmap of `width` × `height` pixels over [x0, x1] × [y0, y1]; `fill(pixels)` writes their colours (see `rgba32`). */
export function bitmap(ctx, width, height, fill, x0, y0, x1, y1) {
  const canvas = new OffscreenCanvas(width, height);
  const target = canvas.getContext("2d");
  const image = target.createImageData(width, height);
  fill(new Uint32Array(image.data.buffer));
  target.putImageData(image, 0, 0);
  ctx.imageSmoothingEnabled = false;
  ctx.drawImage(canvas, x0, y0, x1 - x0, y1 - y0);
}

/** "#rrggbb" and an opacity as 32 bits; every platform with a browser is little-endian. */
export function rgba32(colour, opacity = 1) {
  const [r, g, b] = [1, 3, 5].map((i) => parseInt(colour.slice(i, i + 2), 16));
  return ((Math.round(255 * opacity) << 24) | (b << 16) | (g << 8) | r) >>> 0;
}

function path(ctx, points) {
  ctx.beginPath();
  points.forEach((point, i) => {
    if (point && points[i - 1]) ctx.lineTo(...point);
    else if (point) ctx.moveTo(...point);
  });
}
