// The form: a sweep, what it will cost, and what the service thinks of it, field by field.

import { go, link, note, noted, replace } from "../lib/address.js";
import { askJson, toldElsewhere } from "../lib/api.js";
import { axisField } from "./axis-field.js";
import { debounced, h, say } from "../lib/dom.js";
import { showProblems } from "./problems.js";
import { bytes, plural, seconds } from "../lib/format.js";
import { modelField, plainField, protocolField } from "./fields.js";
import { presets } from "./catalogue.js";

const DEFAULTS = {
  name: "", gamma: { start: 1, stop: 6, num: 501, spacing: "linear" }, omega: 0.5, xi: 0.26, protocol: { kind: "rest" },
  model: { kind: "soft" }, settle: 200, observe: 100, keep: 64, micro_flight: 0, settle_tolerance: 0,
};

export class Submit {
  touched = new Set(); // names of fields that somebody typed into since the form was last filled

  constructor(root) {
    document.title = "New sweep · Bouncing spring";
    this.fields = {
      name: plainField("name", "Name", "a label of your own", { type: "text", maxlength: 200, size: 32 }),
      gamma: axisField("gamma"),
      omega: axisField("omega"),
      xi: axisField("xi"),
      protocol: protocolField(),
      model: modelField(),
      settle: plainField("settle", "Settle for", "plate periods, discarded"),
      observe: plainField("observe", "Observe", "plate periods, recorded"),
      keep: plainField("keep", "Keep", "last flights of each cell"),
      micro_flight: plainField("micro_flight", "Micro-flights", "rad; shorter ones do not count in the mode"),
      settle_tolerance: plainField("settle_tolerance", "Settle early", "rad; once flights repeat within this; 0: never"),
    };
    this.cost = h("p", { className: "cost", role: "status" }, "…");
    this.button = h("button", { type: "submit", className: "button" }, "Compute");
    this.problem = h("p", { className: "problem", role: "alert", hidden: true });
    this.json = h("pre", { tabindex: "0", "aria-label": "The sweep as JSON" });
    const { name, gamma, omega, xi, protocol, model, ...window } = this.fields;
    this.form = h("form", { className: "sweep", novalidate: true, onsubmit: (event) => this.#submit(event), oninput: (event) => this.#typed(event), onchange: (event) => this.#typed(event) },
      name.element, gamma.element, omega.element, xi.element, protocol.element, model.element,
      h("fieldset", { className: "plain" }, h("legend", {}, "Window"), Object.values(window).map((field) => field.element)),
      this.problem,
      h("div", { className: "send" }, this.button, this.cost));
    root.replaceChildren(
      h("p", { className: "back" }, h("a", { href: link([]) }, "← All sweeps")),
      h("h1", { tabindex: "-1" }, "New sweep"),
      this.#presets(), this.form,
      h("details", {}, h("summary", {}, "As JSON, for the command line"), this.json));
    this.estimate = debounced(220, () => this.#estimate());
    this.#write({});
    this.#start();
  }

  takes({ path }) {
    return path[0] === "new";
  }

  go() {
    this.touched.clear();
    this.#start();
  }

  refresh() {
    if (this.started) this.estimate();
    else this.#start();
  }

  close() {
    this.closed = true;
    this.estimate.cancel();
    this.asking?.abort();
  }

  #presets() {
    this.preset = h("select", { id: "preset", onchange: (event) => { note({ figure: event.target.value || null, from: null }); this.go(); } });
    return h("p", { className: "preset" }, h("label", { for: "preset" }, "Start from "), this.preset);
  }

  /** Fill the form, but for what was typed meanwhile: from the figure or the sweep that the address names. */
  async #start() {
    const { figure, from } = noted();
    const elsewhere = () => this.closed || noted().figure !== figure || noted().from !== from;
    try {
      const groups = await presets();
      const job = from && (await askJson(`/v1/jobs/${from}`));
      if (elsewhere()) return;
      this.preset.replaceChildren(h("option", { value: "" }, "nothing in particular"), ...groups.map(({ label, title, sweeps }) =>
        h("optgroup", { label: `${label}: ${title}` }, sweeps.map(({ key, spec }) => h("option", { value: key, selected: key === figure }, spec.name)))));
      this.#write((job || groups.flatMap(({ sweeps }) => sweeps).find(({ key }) => key === figure))?.spec ?? {});
      this.started = true;
    } catch (error) {
      this.#tell(error);
    }
  }

  #write(spec) {
    for (const [name, field] of Object.entries(this.fields)) {
      if (!this.touched.has(name)) field.write(spec[name] ?? DEFAULTS[name]);
    }
    this.#changed();
  }

  #typed({ target }) {
    const [name] = Object.entries(this.fields).find(([, field]) => field.element.contains(target));
    this.touched.add(name);
    this.#changed();
  }

  #read() {
    return Object.fromEntries(Object.entries(this.fields).map(([name, field]) => [name, field.read()]).filter(([, value]) => value !== null));
  }

  #changed() {
    this.json.textContent = JSON.stringify(this.#read(), null, 2);
    this.estimate();
  }

  async #estimate() {
    this.asking?.abort();
    this.asking = new AbortController();
    try {
      const cost = await askJson("/v1/jobs?validate_only=true", { method: "POST", body: this.#read(), signal: this.asking.signal });
      showProblems(this.form, this.problem, null);
      const basis = cost.basis === "measured" ? "as measured here" : "by the table";
      this.cost.textContent = `${plural(cost.cells, "cell")} in ${plural(cost.chunks, "chunk")} · ${seconds(cost.core_seconds)} of one core, ${basis} · at most ${bytes(cost.bytes)}`;
      this.button.disabled = false;
    } catch (error) {
      this.#tell(error);
    }
  }

  #tell(error) {
    if (error.name === "AbortError") return;
    this.cost.textContent = error.name === "Lost" ? "The cost is told when the service answers again." : error.errors?.length ? "Not like this: see what is marked above." : "";
    if (toldElsewhere(error)) return;
    showProblems(this.form, this.problem, error);
    this.button.disabled = error.status === 422 || error.status === 413;
  }

  async #submit(event) {
    event.preventDefault();
    this.button.disabled = true;
    try {
      const job = await askJson("/v1/jobs", { method: "POST", body: this.#read() });
      say("The sweep is accepted.");
      if (this.closed) return;
      replace(["new"], { from: job.id }); // who comes back finds what was submitted
      go(["job", job.id]);
    } catch (error) {
      this.#tell(error);
      this.form.querySelector("[aria-invalid=true]")?.focus();
    } finally {
      if (this.form.querySelector("[aria-invalid=true]") === null) this.button.disabled = false;
    }
  }
}
