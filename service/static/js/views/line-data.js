// Lines of cells of a sweep. Complete lines are cached, so that a slider that moves back needs no request.

import { query, requestArrays } from "../lib/api.js";

const CACHE_BYTES = 64e6;
const SAME_FLIGHT = 2e-3; // rad: shorter differences between flights of a cell are not listed

const cache = new Map(); // path → line, the least recently used first
let cachedBytes = 0;

/**
 * One direction's line: the service's response with `arrays`, and `starts`, where each cell's flights begin in
 * `arrays.flight_time`. A line of too many flights has `arrays.density` ({counts, width, height}) instead, counted
 * over `window`.
 */
export async function requestLine(job, parameters, window, options) {
  const path = `/v1/jobs/${job.id}/line?${query(parameters)}`;
  const cached = cache.get(path);
  if (cached) {
    cache.delete(path);
    cache.set(path, cached);
    return cached;
  }
  const line = await requestArrays(path, options);
  line.starts = offsets(line.arrays.shown);
  if (line.arrays.density) {
    line.arrays.density = { counts: line.arrays.density, width: parameters.width, height: parameters.height };
    line.window = window ?? wholeWindow(line);
  }
  if (line.missing === 0) store(path, line);
  return line;
}

/** The distinct flight times of one cell, shortest first; null where the line came as density. */
export function flightsOf({ arrays, starts }, cell) {
  if (!arrays.flight_time) return null;
  const times = Array.from(arrays.flight_time.subarray(starts[cell], starts[cell + 1])).sort((a, b) => a - b);
  return times.filter((time, i) => i === 0 || time - times[i - 1] > SAME_FLIGHT);
}

/** Running sums of `counts`, from 0 to the total: one more than there are counts. */
function offsets(counts) {
  const sums = new Int32Array(counts.length + 1);
  for (let i = 0; i < counts.length; i++) sums[i + 1] = sums[i] + counts[i];
  return sums;
}

function store(path, line) {
  cache.set(path, line);
  cachedBytes += sizeOf(line);
  for (const [oldest, dropped] of cache) {
    if (cachedBytes <= CACHE_BYTES || cache.size === 1) break;
    cache.delete(oldest);
    cachedBytes -= sizeOf(dropped);
  }
}

const sizeOf = ({ arrays }) => arrays.values.buffer.byteLength; // all arrays share one buffer

/** The window the service counts in by default. */
function wholeWindow({ arrays: { values }, highest }) {
  return { x0: values[0], x1: values[values.length - 1], y0: 0, y1: highest };
}
