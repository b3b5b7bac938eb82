// A specification as text to copy: a program in Python, a TOML file for the shell, a request with curl, JSON.

import { SERVICE, hasToken } from "./api.js";
import { choice, copyButton, h } from "./dom.js";
import { AXES, isSweep } from "./physics.js";

const PYTHON = { null: "None", true: "True", false: "False" };

/** A specification as a Python expression: JSON with Python's words, which stand at the ends of lines. */
const python = (spec) => JSON.stringify(spec, null, 4).replace(/\b(null|true|false)(,?)$/gm, (_, word, comma) => PYTHON[word] + comma);

/** A value in TOML; objects inline. TOML has no null: fields without a value are left out. */
function toml(value) {
  if (Array.isArray(value)) return `[${value.map(toml).join(", ")}]`;
  if (value === null || typeof value !== "object") return typeof value === "string" ? JSON.stringify(value) : String(value);
  return `{ ${assignments(value).join(", ")} }`;
}

const assignments = (fields) => Object.entries(fields).filter(([, value]) => value !== null).map(([name, value]) => `${name} = ${toml(value)}`);

/** How Python draws a study, at the last value of each axis that is not drawn; empty for a kind of an extension. */
function drawing(spec) {
  const { kind } = spec.protocol;
  const long = AXES.filter((axis) => (spec[axis]?.num ?? spec[axis]?.length) > 1);
  const drawn = { basin: [], orbits: [], multistability: ["gamma", "omega"] }[kind] ?? long.slice(0, long[1] === "omega" ? 2 : 1);
  const fixed = long.filter((axis) => !drawn.includes(axis)).map((axis) => `${axis}=${[spec[axis].stop ?? spec[axis]].flat().at(-1)}`);
  if (isSweep(spec) || kind === "orbits") return `\n    job.plot(${fixed.join(", ")})`;
  const name = { basin: "basins", multistability: kind }[kind];
  const content = `job.result_file(${[`"${name}"`, '"png"', ...fixed].join(", ")})`;
  return name ? `\n    with open("${name}.png", "wb") as file:\n        file.write(${content})` : "";
}

const LANGUAGES = {
  Python: (spec) => `from bouncing_spring import Client

spec = ${python(spec)}
with Client("${SERVICE}") as client:
    job = client.submit(spec).wait()${drawing(spec)}
`,
  TOML: (spec) => `# bounce submit sweep.toml --wait --url ${SERVICE}
${assignments(spec).join("\n")}
`,
  curl: (spec) => `curl ${SERVICE}/v1/jobs -H "Content-Type: application/json"${hasToken() ? ' -H "Authorization: Bearer $BOUNCE_TOKEN"' : ""} -d '${JSON.stringify(spec).replaceAll("'", "'\\''")}'
`,
  JSON: (spec) => `${JSON.stringify(spec, null, 2)}\n`,
};

/** The specification in a language of choice, with a button that copies it: {element, show(spec)}. */
export function snippets(initial = "Python") {
  let shown;
  const text = h("pre", { tabindex: "0", role: "region", "aria-label": "The specification as text" });
  const language = choice("As", Object.keys(LANGUAGES), initial, () => show(shown), { "aria-label": "Language" });
  const copy = copyButton("the specification", () => {
    getSelection().selectAllChildren(text); // for browsers that do not allow copying: a service without https
    return text.textContent;
  });
  const show = (spec) => {
    shown = spec;
    text.textContent = LANGUAGES[language.control.value](spec);
  };
  return { element: h("div", { className: "snippets" }, h("div", { className: "controls" }, language, copy), text), show };
}
