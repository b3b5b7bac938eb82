// Lines of cells from the service; those of finished jobs are kept for a while, so that sliders run back freely.

import { askPacked, query } from "../lib/api.js";
import { starts } from "../plot/flights.js";

const KEPT_BYTES = 64e6;
const kept = new Map(); // the last used last
let bytes = 0;

/** One direction's line: {arrays, starts, window (for density), points, highest, fixed, missing}. */
export async function lineOf(job, asked, window, options) {
  const path = `/v1/jobs/${job.id}/line?${query(asked)}`;
  const known = kept.get(path);
  if (known) {
    kept.delete(path);
    kept.set(path, known);
    return known;
  }
  const line = await askPacked(path, options);
  line.starts = starts(line.arrays.shown);
  if (line.arrays.density) {
    line.arrays.density = { counts: line.arrays.density, width: asked.width, height: asked.height };
    line.window = window ?? wholeOf(line);
  }
  if (line.missing === 0) keep(path, line);
  return line;
}

function keep(path, line) {
  kept.set(path, line);
  bytes += sizeOf(line);
  for (const [oldest, dropped] of kept) {
    if (bytes <= KEPT_BYTES || kept.size === 1) break;
    kept.delete(oldest);
    bytes -= sizeOf(dropped);
  }
}

const sizeOf = ({ arrays }) => arrays.values.buffer.byteLength;

/** The window that the service counts in when none is asked for. */
function wholeOf({ arrays: { values }, highest }) {
  return { x0: values[0], x1: values[values.length - 1], y0: 0, y1: highest };
}
