// Shows the view that belongs to the address.

import { SweepForm } from "./form/form.js";
import { takeToken } from "./lib/api.js";
import { currentAddress, discardPending } from "./lib/address.js";
import { watchConnection } from "./lib/connection.js";
import { h } from "./lib/dom.js";
import { Compare } from "./explore/compare.js";
import { Explore } from "./explore/spring.js";
import { JobView } from "./views/job.js";
import { Sweeps } from "./start/sweeps.js";

// A view is built with its root element and the address. It has handles(address): whether it shows this one too;
// show(): called when the address changes to one it handles; refresh(redraw): load again; close().
const VIEWS = { new: SweepForm, job: JobView, compare: Compare, explore: Explore };
const root = document.getElementById("view");
let view = null;

function showAddress(isFirst) {
  discardPending();
  const address = currentAddress();
  if (view?.handles(address)) {
    view.show();
    return;
  }
  view?.close();
  const View = address.path.length ? VIEWS[address.path[0]] : Sweeps;
  view = View ? new View(root, address) : notFound();
  for (const anchor of document.querySelectorAll("body > header nav a")) {
    const isCurrent = anchor.hash && anchor.hash === `#/${address.path.join("/")}`;
    if (isCurrent) anchor.setAttribute("aria-current", "page");
    else anchor.removeAttribute("aria-current");
  }
  if (!isFirst) {
    scrollTo(0, 0);
    root.querySelector("h1")?.focus({ preventScroll: true });
  }
}

function notFound() {
  root.replaceChildren(h("h1", { tabindex: "-1" }, "Page not found"), h("p", {}, h("a", { href: "#/" }, "All sweeps")));
  return { handles: () => false, show() {}, close() {}, refresh() {} };
}

// Not through the link's address, which holds the view.
document.querySelector(".skip").addEventListener("click", (event) => {
  event.preventDefault();
  root.focus();
});
addEventListener("hashchange", () => {
  takeToken();
  showAddress(false);
});
document.addEventListener("visibilitychange", () => document.hidden || view.refresh(false)); // sweeps may have changed meanwhile
watchConnection(() => view.refresh());
takeToken();
showAddress(true);
