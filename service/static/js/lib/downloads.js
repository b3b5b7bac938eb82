// Download buttons, CSV tables and file names.

import { requestBlob, requestJson } from "./api.js";
import { h } from "./dom.js";

/** A row of download buttons: `files` is [[label, () => file name, () => Blob or promise of one], …]. */
export function downloads(files) {
  const status = h("span", { className: "note", role: "status" });
  const button = ([label, name, make]) =>
    h("button", {
      type: "button", className: "quiet", "aria-label": `Download ${label}`,
      onclick: async (event) => {
        const pressed = event.currentTarget;
        pressed.disabled = true;
        status.textContent = "";
        try {
          save(await make(), name());
        } catch (error) {
          status.textContent = error.message;
        } finally {
          pressed.disabled = false;
        }
      },
    }, label);
  return h("div", { className: "downloads", role: "group", "aria-label": "Downloads" },
    h("span", {}, "Download"), files.map(button), status);
}

/** A table as CSV: a header row of names, then rows of values; null and NaN are empty cells. */
export function csv(names, rows) {
  const cell = (value) => (value === null || Number.isNaN(value) ? "" : String(value));
  const lines = [names, ...rows].map((row) => row.map(cell).join(","));
  return new Blob([lines.join("\n"), "\n"], { type: "text/csv" });
}

/** A real number as Python writes it: 1 as "1.0". */
export const decimal = (value) => (Number.isInteger(value) && Math.abs(value) < 1e16 ? value.toFixed(1) : String(value));

/** What the metadata of a file made here hold: job, specification, versions. */
export async function originOf(job) {
  const { release } = await requestJson("/v1/software");
  return { job: job.id, kernel_version: job.kernel_version, release, spec: job.spec };
}

export const netcdf = (job) => () => requestBlob(`/v1/jobs/${job.id}/export?format=nc`);

/** "figure 2" → "figure-2-diagram.png". */
export function fileName(job, content, extension) {
  const name = job.name.toLowerCase().replace(/[^\p{L}\p{N}]+/gu, "-").slice(0, 80).replace(/^-|-$/g, "");
  return `${name || job.id.slice(0, 8)}-${content}.${extension}`;
}

function save(blob, name) {
  const address = URL.createObjectURL(blob);
  const anchor = h("a", { href: address, download: name });
  anchor.click();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}
