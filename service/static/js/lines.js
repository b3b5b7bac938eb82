// Lines of cells from the service; those of finished jobs are kept for a while, so that sliders run back freely.

import { askPacked, query } from "./api.js";
import { starts } from "./flights.js";

const KEPT = 80;
const kept = new Map();

/** One direction's line: {arrays, starts, window (for density), points, highest, fixed, missing}. */
export async function lineOf(job, asked, window, signal) {
  const path = `/v1/jobs/${job.id}/line?${query(asked)}`;
  if (kept.has(path)) return kept.get(path);
  const line = await askPacked(path, { signal });
  line.starts = starts(line.arrays.shown);
  if (line.arrays.density) {
    line.arrays.density = { counts: line.arrays.density, width: asked.width, height: asked.height };
    line.window = window ?? wholeOf(line);
  }
  if (line.missing === 0) {
    kept.set(path, line);
    if (kept.size > KEPT) kept.delete(kept.keys().next().value);
  }
  return line;
}

/** The window that the service counts in when none is asked for. */
function wholeOf({ arrays: { values }, highest }) {
  return { x0: values[0], x1: values[values.length - 1], y0: 0, y1: highest };
}
