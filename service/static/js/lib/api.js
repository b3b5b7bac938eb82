// Requests to the service, and their errors.

import { AXES } from "./physics.js";

// Dispatches "unreachable" when a request gets no answer, "waiting" when what requests wait for has changed, with
// `detail`, the last reason or undefined, and "unauthorized" when the service requires a token; `detail.refused`: not the one that it got.
export const connection = new EventTarget();

/** What a file holds that was shared: {job, answers, note, about}; null where there is a service. */
export const shared = JSON.parse(document.getElementById("shared")?.textContent ?? "null");
/** The address of the service, which may have a path behind a proxy; of a shared file the usual one. */
export const SERVICE = shared ? "http://127.0.0.1:8000" : location.origin + location.pathname.replace(/\/$/, "");
const TIMEOUT_MS = 30_000;
const DOWNLOAD_TIMEOUT_MS = 600_000;
const TOKEN_KEY = "bounce-token";
export const hasToken = () => sessionStorage.getItem(TOKEN_KEY) !== null;
export const setToken = (token) => sessionStorage.setItem(TOKEN_KEY, token.replace(/[^!-~]/g, "?")); // headers hold no others

/** Keep the token of an address #token=…, as `bounce open` opens it, remove it from the address, and close the dialog that asks for it. */
export function takeToken() {
  const token = new URLSearchParams(location.hash.slice(1)).get("token");
  if (token === null) return;
  setToken(token);
  history.replaceState(null, "", "#/");
  document.getElementById("token")?.close("given");
}

const RETRY_S = 1; // without a Retry-After
const BUSY = "The service is busy with other requests. Waiting for its answer …";
const waiting = new Map(); // by request, why it waits

// The response to one request. A GET, or what `waits`, is repeated: while workers compute its answer (202), and until
// `timeout` while the service is too busy (429, a proxy's 503). Throws a problem, Unreachable, or AbortError by `signal`.
export const request = (path, { timeout = TIMEOUT_MS, waits, ...options } = {}) => answer(path, options, timeout, waits).finally(() => tell(options));

async function answer(path, options, timeout, waits) {
  const isRepeated = waits ?? (options.method ?? "GET") === "GET";
  let deadline = performance.now() + timeout;
  for (;;) {
    const response = await send(path, options, deadline - performance.now());
    const pause = 1000 * Math.max(Number(response.headers.get("Retry-After")) || RETRY_S, 0.1);
    const left = deadline - performance.now();
    if (response.status === 202 && isRepeated) {
      const { notice } = await answered(response.json(), options.signal);
      tell(options, notice ? `Nothing is computed now: ${notice}.` : undefined);
      await sleep(pause);
      deadline = performance.now() + timeout;
    } else if (response.ok) return response;
    else if ((response.status === 429 || (response.status === 503 && !response.headers.get("Content-Type")?.includes("json"))) && isRepeated && left > 0) {
      tell(options, BUSY);
      await sleep(Math.min(pause, left));
    } else throw await problemOf(response);
  }
}

/** The answer in a shared file that is nearest to the requested values. */
function sharedAnswer(path) {
  const { pathname, searchParams } = new URL(path, "file:///");
  const [, , , id, name] = pathname.split("/");
  if (id === shared.job.id && !name) return Response.json(shared.job);
  const away = (answer, axis) => (axis in answer ? Math.abs(answer[axis] - Number(searchParams.get(axis))) : 0);
  const distance = (answer) => AXES.reduce((sum, axis) => sum + away(answer, axis), 0);
  const isAsked = ({ direction }) => !direction || direction === searchParams.get("direction");
  const [nearest] = (shared.answers[name] ?? []).filter(isAsked).sort((a, b) => distance(a) - distance(b));
  if (!nearest) return Response.json({ detail: "A shared file does not hold this: open the sweep in a service." }, { status: 404 });
  const bytes = Uint8Array.from(atob(nearest.data), (character) => character.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip")));
}

async function send(path, { method = "GET", body, signal }, timeout) {
  if (shared) return answered(new Promise((done) => done(sharedAnswer(path))), signal);
  const token = sessionStorage.getItem(TOKEN_KEY);
  const type = body instanceof Blob ? "application/octet-stream" : "application/json";
  const headers = { ...(body !== undefined && { "Content-Type": type }), ...(token && { Authorization: `Bearer ${token}` }) };
  const timer = AbortSignal.timeout(Math.max(timeout, 1));
  const response = await answered(fetch(SERVICE + path, {
    method, headers,
    body: body instanceof Blob || typeof body === "string" ? body : JSON.stringify(body), // of undefined: undefined
    signal: signal ? AbortSignal.any([signal, timer]) : timer,
  }), signal);
  if (response.status === 502) await answered(Promise.reject(new DOMException("", "AbortError")), signal); // a proxy reached no service
  const isReplaced = token !== sessionStorage.getItem(TOKEN_KEY); // meanwhile: the page asks again with the new one
  if (response.status === 401 && !isReplaced) connection.dispatchEvent(new CustomEvent("unauthorized", { detail: { refused: token !== null } }));
  return response;
}

/** What `promise` gives; Unreachable if the connection fails, unless `signal` aborted the request or it is of a shared file. */
const answered = (promise, signal) => promise.catch((error) => {
  if (signal?.aborted) throw error;
  if (shared) throw Object.assign(new Error("This file is damaged: ask for it again."), { status: 422 });
  connection.dispatchEvent(new Event("unreachable"));
  throw new DOMException("the service does not answer", "Unreachable");
});

function tell(request, why) {
  if (waiting.get(request) === why) return;
  waiting[why ? "set" : "delete"](request, why);
  connection.dispatchEvent(new CustomEvent("waiting", { detail: [...waiting.values()].at(-1) }));
}

export const sleep = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

export async function requestJson(path, options) {
  const response = await request(path, options);
  return response.status === 204 ? null : answered(response.json(), options?.signal);
}

/** Delete a job, unless that has been done elsewhere. */
export const deleteJob = ({ id }) => requestJson(`/v1/jobs/${id}`, { method: "DELETE" }).catch((error) => {
  if (error.status !== 404) throw error;
});

const ARRAY_TYPES = { float64: Float64Array, float32: Float32Array, int64: BigInt64Array, int32: Int32Array, int16: Int16Array, uint8: Uint8Array, bool: Uint8Array };

/** A result in the binary form of service/views/encode.py: {attrs, dims, …}, and by name every coordinate and variable
 * as {data, dims, shape, attrs}; `data` is a flat typed array, or of scalars and texts the value or list. */
export async function requestDataset(path, options) {
  const response = await request(`${path}${path.includes("?") ? "&" : "?"}format=bin`, options);
  const buffer = await answered(response.arrayBuffer(), options?.signal);
  const end = new Uint8Array(buffer).indexOf(10); // the header is one line of JSON
  const { coords, data_vars, ...result } = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 0, end)));
  for (const [name, variable] of Object.entries({ ...coords, ...data_vars })) {
    const { shape = [], offset } = variable.data ?? {};
    const length = shape.reduce((product, n) => product * n, 1);
    result[name] = offset === undefined ? variable : { ...variable, shape, data: new ARRAY_TYPES[variable.dtype](buffer, end + 1 + offset, length) };
  }
  return result;
}

/** The parts of a result along a dimension, one object per index: of each variable that begins with it the value, or the
 * part of a flat array, without the dimension in its name. A result without this dimension has one part, all of it. */
export function partsOf({ attrs, dims, ...variables }, dim) {
  if (!(dim in dims)) return [Object.fromEntries(Object.entries(variables).map(([name, { data }]) => [name, data]))];
  const divided = Object.entries(variables).filter(([, variable]) => variable.dims[0] === dim).map(([name, variable]) => [name.replace(`${dim}_`, ""), variable]);
  const part = ({ data, shape = [] }, i) => (shape.length > 1 ? data.subarray((i * data.length) / dims[dim], ((i + 1) * data.length) / dims[dim]) : data[i]);
  return Array.from({ length: dims[dim] }, (_, i) => Object.fromEntries(divided.map(([name, variable]) => [name, part(variable, i)])));
}

export const requestBlob = async (path, options) => answered((await request(path, { ...options, timeout: DOWNLOAD_TIMEOUT_MS })).blob());

/** A query string; null, undefined and empty values are left out. */
export const query = (values) => new URLSearchParams(Object.entries(values).filter(([, value]) => (value ?? "") !== "")).toString();

/** Whether a view need not show this error: the banner or the token dialog does, or the request was aborted on purpose. */
export const isHandledElsewhere = (error) => error.name === "Unreachable" || error.name === "AbortError" || error.status === 401;

/** Why the service refused a request: an Error with its message, the HTTP `status`, and `errors`, a list of {field, rule, code}. */
async function problemOf(response) {
  const { status, statusText } = response;
  const { detail, errors = [] } = await response.json().catch(() => ({ detail: `the answer was ${status} ${statusText}, as of a proxy` }));
  return Object.assign(new Error(detail), { status, errors });
}
