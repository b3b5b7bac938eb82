// Which view the address asks for.

import { here, settle } from "./lib/address.js";
import { watch } from "./lib/connection.js";
import { h } from "./lib/dom.js";
import { JobView } from "./views/job.js";
import { Submit } from "./form/form.js";
import { Sweeps } from "./views/sweeps.js";

const VIEWS = { new: Submit, job: JobView };
const root = document.getElementById("view");
let view = null;

function show(first) {
  settle();
  const place = here();
  if (view?.takes(place)) {
    view.go(place);
    return;
  }
  view?.close();
  const View = place.path.length ? VIEWS[place.path[0]] : Sweeps;
  view = View ? new View(root, place) : nothing();
  for (const anchor of document.querySelectorAll("body > header nav a")) {
    const current = anchor.hash && anchor.hash === `#/${place.path.join("/")}`;
    if (current) anchor.setAttribute("aria-current", "page");
    else anchor.removeAttribute("aria-current");
  }
  if (!first) {
    scrollTo(0, 0);
    root.querySelector("h1")?.focus({ preventScroll: true });
  }
}

function nothing() {
  root.replaceChildren(h("h1", { tabindex: "-1" }, "There is nothing here"), h("p", {}, h("a", { href: "#/" }, "To the sweeps")));
  return { takes: () => false, go() {}, close() {}, refresh() {} };
}

// Not by its address: that one holds the view.
document.querySelector(".skip").addEventListener("click", (event) => {
  event.preventDefault();
  root.focus();
});
addEventListener("hashchange", () => show(false));
document.addEventListener("visibilitychange", () => document.hidden || view.refresh(false)); // another tab may have changed it
watch(() => view.refresh());
show(true);
