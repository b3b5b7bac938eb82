// Colours and fonts of what is drawn, taken from the style sheet; "paper" is what a file is drawn with.

const NAMES = ["paper", "ink", "soft", "rule", "up", "down", "alone", "onset", "cursor", "mass"];
const cache = new Map();

/** The colours in use now, or those of a sheet of paper whatever the screen prefers. */
export function theme(forPaper = false) {
  const key = forPaper ? "paper" : matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
  if (!cache.has(key)) cache.set(key, read(forPaper));
  return cache.get(key);
}

export function onThemeChange(work, signal) {
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", work, { signal });
}

function read(forPaper) {
  const probe = document.createElement("div");
  probe.className = forPaper ? "paper" : "";
  probe.hidden = true;
  document.body.append(probe);
  const style = getComputedStyle(probe);
  const found = Object.fromEntries(NAMES.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
  found.dark = style.getPropertyValue("--dark").trim() === "1";
  probe.remove();
  return { ...found, serif: "'STIX Two Text', 'Iowan Old Style', Palatino, Georgia, 'DejaVu Serif', serif" };
}

/** The colour of one direction of a sweep. */
export const colourOf = (direction, theme) => theme[direction === "rest" ? "alone" : direction];
