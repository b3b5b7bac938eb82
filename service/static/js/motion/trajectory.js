// The motion of one cell from the service, which computes few of them at a time.

import { askJson } from "../lib/api.js";

const PATIENCE = 180_000; // ms: the first motion may wait for a compiler
const PAUSE = 700; // ms, when the service is busy with others

/** As askJson; where the service has its hands full (429) it is asked again. */
export async function trajectory(path, options = {}) {
  const until = performance.now() + PATIENCE;
  for (;;) {
    try {
      return await askJson(path, { ...options, patience: PATIENCE });
    } catch (error) {
      if (error.status !== 429 || options.signal?.aborted || performance.now() > until) throw error;
      await new Promise((done) => setTimeout(done, PAUSE));
    }
  }
}
