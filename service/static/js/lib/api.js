// What the page asks of the service, and the two ways in which that can go wrong.

/** The service refused, and says why: `errors` is a list of {field, rule}. */
export class Problem extends Error {
  constructor(status, { detail, errors = [] }) {
    super(detail);
    this.status = status;
    this.errors = errors;
  }
}

/** The service did not answer at all. */
export class Lost extends Error {
  name = "Lost";
}

/** Tells of "lost", "back" and "token" (one is needed). */
export const connection = new EventTarget();

const PATIENCE = 30_000;
const TOKEN = "bounce-token";

export const setToken = (token) => sessionStorage.setItem(TOKEN, token);

/** The answer to one request; throws Problem, Lost, or an AbortError where `signal` says so. */
export async function ask(path, { method = "GET", body, signal, patience = PATIENCE, priority = "auto" } = {}) {
  const headers = {};
  if (body !== undefined) headers["Content-Type"] = "application/json";
  const token = sessionStorage.getItem(TOKEN);
  if (token) headers.Authorization = `Bearer ${token}`;
  const timeout = AbortSignal.timeout(patience);
  let answer;
  try {
    answer = await fetch(path, {
      method,
      priority,
      headers,
      body: body === undefined ? undefined : JSON.stringify(body),
      signal: signal ? AbortSignal.any([signal, timeout]) : timeout,
    });
  } catch (error) {
    if (signal?.aborted) throw error;
    throw lost();
  }
  if (answer.ok) return answer;
  if (answer.status === 401) connection.dispatchEvent(new Event("token"));
  throw new Problem(answer.status, await problemOf(answer));
}

export async function askJson(path, options) {
  const answer = await ask(path, options);
  return answer.status === 204 ? null : read(answer, "json", options?.signal);
}

/** Arrays as service/packing.py sends them: {facts…, arrays: {name: typed array}}. */
export async function askPacked(path, options) {
  const buffer = await read(await ask(path, options), "arrayBuffer", options?.signal);
  const end = new Uint8Array(buffer).indexOf(10);
  const found = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 0, end)));
  for (const [name, [type, offset, length]] of Object.entries(found.arrays)) {
    found.arrays[name] = new TYPES[type](buffer, end + 1 + offset, length);
  }
  return found;
}

const TYPES = {
  float64: Float64Array, float32: Float32Array, int32: Int32Array, int16: Int16Array, uint8: Uint8Array,
};

export const blobOf = async (path) => read(await ask(path, { patience: 600_000 }), "blob");

/** A query string of what is given; null and undefined are left out. */
export function query(given) {
  const known = Object.entries(given).filter(([, value]) => value !== null && value !== undefined && value !== "");
  return new URLSearchParams(known.map(([name, value]) => [name, String(value)])).toString();
}

/** Whether an error is told elsewhere: the banner, the token's dialog, or a request that was given up. */
export const toldElsewhere = (error) => error.name === "Lost" || error.name === "AbortError" || error.status === 401;

async function read(answer, as, signal) {
  try {
    return await answer[as]();
  } catch (error) {
    if (signal?.aborted) throw error;
    throw lost(); // it went away in the middle of its answer
  }
}

async function problemOf(answer) {
  try {
    return await answer.json();
  } catch {
    return { detail: `the service answered ${answer.status} ${answer.statusText}` };
  }
}

function lost() {
  connection.dispatchEvent(new Event("lost"));
  return new Lost("the service does not answer");
}
