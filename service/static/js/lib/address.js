// The address bar holds the view: #/job/ID/diagram?omega=0.5. A link shows the same.

import { query as encoded } from "./api.js";
import { debounced } from "./dom.js";

/** Where we are: {path: ["job", ID, "diagram"], query: {omega: "0.5"}}. */
export function here() {
  const [path, query = ""] = location.hash.replace(/^#\/?/, "").split("?");
  return { path: path.split("/").filter(Boolean), query: Object.fromEntries(new URLSearchParams(query)) };
}

export function link(path, query = {}) {
  const text = encoded(query).replaceAll("%2C", ",");
  return `#/${path.join("/")}${text ? `?${text}` : ""}`;
}

export function go(path, query = {}) {
  location.hash = link(path, query);
}

// Browsers ration changes of the address: a slider makes hundreds.
const write = debounced(120, (target) => history.replaceState(null, "", target));
let pending = null;

/** Change what the address says of this view, without a new entry in the history; null removes. */
export function note(changes) {
  pending ??= here();
  pending.query = { ...pending.query, ...changes };
  write(link(pending.path, pending.query));
}

/** Change the whole address at once, without a new entry in the history. */
export function replace(path, query = {}) {
  settle();
  history.replaceState(null, "", link(path, query));
}

/** What the address says or is about to say. */
export const noted = () => (pending ?? here()).query;

/** Forget what was to be written: the view it was about is left. */
export function settle() {
  write.cancel();
  pending = null;
}
