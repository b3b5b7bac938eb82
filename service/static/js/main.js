// Shows the page that belongs to the address.

import { dropped } from "./form/pasted.js";
import { connection, shared, takeToken } from "./lib/api.js";
import { currentAddress, discardPending, navigate, replace } from "./lib/address.js";
import { watchConnection } from "./lib/connection.js";
import { h } from "./lib/dom.js";

// A page is built with its root element, the address and a signal that is aborted when the page is left. It has
// refresh(redraw): load again; and, where the address may change to another state of the same page, show(). Without the
// names of every object, such as constructor.
const PAGES = {
  __proto__: null,
  "": async () => (await import("./start/sweeps.js")).SweepList,
  new: async () => (await import("./form/form.js")).SweepForm,
  job: async () => (await import("./views/job.js")).JobView,
  compare: async () => (await import("./explore/compare.js")).Compare,
  explore: async () => (await import("./explore/spring.js")).Explore,
};
const REST_MS = 2000; // after the first page the others are loaded
const root = document.getElementById("view");
let page = null; // while it is loaded
let shown = null; // which page
let leaving = new AbortController(); // it

async function showAddress() {
  discardPending();
  if (shared && currentAddress().path[1] !== shared.job.id) replace(["job", shared.job.id]);
  const address = currentAddress();
  const [name = "", id] = address.path;
  const wanted = [name, name === "job" && id, address.query.jobs].join();
  if (wanted === shown) {
    page?.show?.();
    return;
  }
  leaving.abort();
  leaving = new AbortController();
  document.getElementById("bar").replaceChildren();
  root.dataset.page = name;
  const isFirst = shown === null;
  [page, shown] = [null, wanted];
  const load = (name !== "job" || id ? PAGES[name] : null) ?? (async () => NotFound);
  const Page = await load().catch(() => connection.dispatchEvent(new Event("unreachable")) && null);
  if (!Page || page || wanted !== shown) return; // the service is away; built, or left, meanwhile
  page = new Page(root, currentAddress(), leaving.signal);
  for (const anchor of document.querySelectorAll("body > header nav a")) {
    if (anchor.hash && anchor.hash === `#/${address.path.join("/")}`) anchor.setAttribute("aria-current", "page");
    else anchor.removeAttribute("aria-current");
  }
  if (isFirst) setTimeout(() => Object.values(PAGES).forEach((load) => load().catch(() => null)), REST_MS); // while the service answers
  else {
    scrollTo(0, 0);
    document.querySelector("h1")?.focus({ preventScroll: true });
  }
}

/** Of several views, the one that is dropped on, or else the first. */
function takeMeasured(file, target) {
  const views = [page?.view, ...(page?.views ?? [])].filter((view) => view?.measured);
  const view = views.find(({ plot }) => plot.element.contains(target)) ?? views[0];
  if (view) return view.measured.take(file);
  const problem = page?.problem ?? page?.view?.problem;
  problem?.showInView(new Error(`${file.name}: drop measured points on a diagram or on thresholds.`));
}

class NotFound {
  constructor() {
    root.replaceChildren(h("h1", { tabindex: "-1" }, "Page not found"), h("p", {}, h("a", { href: "#/" }, "All sweeps")));
  }

  refresh() {}
}

// Not through the link's address, which holds the view.
document.querySelector(".skip").addEventListener("click", (event) => {
  event.preventDefault();
  root.focus();
});
addEventListener("hashchange", () => {
  takeToken();
  showAddress();
});
// Measured points that are dropped are for the view; a specification or a shared file is for the form.
addEventListener("dragover", (event) => event.dataTransfer.types.includes("Files") && event.preventDefault());
addEventListener("drop", (event) => {
  const [file] = event.dataTransfer.files;
  if (!file) return;
  event.preventDefault();
  if (/\.csv$/i.test(file.name)) return takeMeasured(file, event.target);
  if (shared) return;
  dropped.file = file;
  if (page?.pasted) page.pasted.takeDropped();
  else navigate(["new"]);
});
document.addEventListener("visibilitychange", () => document.hidden || page?.refresh(false)); // sweeps may have changed meanwhile
watchConnection(() => (page ? page.refresh() : location.reload())); // a browser may not load again what it could not
takeToken();
showAddress();
