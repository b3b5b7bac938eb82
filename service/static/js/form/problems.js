// What the service refuses, at the field where it is.

import { h } from "../lib/dom.js";

/** Show a Problem's rules beside their fields, the rest in `general`; null clears them. */
export function showProblems(form, general, problem) {
  clear(form);
  const rest = [];
  const rules = problem?.errors?.length ? problem.errors : problem ? [{ field: "", rule: problem.message }] : [];
  for (const { field, rule } of rules) {
    const input = find(form, field);
    if (input) mark(input, rule);
    else rest.push(field ? `${field}: ${rule}` : rule);
  }
  general.textContent = rest.join("; ");
  general.hidden = !rest.length;
}

function clear(form) {
  for (const input of form.querySelectorAll("[aria-invalid]")) {
    input.removeAttribute("aria-invalid");
    input.removeAttribute("aria-describedby");
  }
  form.querySelectorAll(".rule").forEach((one) => one.remove());
}

/** The visible input for "model.restitution", or the nearest thing above it: "gamma[3]" is shown at gamma. */
function find(form, field) {
  let name = field.replaceAll("[", ".").replaceAll("]", "");
  while (name) {
    const inputs = [...form.querySelectorAll(`[data-field="${CSS.escape(name)}"]`), ...form.querySelectorAll(`[data-group="${CSS.escape(name)}"] [data-field]`)];
    const input = inputs.find((one) => one.offsetParent !== null);
    if (input) return input;
    name = name.includes(".") ? name.slice(0, name.lastIndexOf(".")) : "";
  }
  return null;
}

function mark(input, rule) {
  const id = `rule-${input.dataset.field.replaceAll(".", "-")}`;
  input.setAttribute("aria-invalid", "true");
  input.setAttribute("aria-describedby", id);
  const place = input.closest("label") ?? input;
  if (place.nextElementSibling?.id === id) place.nextElementSibling.textContent += `; ${rule}`;
  else place.after(h("span", { className: "rule", id }, rule));
}
