// The rules a specification breaks, shown at the fields they are about.

import { h } from "../lib/dom.js";

/** Show a Problem's errors at their fields, and those without a visible field in `general`; null clears them. */
export function showProblems(form, general, problem) {
  clear(form);
  const other = [];
  const errors = problem?.errors?.length ? problem.errors : problem ? [{ field: "", rule: problem.message }] : [];
  for (const { field, rule } of errors) {
    const input = inputOf(form, field);
    if (input) mark(input, inWords(rule, input));
    else other.push(field ? `${field}: ${rule}` : rule);
  }
  general.textContent = other.join("; ");
  general.hidden = !other.length;
}

function clear(form) {
  for (const input of form.querySelectorAll("[aria-invalid]")) {
    input.removeAttribute("aria-invalid");
    input.removeAttribute("aria-describedby");
  }
  form.querySelectorAll(".error").forEach((element) => element.remove());
}

/** The visible input of "model.restitution", or the nearest one above: "gamma[3]" is shown at gamma. */
function inputOf(form, field) {
  let name = field.replaceAll("[", ".").replaceAll("]", "");
  while (name) {
    const inputs = [...form.querySelectorAll(`[data-field="${CSS.escape(name)}"]`), ...form.querySelectorAll(`[data-group="${CSS.escape(name)}"] [data-field]`)];
    const visible = inputs.find((input) => input.offsetParent !== null);
    if (visible) return visible;
    name = name.includes(".") ? name.slice(0, name.lastIndexOf(".")) : "";
  }
  return null;
}

const NAMES = { start: "“from”", stop: "“to”", num: "the number of values" }; // of a range, as the form calls its fields

/** A rule of the specification in words of the form. */
function inWords(rule, input) {
  const text = input.value?.trim() ?? "";
  if (/^[-−+]?\d+,\d+$/.test(text)) return `write a decimal point, not a comma: ${text.replace(",", ".")}`;
  const [, whole, wrong] = /^must be a (whole )?number, not (.+)$/.exec(rule) ?? [];
  if (wrong === "null") return "is empty: type a number";
  if (wrong) return `must be a ${whole ?? ""}number: ${wrong.replace(/^(?:text )?'(.*)'$/, "“$1”")} is not`;
  if (rule === "is required") return "is empty";
  return rule.replace(/\b(start|stop|num)\b/g, (name) => NAMES[name]);
}

function mark(input, rule) {
  const id = `error-${input.dataset.field.replaceAll(".", "-")}`;
  input.setAttribute("aria-invalid", "true");
  input.setAttribute("aria-describedby", id);
  const label = input.closest("label") ?? input;
  if (label.nextElementSibling?.id === id) label.nextElementSibling.textContent += `; ${rule}`;
  else label.after(h("span", { className: "error", id }, rule));
}
