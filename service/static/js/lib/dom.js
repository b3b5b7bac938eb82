// Elements in one call, and what keeps a page from doing the same work twice.

const PROPERTIES = new Set(["className", "textContent", "value", "checked", "disabled", "hidden", "open", "selected"]);

/** h("p", {className: "x", onclick: f, "aria-label": "…"}, "text", child): an element; null children are left out. */
export function h(tag, props = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (value === undefined || value === null) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (PROPERTIES.has(name)) element[name] = value;
    else if (value !== false) element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.flat(2).filter((child) => child !== null && child !== undefined && child !== false));
  return element;
}

/** Calls `work` once things have been quiet for a while. */
export function debounced(milliseconds, work) {
  let timer;
  const call = (...given) => {
    clearTimeout(timer);
    timer = setTimeout(() => work(...given), milliseconds);
  };
  call.cancel = () => clearTimeout(timer);
  return call;
}

const PATIENCE = 150; // ms

/**
 * One run at a time; asked again meanwhile, it runs once more with the last of what it was given. What takes long is
 * given up for the next: the signal, which `work` is given first, says so.
 */
export function newest(work) {
  let controller = null; // of the run under way
  let since;
  let next = null;
  return async function run(...given) {
    if (controller) {
      if (!next) setTimeout((stale) => stale.abort(), Math.max(0, since + PATIENCE - performance.now()), controller);
      next = given;
      return;
    }
    controller = new AbortController();
    since = performance.now();
    try {
      await work(controller.signal, ...given);
    } finally {
      controller = null;
      const waiting = next;
      next = null;
      if (waiting) run(...waiting);
    }
  };
}

/** Tells people who listen instead of look. */
export function say(text) {
  document.getElementById("said").textContent = text;
}
