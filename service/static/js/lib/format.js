// Numbers as people read them.

/** Up to `digits` significant digits, no trailing zeros. */
export function number(value, digits = 5) {
  if (!Number.isFinite(value)) return "–";
  const text = String(Number(value.toPrecision(digits)));
  const [mantissa, exponent] = text.split("e");
  return (exponent ? `${mantissa}·10^${Number(exponent)}` : mantissa).replaceAll("-", "−");
}

export const count = (value) => value.toLocaleString("en");

export const plural = (n, one, many = `${one}s`) => `${count(n)} ${n === 1 ? one : many}`;

/** 2 → "2nd". */
export function ordinal(n) {
  const last = n % 100 > 10 && n % 100 < 14 ? 0 : n % 10;
  return `${n}${["th", "st", "nd", "rd"][last] ?? "th"}`;
}

export function bytes(value) {
  const units = ["bytes", "kB", "MB", "GB", "TB"];
  const step = Math.min(Math.floor(Math.log10(Math.max(value, 1)) / 3), units.length - 1);
  return `${number(value / 1000 ** step, 3)} ${units[step]}`;
}

export function seconds(value) {
  if (value < 0.1) return "less than 0.1 s";
  if (value < 90) return `${number(value, 2)} s`;
  if (value < 5400) return `${Math.round(value / 60)} min`;
  return `${number(value / 3600, 2)} h`;
}

export function ago(time) {
  const past = Math.max(0, (Date.now() - new Date(time)) / 1000);
  if (past < 10) return "just now";
  if (past < 90) return `${Math.round(past)} s ago`;
  if (past < 5400) return `${Math.round(past / 60)} min ago`;
  if (past < 129600) return `${Math.round(past / 3600)} h ago`;
  return new Date(time).toLocaleDateString("en", { day: "numeric", month: "short", year: "numeric" });
}
