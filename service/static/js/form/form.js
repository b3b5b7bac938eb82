// The form for a new study of any kind. The service validates it and estimates its cost while it is edited.

import { addressValue, currentQuery, link, navigate, setQuery } from "../lib/address.js";
import { isHandledElsewhere, query, requestJson } from "../lib/api.js";
import { announce, button, debounced, h, latest, problemLine } from "../lib/dom.js";
import { costText } from "../lib/format.js";
import { AXES, axisValues, directionsOf } from "../lib/physics.js";
import { snippets } from "../lib/snippets.js";
import { OF_REST, kindOf, loadPresets, loadStudies } from "./catalogue.js";
import { axisField, modelField, objectField, schemaField } from "./fields.js";
import { PastedSpecification } from "./pasted.js";
import { Plan } from "./plan.js";
import { showProblems, unfolded } from "./problems.js";

const ESTIMATE_DELAY_MS = 220;
const ROWS = ["name", ...AXES, "protocol", "refine", "model"]; // fields with a row of their own, in this order
const CHOSEN = ["effort", "exponents", "modes", "gamma_max"]; // fields below them; the others are folded away
const PROTOCOLS = { ramp: ["Ramp", "The first cell begins from rest, or on a cycle; a window reaches back to it"], basin: ["Starts", "The plane of starts of each cell"], multistability: ["Starts", "Drops that find the attractors of each cell"] };

export class SweepForm {
  edited = new Set(); // names of the fields edited since the form was last filled
  source = {}; // the specification that it was filled with, if it did not begin anew

  constructor(root, address, signal) {
    this.signal = signal;
    document.title = "New study · Bouncing spring";
    this.heading = h("h1", { tabindex: "-1" }, "New study");
    this.container = h("div", {}, h("p", { className: "note" }, "Loading the form …"));
    [this.problem, this.missing] = [problemLine(), problemLine()];
    this.pasted = new PastedSpecification((spec) => this.#replace(spec));
    root.replaceChildren(this.heading, this.missing.element, this.container, this.problem.element, this.pasted.element);
    this.estimate = debounced(ESTIMATE_DELAY_MS, latest((signal) => this.#estimate(signal)));
    this.#load();
  }

  show() {
    this.edited.clear();
    this.#load();
  }

  refresh = () => (this.isLoaded ? this.estimate() : this.#load());

  #build() {
    const figures = this.presets.map(({ title, sweeps }) => h("optgroup", { label: title }, sweeps.map(({ key, text }) => h("option", { value: key }, text))));
    const choosePreset = () => {
      setQuery({ figure: this.preset.value || null, from: null });
      this.show();
    };
    this.preset = h("select", { id: "preset", onchange: choosePreset }, h("option", { value: "" }, "default values"), figures);
    const kinds = Object.entries(this.studies).map(([kind, { title }]) => h("option", { value: kind }, title));
    const changeKind = () => { // begins with its own fields; what was edited, or came with a job or figure, stays
      const isKept = (name) => !["protocol", "refine", "exponents"].includes(name) && (this.edited.has(name) || name in this.source);
      this.#fill(this.studies[this.kind.value].begin, this.kind.value, isKept);
      this.edited.add("protocol");
    };
    this.kind = h("select", { id: "study", onchange: changeKind }, kinds);
    this.cost = h("p", { className: "cost", role: "status" }, "…");
    this.button = h("button", { type: "submit", className: "button", disabled: true }, "Compute");
    this.snippets = snippets();
    this.plan = new Plan(() => this.#read(), (spec) => this.#replace(spec), (budget) => this.#submit({ budget }));
    const submit = (event) => { event.preventDefault(); this.#submit(); };
    this.form = h("form", { className: "sweep", novalidate: true, onsubmit: submit, oninput: this.#onEdit, onchange: this.#onEdit });
    this.container.replaceChildren(
      h("p", { className: "preset" }, h("label", {}, "Study ", this.kind), h("label", {}, "Start from ", this.preset)),
      this.form,
      h("details", {}, h("summary", {}, "Copy as Python, TOML, curl or JSON"), this.snippets.element));
  }

  /** The fields of a kind of study, those first that are chosen for it; what is recorded is folded away. */
  #showKind(kind) {
    if (this.shown === kind) return;
    this.shown = this.kind.value = kind;
    const { fields, parts, models } = this.studies[kind];
    const protocol = { kind: OF_REST.includes(kind) ? "rest" : kind };
    const make = {
      ...Object.fromEntries(AXES.map((axis) => [axis, () => axisField(axis)])),
      protocol: () => objectField("protocol", ...(PROTOCOLS[kind] ?? ["Protocol", ""]), parts, protocol),
      refine: ({ parts: { margin, ...shown } }) => objectField("refine", "Cells", "Those inside regions of one mode are filled in", shown),
      model: (schema) => modelField(models, schema.default),
    };
    const names = new Set([...ROWS.filter((name) => name === "protocol" || name in fields), ...Object.keys(fields)]);
    this.fields = Object.fromEntries(Array.from(names, (name) => [name, make[name]?.(fields[name]) ?? schemaField(name, fields[name])]));
    const elements = (group) => group.filter((name) => name in this.fields).map((name) => this.fields[name].element);
    const recorded = Object.keys(this.fields).filter((name) => ![...ROWS, ...CHOSEN].includes(name));
    const listed = h("small", {}, recorded.map((name) => name.replaceAll("_", " ")).join(", "));
    this.form.replaceChildren(...elements(ROWS),
      h("fieldset", { className: "plain", hidden: !CHOSEN.some((name) => name in this.fields) },
        h("legend", {}, kind === "orbits" ? "Cycles" : "Accuracy"), elements(CHOSEN), "effort" in this.fields && this.plan.element),
      h("details", {}, h("summary", {}, "Recording ", listed), h("fieldset", { className: "plain" }, elements(recorded))),
      this.problem.element,
      h("div", { className: "submit" }, this.button, this.cost, button("All settings", () => this.#showWindow(null))));
  }

  /** Fill the form with the figure or the sweep that the address names; edited fields keep their values, and nothing is submitted before. */
  async #load() {
    this.isLoaded = false;
    if (this.form) [this.button.disabled, this.cost.textContent] = [true, "…"];
    const { figure, from, field, model, restitution, penetration } = currentQuery();
    const isOutdated = () => this.signal.aborted || currentQuery().figure !== figure || currentQuery().from !== from;
    try {
      if (!this.form) {
        [this.studies, this.presets] = await Promise.all([loadStudies(), loadPresets()]);
        if (isOutdated()) return;
        this.#build();
        this.#fill(this.studies.rest.begin);
      }
      let missing = null; // the form has the default values then
      const job = from && !history.state && (await requestJson(`/v1/jobs/${from}`).catch((error) => {
        if (error.status !== 404) throw error;
        missing = error;
      }));
      if (isOutdated()) return;
      const preset = this.presets.flatMap(({ sweeps }) => sweeps).find(({ key }) => key === figure);
      if (figure && !preset) missing = new Error(`There is no sweep of a figure ${figure}.`);
      this.preset.value = preset?.key ?? "";
      this.isLoaded = true;
      const spec = history.state ?? (job || preset)?.spec; // Back has returned to what was submitted
      const axes = axesOf(currentQuery(), spec);
      const window = job && Object.keys(axes).length > 0 && { ...axes, name: `Window of ${job.name || from.slice(0, 8)}`, parent: from };
      const contact = axes.omega && { model: { kind: model === "soft" ? model : "rigid", restitution, penetration } };
      this.source = spec ? { ...spec, ...window } : { ...axes, ...contact };
      this.#fill(spec ? this.source : { ...this.studies.rest.begin, ...this.source });
      this.#showWindow(window && this.source);
      this.missing.show(missing);
      showProblems(this.form, this.problem, null);
      if (field in this.fields) unfolded(this.fields[field].element.querySelector("[data-field]")).focus();
      this.pasted.takeFile();
    } catch (error) {
      if (!isOutdated()) this.#showError(error);
    }
  }

  /** Show a specification, but for what was edited; of a field that the kind before did not have, nothing is kept. */
  #fill(spec, kind = this.edited.has("protocol") ? this.shown : kindOf(spec), isKept = (name) => this.edited.has(name)) {
    const { fields: before = {} } = this;
    const kept = this.fields ? this.#read() : {};
    this.cost.textContent = "…"; // until this one is estimated
    this.#showKind(kind);
    for (const [name, field] of Object.entries(this.fields)) field.write((isKept(name) && name in before ? kept : spec)[name]);
    this.#onChange();
  }

  /** Of a window on another sweep its axes and ramp, what they cost and how exact they are; null shows all fields. */
  #showWindow(window) {
    this.heading.textContent = window ? window.name : "New study";
    this.form.classList.toggle("window", Boolean(window));
    for (const [name, { element }] of Object.entries(this.fields)) element.classList.toggle("asked", Boolean(window?.[name]?.num || window?.[name]?.axis));
  }

  #replace(spec) {
    this.#showWindow(null);
    this.edited.clear();
    this.source = spec;
    this.#fill(spec);
    if (document.activeElement !== this.pasted.text) this.button.focus(); // there somebody may type on
  }

  #onEdit = ({ target }) => {
    const [name] = Object.entries(this.fields).find(([, { element }]) => element.contains(target)) ?? [];
    if (!name) return; // the time that is planned for
    this.edited.add(name);
    this.#onChange();
  };

  /** The specification; fields with their defaults are left out. */
  #read() {
    const parent = "effort" in this.fields ? (this.source.parent ?? null) : null; // which only sweeps have
    const values = [...Object.entries(this.fields).map(([name, field]) => [name, field.read()]), ["parent", parent]];
    return Object.fromEntries(values.filter(([, value]) => value !== null));
  }

  #onChange() {
    this.plan.clear();
    this.snippets.show(this.#read());
    this.button.disabled = !this.isLoaded || this.isSubmitting; // what is submitted need not be estimated
    this.estimate();
  }

  async #estimate(signal) {
    if (!this.isLoaded || this.signal.aborted) return; // another specification would be estimated, and submitted
    const body = this.#read();
    try {
      const cost = await requestJson("/v1/jobs?validate_only=true", { method: "POST", body, signal });
      if (JSON.stringify(body) !== JSON.stringify(this.#read())) return; // edited meanwhile: it is estimated again
      showProblems(this.form, this.problem, null);
      this.cost.textContent = costText(cost);
      this.button.disabled = this.isSubmitting;
    } catch (error) {
      this.#showError(error);
    }
  }

  #showError(error) {
    if (error.name === "AbortError") return;
    const invalid = error.errors?.length ? "The specification is not valid: see the messages above." : "";
    if (this.form) this.cost.textContent = error.name === "Unreachable" ? "The cost is estimated once the service answers again." : invalid;
    if (isHandledElsewhere(error)) return;
    showProblems(this.form ?? this.container, this.problem, error);
    if (this.form) this.button.disabled = !this.isLoaded || this.isSubmitting || [413, 422].includes(error.status); // it is refused
  }

  async #submit(parameters = {}) {
    this.isSubmitting = this.button.disabled = true;
    try {
      const job = await requestJson(`/v1/jobs?${query(parameters)}`, { method: "POST", body: this.#read() });
      announce("Submitted.");
      if (this.signal.aborted) return;
      history.replaceState(this.#read(), "", link(["new"], { from: job.id })); // of a budget, the job is a coarse level
      navigate(["job", job.id]);
    } catch (error) {
      if (error.errors?.length && error.errors.every(({ field }) => field in parameters)) throw error; // told beside the time
      this.#showError(error);
      this.form.querySelector("[aria-invalid=true]")?.focus();
    } finally {
      this.isSubmitting = false;
      this.button.disabled = !this.isLoaded || Boolean(this.form.querySelector("[aria-invalid=true]"));
      if (!parameters.budget && document.activeElement === document.body) this.button.focus(); // which a disabled button loses
    }
  }
}

/** The axes that an address has, as values or as windows on those of `spec`. */
function axesOf(query, spec) {
  const limits = AXES.map((axis) => [axis, (query[axis] ?? "").split(",").map((text) => Number(text || NaN))]);
  return Object.fromEntries(limits.filter(([, values]) => values.every(Number.isFinite))
    .map(([axis, [low, high]]) => [axis, spec && high > low ? windowOn(spec, axis, low, high) : low]));
}

/** A window on an axis: as many values, rounded limits. A ramp follows a branch from its beginning, so it keeps that end. */
function windowOn({ protocol, ...axes }, name, low, high) {
  const { spacing = "linear" } = axes[name];
  const values = axisValues(axes[name]);
  const step = 10 ** Math.floor(Math.log10(high - low) - 2);
  const near = 1e-6; // 0.7 is rounded already, though 0.7 / 0.001 is less than 700
  const window = [Math.max(values[0], Math.floor(low / step + near) * step), Math.min(values.at(-1), Math.ceil(high / step - near) * step)];
  const begins = protocol.axis === name ? directionsOf({ protocol }) : [];
  const ends = [begins.includes("up") ? values[0] : window[0], begins.includes("down") ? values.at(-1) : window[1]];
  const length = ([start, stop]) => (spacing === "log" ? Math.log(stop / start) : stop - start);
  const num = 1 + Math.round(((values.length - 1) * length(ends)) / length(window));
  return { start: addressValue(ends[0]), stop: addressValue(ends[1]), num, spacing };
}
