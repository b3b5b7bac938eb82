// Shows the page that belongs to the address.

import { dropped } from "./form/pasted.js";
import { connection, shared, takeToken } from "./lib/api.js";
import { currentAddress, discardPending, link, navigate } from "./lib/address.js";
import { watchConnection } from "./lib/connection.js";
import { h, keepFocus } from "./lib/dom.js";

// A page is built with its root element, the address and a signal that is aborted when the page is left. It has
// refresh(redraw): load again; and, where the address may change to another state of the same page, show().
const PAGES = {
  __proto__: null, // #/constructor is no page
  "": async () => (await import("./start/sweeps.js")).SweepList,
  new: async () => (await import("./form/form.js")).SweepForm,
  job: async () => (await import("./views/job.js")).JobView,
  compare: async () => (await import("./explore/compare.js")).Compare,
  explore: async () => (await import("./explore/spring.js")).Explore,
};
const REST_MS = 2000; // after the first page the others are loaded
const root = document.getElementById("view");
let page = null; // also while its script is loaded
let shown = null; // what the address has of the page that is shown or loaded
let leaving = new AbortController(); // aborted when the page is left

async function showAddress() {
  discardPending();
  if (shared && currentAddress().path[1] !== shared.job.id) history.replaceState(null, "", link(["job", shared.job.id]));
  const address = currentAddress();
  const [name = "", id] = address.path;
  const wanted = [name, name === "job" && id, address.query.jobs].join();
  if (wanted === shown) return keepFocus(root, () => page?.show?.(), () => root.querySelector("[aria-current], .plot"));
  leaving.abort();
  leaving = new AbortController();
  document.getElementById("bar").replaceChildren();
  root.dataset.page = name;
  const isFirst = shown === null;
  [page, shown] = [null, wanted];
  const loadPage = (name !== "job" || id ? PAGES[name] : null) ?? (async () => NotFound);
  const Page = await loadPage().catch(() => connection.dispatchEvent(new Event("unreachable")) && null);
  if (!Page || page || wanted !== shown) return; // the service does not answer; the page was built, or left, meanwhile
  page = new Page(root, { ...currentAddress(), path: address.path }, leaving.signal);
  for (const anchor of document.querySelectorAll("body > header nav a")) {
    anchor.ariaCurrent = anchor.hash === `#/${address.path.join("/")}` ? "page" : null;
  }
  if (isFirst) setTimeout(() => Object.values(PAGES).forEach((load) => load().catch(() => null)), REST_MS); // while the service answers
  else {
    scrollTo(0, 0);
    document.querySelector("h1")?.focus({ preventScroll: true });
  }
}

/** Measured points are for the view that they are dropped on, or else for the first one. */
function takeMeasured(file, target) {
  const views = [page?.view, ...(page?.views ?? [])].filter((view) => view?.measured);
  const view = views.find(({ plot }) => plot.element.contains(target)) ?? views[0];
  if (view) return view.measured.take(file);
  const problem = page?.problem ?? page?.view?.problem;
  problem?.showInView(new Error(`${file.name}: drop measured points on a diagram or on thresholds.`));
}

function NotFound() {
  document.title = "Page not found · Bouncing spring";
  root.replaceChildren(h("h1", { tabindex: "-1" }, "Page not found"), h("p", {}, h("a", { href: "#/" }, "All sweeps")));
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
// Without this, the browser would open the file.
addEventListener("dragover", (event) => event.dataTransfer.types.includes("Files") && event.preventDefault());
addEventListener("drop", (event) => {
  const [file] = event.dataTransfer.files;
  if (!file) return;
  event.preventDefault();
  if (/\.csv$/i.test(file.name)) return takeMeasured(file, event.target);
  if (shared) return; // a specification or a shared file is for the form of a service
  dropped.file = file;
  if (page?.pasted) page.pasted.takeFile();
  else navigate(["new"]);
});
document.addEventListener("visibilitychange", () => document.hidden || page?.refresh?.(false)); // sweeps may have changed meanwhile
watchConnection(() => (page?.refresh ? page.refresh() : location.reload())); // a browser may not load again what it could not
takeToken();
showAddress();
