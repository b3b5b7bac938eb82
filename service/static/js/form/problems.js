// The rules a specification breaks, shown at the fields they are about.

import { h } from "../lib/dom.js";
import { AXES } from "../lib/physics.js";
import { COMMA } from "./fields.js";

/** Show the errors of a problem at their fields, and those without a visible field in the problem line `general`; null clears them. */
export function showProblems(form, general, problem) {
  for (const input of form.querySelectorAll("[aria-invalid]")) ["aria-invalid", "aria-describedby"].forEach((name) => input.removeAttribute(name));
  form.querySelectorAll(".error").forEach((element) => element.remove());
  const others = [];
  for (const error of problem?.errors ?? []) {
    const input = inputOf(form, error.field);
    if (input) mark(input, inWords(error, input));
    else others.push(error.field ? `${error.field}: ${error.rule}` : error.rule);
  }
  const withoutErrors = problem?.errors?.length ? null : problem;
  general.show(others.length ? new Error(others.join("; ")) : withoutErrors);
}

/** The visible input of a field such as "model.restitution", or of what holds it: "gamma[3]" is shown at gamma. */
function inputOf(form, field) {
  for (let parts = field.split(/[.[\]]+/); parts.length; parts.pop()) {
    const name = CSS.escape(parts.join("."));
    const inputs = [...form.querySelectorAll(`[data-field="${name}"]`), ...form.querySelectorAll(`[data-group="${name}"] [data-field]`)];
    const visible = inputs.find((input) => !input.closest("[hidden]"));
    if (visible) return visible;
  }
  return null;
}

/** The service's rule, or what the typed text lacks to be a number. */
function inWords({ rule, code }, input) {
  const text = input.value?.trim() ?? "";
  if (code !== "type" && code !== "missing") return rule;
  if (text === "") return "is empty: type a number";
  const [pair] = text.match(COMMA) ?? [];
  if (pair && AXES.includes(input.dataset.field)) return `write ${pair.replace(",", ".")}, or ${pair.replace(",", ", ")} for two values`;
  if (/^[-−+]?\d+,\d+$/.test(text) && !rule.includes("whole number")) return `write a decimal point, not a comma: ${text.replace(",", ".")}`;
  return rule;
}

/** Open what an input is folded away in; returns the input. */
export function unfolded(input) {
  for (let fold = input.closest("details"); fold; fold = fold.parentElement.closest("details")) fold.open = true;
  return input;
}

function mark(input, rule) {
  if (!unfolded(input).offsetParent) input.form.classList.remove("window"); // which does not show it
  const id = `error-${input.dataset.field.replaceAll(".", "-")}`;
  input.setAttribute("aria-invalid", "true");
  input.setAttribute("aria-describedby", id);
  const label = input.closest("label") ?? input;
  if (label.nextElementSibling?.id === id) label.nextElementSibling.textContent += `; ${rule}`;
  else label.after(h("span", { className: "error", role: "alert", id }, rule));
}
