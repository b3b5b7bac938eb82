// What is shown, as a file.

import { blobOf } from "./api.js";
import { h } from "./dom.js";

/** Buttons for the files of a view: `files` is [[label, name, () => Blob or promise of one], …]. */
export function downloads(files) {
  const said = h("span", { className: "note", role: "status" });
  const button = ([label, name, make]) =>
    h("button", {
      type: "button", className: "quiet", "aria-label": `Download ${label}`,
      onclick: async (event) => {
        const pressed = event.currentTarget;
        pressed.disabled = true;
        said.textContent = "";
        try {
          save(await make(), name());
        } catch (error) {
          said.textContent = error.message;
        } finally {
          pressed.disabled = false;
        }
      },
    }, label);
  return h("div", { className: "downloads", role: "group", "aria-label": "Downloads" },
    h("span", {}, "Download"), files.map(button), said);
}

/** A table as CSV: a row of names, rows of values. */
export function csv(names, rows) {
  const cell = (value) => (value === null || Number.isNaN(value) ? "" : String(value));
  const lines = [names, ...rows].map((row) => row.map(cell).join(","));
  return new Blob([lines.join("\n"), "\n"], { type: "text/csv" });
}

export const netcdf = (job) => () => blobOf(`/v1/jobs/${job.id}/export?format=nc`);

/** "figure 2" → "figure-2". */
export function fileName(job, what, kind) {
  const name = job.name.toLowerCase().replace(/[^\p{L}\p{N}]+/gu, "-").slice(0, 80).replace(/^-|-$/g, "");
  return `${name || job.id.slice(0, 8)}-${what}.${kind}`;
}

function save(blob, name) {
  const address = URL.createObjectURL(blob);
  const anchor = h("a", { href: address, download: name });
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}
