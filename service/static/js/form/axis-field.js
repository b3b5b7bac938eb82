// One axis of a sweep in the form: one value, some values, or a range of them.

import { h } from "../lib/dom.js";
import { MEANING, SYMBOL } from "../lib/physics.js";

const KINDS = { one: "one value", list: "these values", range: "from … to" };

/** A row of the form for `axis`; `read()` gives what the specification says of it, `write(axis)` shows it. */
export function axisField(axis) {
  const input = (field, label, given = {}) =>
    h("label", {}, h("span", {}, label), h("input", { type: "text", inputmode: "decimal", autocomplete: "off", size: 8, "data-field": field, ...given }));
  const kind = h("select", { onchange: () => show() },
    Object.entries(KINDS).map(([value, text]) => h("option", { value }, text)));
  const single = input(axis, "value", { "data-part": "one" });
  const several = input(axis, "values, with commas between", { "data-part": "list", size: 24 });
  const from = input(`${axis}.start`, "from");
  const to = input(`${axis}.stop`, "to");
  const number = input(`${axis}.num`, "values", { inputmode: "numeric" });
  const spacing = h("label", {}, h("span", {}, "spacing"),
    h("select", { "data-field": `${axis}.spacing` }, ["linear", "log"].map((value) => h("option", { value }, value))));
  const parts = { one: [single], list: [several], range: [from, to, number, spacing] };
  const element = h("fieldset", { className: "axis", "data-group": axis },
    h("legend", {}, h("i", {}, SYMBOL[axis]), h("small", {}, MEANING[axis])), h("label", {}, h("span", {}, "take"), kind), Object.values(parts).flat());

  const of = (label) => label.querySelector("input, select");
  const show = () => Object.entries(parts).forEach(([name, labels]) => labels.forEach((label) => { label.hidden = name !== kind.value; }));

  const read = () => {
    if (kind.value === "one") return numeric(of(single).value);
    if (kind.value === "list") return of(several).value.split(/[,;\s]+/).filter(Boolean).map(numeric);
    return { start: numeric(of(from).value), stop: numeric(of(to).value), num: numeric(of(number).value), spacing: of(spacing).value };
  };

  const write = (value) => {
    kind.value = typeof value === "number" ? "one" : Array.isArray(value) ? "list" : "range";
    if (kind.value === "one") of(single).value = String(value);
    else if (kind.value === "list") of(several).value = value.join(", ");
    else {
      of(from).value = String(value.start);
      of(to).value = String(value.stop);
      of(number).value = String(value.num);
      of(spacing).value = value.spacing ?? "linear";
    }
    show();
  };
  return { element, read, write };
}

/** What was typed, as a number; as it is if it is none, so that the service can say what it thinks of it. */
export function numeric(text) {
  const trimmed = text.trim().replace("−", "-");
  const value = Number(trimmed);
  return trimmed !== "" && Number.isFinite(value) ? value : trimmed === "" ? null : trimmed;
}
