// Download buttons and file names.

import { isHandledElsewhere, requestBlob } from "./api.js";
import { h, workButton } from "./dom.js";

/** A row of download buttons: `files` is [[label, () => file name, () => Blob or promise of one], …]; a note on them. */
export function downloads(files, note) {
  const status = h("span", { className: "note", role: "status" });
  const failed = (error) => { if (!isHandledElsewhere(error)) status.textContent = error.message; };
  const button = ([label, name, make]) => workButton(label, async () => {
    status.textContent = "";
    save(await make(), name());
  }, failed, { className: "quiet", "aria-label": `Download ${label}` });
  return h("div", { className: "downloads", role: "group", "aria-label": "Downloads" },
    h("span", {}, "Download"), files.map(button), note, status);
}

/** Downloads of a result in formats of the service: `path(format)` is its address with a query, `content` a part of the files' names. */
export const resultFiles = (job, content, formats, path, options) => formats.map(([label, format]) =>
  [label, () => fileName(job, content(), format), () => requestBlob(`${path(format)}&format=${format}`, options)]);

export function fileName(job, content, extension) {
  const name = job.name.toLowerCase().replace(/[^\p{L}\p{N}]+/gu, "-").slice(0, 80).replace(/^-|-$/g, "");
  return `${name || job.id.slice(0, 8)}-${content}.${extension}`;
}

function save(blob, name) {
  const address = URL.createObjectURL(blob);
  h("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 60_000);
}
