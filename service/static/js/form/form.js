// The form for a new sweep. The service validates it and estimates its cost while it is edited.

import { currentQuery, link, navigate, replace, setQuery } from "../lib/address.js";
import { isHandledElsewhere, requestJson } from "../lib/api.js";
import { announce, debounced, h } from "../lib/dom.js";
import { costText } from "../lib/format.js";
import { isSweep } from "../lib/physics.js";
import { Snippets } from "../lib/snippets.js";
import { loadPresets, loadSchema } from "./catalogue.js";
import { axisField, modelField, protocolField, refineField, schemaField } from "./fields.js";
import { PastedSpecification } from "./pasted.js";
import { Plan } from "./plan.js";
import { showProblems } from "./problems.js";

const ESTIMATE_DELAY_MS = 220;
const INVALID = new Set([413, 422]);

export class SweepForm {
  edited = new Set(); // names of the fields edited since the form was last filled

  constructor(root) {
    document.title = "New sweep · Bouncing spring";
    this.container = h("div", {}, h("p", { className: "note" }, "Loading the form …"));
    this.problem = h("p", { className: "problem", role: "alert", hidden: true });
    this.pasted = new PastedSpecification((job) => navigate(["job", job.id]));
    root.replaceChildren(
      h("p", { className: "back" }, h("a", { href: link([]) }, "← All sweeps")),
      h("h1", { tabindex: "-1" }, "New sweep"),
      this.container, this.problem, this.pasted.element);
    this.estimate = debounced(ESTIMATE_DELAY_MS, () => this.#estimate());
    this.#load();
  }

  show() {
    this.edited.clear();
    this.#load();
  }

  refresh() {
    if (this.isLoaded) this.estimate();
    else this.#load();
  }

  close() {
    this.closed = true;
    this.estimate.cancel();
    this.pasted.close();
    this.estimating?.abort();
  }

  #build({ fields: { name, gamma, omega, xi, protocol, refine, model, parent, ...recording }, models }) {
    const rows = {
      name: schemaField("name", name), gamma: axisField("gamma"), omega: axisField("omega"), xi: axisField("xi"),
      protocol: protocolField(), refine: refineField(), model: modelField(models, model.default),
    };
    const recorded = Object.fromEntries(Object.entries(recording).map(([key, field]) => [key, schemaField(key, field)]));
    this.fields = { ...rows, ...recorded };
    const elements = (fields) => Object.values(fields).map(({ element }) => element);
    this.preset = h("select", { id: "preset", onchange: (event) => { setQuery({ figure: event.target.value || null, from: null }); this.show(); } });
    this.cost = h("p", { className: "cost", role: "status" }, "…");
    this.button = h("button", { type: "submit", className: "button", disabled: true }, "Compute");
    this.snippets = new Snippets();
    this.plan = new Plan(() => this.#read(), (spec) => this.#use(spec));
    this.form = h("form", { className: "sweep", novalidate: true, onsubmit: (event) => this.#submit(event), oninput: (event) => this.#onEdit(event), onchange: (event) => this.#onEdit(event) },
      elements(rows), h("fieldset", { className: "plain" }, h("legend", {}, "Recording"), elements(recorded)),
      this.problem,
      h("div", { className: "submit" }, this.button, this.cost));
    this.container.replaceChildren(
      h("p", { className: "preset" }, h("label", { for: "preset" }, "Start from "), this.preset),
      this.form,
      this.plan.element,
      h("details", {}, h("summary", {}, "Copy as Python, TOML, curl or JSON"), this.snippets.element));
    this.#fill({});
  }

  /** Fill the form with the figure or the sweep that the address names; edited fields keep their values, and nothing is submitted before. */
  async #load() {
    this.isLoaded = false;
    this.estimating?.abort();
    if (this.form) [this.button.disabled, this.cost.textContent] = [true, "…"];
    const { figure, from, omega, xi } = currentQuery();
    const isOutdated = () => this.closed || currentQuery().figure !== figure || currentQuery().from !== from;
    try {
      const schema = await loadSchema();
      if (isOutdated()) return;
      if (!this.form) this.#build(schema);
      const presets = await loadPresets();
      const job = from && (await requestJson(`/v1/jobs/${from}`));
      if (isOutdated()) return;
      this.preset.replaceChildren(h("option", { value: "" }, "default values"), ...presets.map(({ label, title, sweeps }) =>
        h("optgroup", { label: `${label}: ${title}` }, sweeps.map(({ key, text }) => h("option", { value: key, selected: key === figure }, text)))));
      this.isLoaded = true;
      if (job && !isSweep(job.spec)) this.pasted.write(job.spec);
      this.#fill((job && isSweep(job.spec) ? job : presets.flatMap(({ sweeps }) => sweeps).find(({ key }) => key === figure))?.spec ?? springOf(omega, xi));
    } catch (error) {
      if (isOutdated()) return;
      this.isLoaded = error.status === 404; // the sweep is gone: the form has the default values
      this.#showError(error);
    }
  }

  #fill(spec) {
    for (const [name, field] of Object.entries(this.fields)) {
      if (!this.edited.has(name)) field.write(spec[name]);
    }
    this.#onChange();
  }

  #onEdit({ target }) {
    const [name] = Object.entries(this.fields).find(([, field]) => field.element.contains(target));
    this.edited.add(name);
    this.#onChange();
  }

  /** The specification; fields with their defaults are left out. */
  #read() {
    return Object.fromEntries(Object.entries(this.fields).map(([name, field]) => [name, field.read()]).filter(([, value]) => value !== null));
  }

  /** Fill the form with a setting of the plan. */
  #use(spec) {
    Object.keys(this.fields).forEach((name) => this.edited.add(name));
    for (const [name, field] of Object.entries(this.fields)) field.write(spec[name]);
    this.#onChange();
    this.button.focus();
  }

  #onChange() {
    this.plan.clear();
    this.snippets.show(this.#read());
    this.estimate();
  }

  async #estimate() {
    if (!this.isLoaded) return; // another specification would be estimated, and submitted
    this.estimating?.abort();
    this.estimating = new AbortController();
    try {
      const cost = await requestJson("/v1/jobs?validate_only=true", { method: "POST", body: this.#read(), signal: this.estimating.signal });
      showProblems(this.form, this.problem, null);
      this.cost.textContent = costText(cost);
      this.button.disabled = false;
    } catch (error) {
      this.#showError(error);
    }
  }

  #showError(error) {
    if (error.name === "AbortError") return;
    if (this.form) {
      this.cost.textContent = error.name === "Unreachable" ? "The cost is estimated once the service answers again." : error.errors?.length ? "The specification is not valid: see the marked fields." : "";
    }
    if (isHandledElsewhere(error)) return;
    showProblems(this.form ?? this.container, this.problem, error);
    if (this.form) this.button.disabled = !this.isLoaded || INVALID.has(error.status);
  }

  async #submit(event) {
    event.preventDefault();
    this.button.disabled = true;
    try {
      const job = await requestJson("/v1/jobs", { method: "POST", body: this.#read() });
      announce("The sweep was submitted.");
      if (this.closed) return;
      replace(["new"], { from: job.id }); // the browser's back button returns to what was submitted
      navigate(["job", job.id]);
    } catch (error) {
      this.#showError(error);
      this.form.querySelector("[aria-invalid=true]")?.focus();
    } finally {
      if (this.form.querySelector("[aria-invalid=true]") === null) this.button.disabled = false;
    }
  }
}

/** The part of a specification that an address gives as numbers: a spring on an ideal plate. */
function springOf(omega, xi) {
  const given = Object.entries({ omega, xi }).map(([axis, text]) => [axis, Number(text || NaN)]).filter(([, value]) => Number.isFinite(value));
  return given.length ? { ...Object.fromEntries(given), model: { kind: "rigid" } } : {};
}
