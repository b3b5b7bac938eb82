// A plot as a file on white paper, whatever the screen shows.

import { FONT } from "./frame.js";
import { SvgPen } from "./svg.js";
import { theme } from "./theme.js";

const WIDTH = 1000;
const DOTS = 2;
const ROW = 24; // of explained colours
const IN_A_ROW = 7;

export async function pngOf(plot) {
  const { height, rows } = sizeOf(plot);
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [DOTS * WIDTH, DOTS * (height + rows)];
  const pen = canvas.getContext("2d");
  pen.scale(DOTS, DOTS);
  paint(plot, pen, height, rows);
  return new Promise((done) => canvas.toBlob(done, "image/png"));
}

export function svgOf(plot) {
  const { height, rows } = sizeOf(plot);
  const pen = new SvgPen(WIDTH, height + rows);
  paint(plot, pen, height, rows);
  return pen.blob();
}

function sizeOf(plot) {
  const colours = plot.content()?.colours?.length ?? 0;
  return { height: Math.round(WIDTH * plot.ratio), rows: Math.ceil(colours / IN_A_ROW) * ROW };
}

function paint(plot, pen, height, rows) {
  const paper = theme(true);
  plot.paint(pen, WIDTH, height, paper, DOTS);
  pen.fillStyle = paper.paper;
  pen.fillRect(0, height, WIDTH, rows);
  pen.font = `${FONT}px ${paper.serif}`;
  pen.textAlign = "left";
  pen.textBaseline = "middle";
  (plot.content()?.colours ?? []).forEach(([name, colour], i) => {
    const [x, y] = [58 + (i % IN_A_ROW) * ((WIDTH - 80) / IN_A_ROW), height + (Math.floor(i / IN_A_ROW) + 0.4) * ROW];
    pen.fillStyle = colour(paper);
    pen.fillRect(x, y - 6, 12, 12);
    pen.fillStyle = paper.ink;
    pen.fillText(name, x + 18, y);
  });
}
