// The start page: a preview, the presets, and the list of sweeps.

import { link } from "../lib/address.js";
import { h } from "../lib/dom.js";
import { loadPresets } from "../form/catalogue.js";
import { Preview } from "../motion/preview.js";
import { SweepList } from "./sweep-list.js";

export class Sweeps {
  constructor(root) {
    document.title = "Bouncing spring";
    this.presets = h("ul", {});
    this.sweeps = new SweepList();
    this.preview = new Preview();
    root.replaceChildren(
      h("div", { className: "start" }, h("section", { className: "intro" },
        h("h1", { tabindex: "-1" }, "A spring bouncing on a vibrating plate"),
        h("p", {}, "Two masses joined by a spring and a dashpot bounce on a plate that vibrates. Their flight times and modes depend on the plate’s acceleration ", h("i", {}, "Γ"), ", its frequency ", h("i", {}, "Ω"), " and the damping ", h("i", {}, "ξ"), ". Compute sweeps of these parameters and explore the results."),
        h("p", {}, h("a", { className: "button", href: link(["new"]) }, "New sweep"))),
      this.preview.element),
      h("section", { className: "presets", "aria-labelledby": "presets" },
        h("h2", { id: "presets" }, "Presets"),
        this.presets),
      this.sweeps.element);
    this.refresh();
  }

  close() {
    this.preview.close();
    this.sweeps.close();
  }

  refresh() {
    this.preview.refresh();
    if (!this.presets.hasChildNodes()) this.#showPresets();
    this.sweeps.refresh();
  }

  async #showPresets() {
    try {
      this.presets.replaceChildren(...(await loadPresets()).map(({ label, title, sweeps: [first] }) =>
        h("li", {}, h("a", { href: link(["new"], { figure: first.key }) }, h("b", {}, label), h("span", {}, title)))));
    } catch (error) {
      this.sweeps.showError(error);
    }
  }
}
