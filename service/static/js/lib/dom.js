// Building elements, errors, downloads, screen-reader announcements, and limiting how often a function runs.

import { isHandledElsewhere, requestBlob } from "./api.js";

/** h("p", {className: "x", onclick: f}, "text", child): an element; null and false children are left out. */
export function h(tag, props = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (value === undefined || value === null) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name in element) element[name] = value;
    else if (value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.flat(2).filter((child) => child !== null && child !== undefined && child !== false));
  return element;
}

/** A choice among `options`, [[value, text] or a value that is its text, …], the `control` of the label that this is. */
export const choice = (label, options, selected, onChange, attributes = {}) => h("label", { className: "option" }, `${label} `,
  h("select", { onchange: (event) => onChange(event.target.value), ...attributes },
    options.map((option) => [option].flat()).map(([value, text = value]) => h("option", { value, selected: value === selected }, text))));

/** A check box, the `control` of the label that this is. */
export const checkBox = (text, attributes) => h("label", { className: "option" }, h("input", { type: "checkbox", ...attributes }), ` ${text}`);

/** A line for an error, which `show(error)` shows and `show(null)` hides; not one that the banner or the token dialog shows. */
export function problemLine() {
  const element = h("p", { className: "problem", role: "alert" });
  const show = (error) => {
    if (error && isHandledElsewhere(error)) return;
    element.textContent = error?.message ?? "";
  };
  const showInView = (error) => { show(error); element.scrollIntoView({ block: "nearest" }); };
  return { element, show, showInView };
}

export const button = (title, onclick, attributes) => h("button", { type: "button", className: "quiet", onclick, ...attributes }, title);

/** A button that cannot be pressed again until `work(event)` ends, which `busy` says; `failed(error)` tells why it did not. */
export function workButton(title, work, failed, { busy, ...props } = {}) {
  const button = h("button", { type: "button", ...props, onclick: async (event) => {
    button.disabled = true;
    if (busy) announce((button.textContent = busy));
    await Promise.resolve(event).then(work).catch(failed);
    button.disabled = false;
    if (busy) button.textContent = title;
    if (document.activeElement === document.body) button.focus({ preventScroll: true }); // which a disabled button loses
  } }, title);
  return button;
}

/** An input of a file, which `take(file)` gets: the same one again too, edited meanwhile. */
export const fileInput = (accept, take) => h("input", {
  type: "file", accept, onclick: ({ target }) => { target.value = ""; }, onchange: ({ target }) => target.files.length && take(target.files[0]),
});

const COPIED_MS = 1500;

/** A button that copies `what`, which `text()` returns, and says so. */
export const copyButton = (what, text) => button("Copy", async ({ currentTarget }) => {
  const content = text(); // also without a clipboard: it may select the text
  currentTarget.textContent = (await navigator.clipboard?.writeText(content).then(() => "Copied", () => null)) ?? "Not copied";
  announce(`${currentTarget.textContent}.`);
  setTimeout(() => { currentTarget.textContent = "Copy"; }, COPIED_MS);
}, { "aria-label": `Copy ${what}` });

/** A row of download buttons: `files` is [[label, () => file name, () => Blob or promise of one], …]; a note on them. */
export function downloads(files, note) {
  const status = h("span", { className: "note", role: "status" });
  const failed = (error) => { if (!isHandledElsewhere(error)) status.textContent = error.message; };
  const button = ([label, name, make]) => workButton(label, async () => {
    status.textContent = "";
    const address = URL.createObjectURL(await make());
    h("a", { href: address, download: name() }).click();
    announce(`${name()} is downloaded.`);
    setTimeout(() => URL.revokeObjectURL(address), 60_000);
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

const nameOf = (element) => [element.tagName, element.id || element.ariaLabel || (element.closest("label") ?? element).textContent].join(" ");

/** Make a `change` of what is in `root`; the focus goes on to what is there again, or has the same name, or else to `otherwise()`. */
export function keepFocus(root, change, otherwise = () => null) {
  const before = root.contains(document.activeElement) && document.activeElement;
  change();
  if (!before || document.activeElement === before) return;
  const after = before.isConnected ? before : [...root.querySelectorAll(before.tagName)].find((element) => nameOf(element) === nameOf(before));
  (after ?? otherwise())?.focus({ preventScroll: true });
}

/** Put `children` into `root` where they differ from what it has: else a focus or selection in it stays. */
export function renew(root, ...children) {
  const made = h("div", {}, children);
  if (made.innerHTML !== root.innerHTML) keepFocus(root, () => root.replaceChildren(...made.childNodes));
}

export const announce = (text) => { document.getElementById("status").textContent = text; };

/** `work`, called `milliseconds` after the last call, with what that had besides; or not, after `cancel`. */
export function delayed(work) {
  let timer;
  const after = (milliseconds, ...given) => {
    after.cancel();
    timer = setTimeout(work, milliseconds, ...given);
  };
  after.cancel = () => clearTimeout(timer);
  return after;
}

/** `work`, called only after `milliseconds` without another call. */
export const debounced = (milliseconds, work) => delayed(work).bind(null, milliseconds);

const ABORT_AFTER_MS = 150;

/** `work(signal)`, one run at a time. Calls made during a run become one, which starts when the run ends; the run is
 * aborted through its signal if it takes ABORT_AFTER_MS longer, unless the call `isPatient`. */
export function latest(work) {
  let running = null; // the controller of the current run
  let isDue = false;
  return async (isPatient = false) => {
    isDue = true;
    if (running) return isPatient || setTimeout((stale) => stale.abort(), ABORT_AFTER_MS, running);
    while (isDue) {
      isDue = false;
      running = new AbortController();
      await work(running.signal).finally(() => { running = null; });
    }
  };
}
