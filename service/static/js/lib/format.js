// Numbers, sizes and times as text.

const [DIGITS, RAISED] = ["-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"];
const translated = (text, from, to) => text.replace(/./g, (digit) => to[from.indexOf(digit)]);

/** Up to `digits` significant digits, no trailing zeros. */
export function number(value, digits = 5) {
  if (!Number.isFinite(value)) return "–";
  const text = String(Number(value.toPrecision(digits)));
  const [mantissa, exponent] = text.split("e");
  const factor = mantissa === "1" ? "" : `${mantissa}·`;
  const decimal = exponent ? `${factor}10${translated(String(Number(exponent)), DIGITS, RAISED)}` : mantissa;
  return decimal.replaceAll("-", "−");
}

/** The number that a decimal text stands for; NaN of any other, such as 0x10. */
export const numberIn = (text) => (/^[-+−]?[\d.]+(e[-+−]?\d+)?$/i.test(text.trim()) ? Number(text.replaceAll("−", "-")) : NaN);

/** A text of numbers as programs read them: 2.38·10⁻⁷ becomes 2.38e-7, and "–" is left out. */
export const plain = (text) => text.replace(/^–$/, "").replaceAll("−", "-")
  .replace(/(·?)10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)/g, (_, times, power) => `${times ? "" : "1"}e${translated(power, RAISED, DIGITS)}`);

/** A number in a table; in files it is not rounded. */
export const exact = (value, whole, digits) => (whole && !Number.isNaN(value) ? String(value) : number(value, digits));
/** A bound in `digits` digits, rounded so that it remains one: 1.07e-12 is not below 10⁻¹². */
export function bound(value, digits, isUpper = true) {
  const unit = 10 ** (Math.floor(Math.log10(value)) + 1 - digits);
  return number(value && unit * (isUpper ? Math.ceil(value / unit - 1e-9) : Math.floor(value / unit + 1e-9)), digits); // 100 · 0.29 is less than 29
}

/** A share in percent; as a bound where `isUpper` says of which side. */
export const share = (fraction, digits = 3, isUpper = null) => (Number.isNaN(fraction) ? "–" : `${(isUpper === null ? number : bound)(100 * fraction, digits, isUpper)} %`);
export const count = (value) => String(value).replace(/\B(?=(\d{3})+$)/g, ","); // toLocaleString takes 20 ms the first time
export const plural = (n, singular) => `${count(n)} ${singular}${n === 1 ? "" : "s"}`;

export function bytes(value) {
  const units = ["bytes", "kB", "MB", "GB", "TB"];
  const thousands = Math.min(Math.floor(Math.log10(Math.max(value, 1)) / 3), units.length - 1);
  return `${number(value / 1000 ** thousands, 3)} ${units[thousands]}`;
}

export function duration(seconds) {
  if (seconds < 0.1) return "less than 0.1 s";
  if (seconds < 90) return `${number(seconds, 2)} s`;
  if (seconds < 5400) return `${Math.round(seconds / 60)} min`;
  return `${number(seconds / 3600, 2)} h`;
}

export function ago(time) {
  const seconds = Math.max(0, (Date.now() - new Date(time)) / 1000);
  if (seconds < 10) return "just now";
  if (seconds < 129600) return `${duration(seconds)} ago`;
  return new Date(time).toLocaleDateString("en", { day: "numeric", month: "short", year: "numeric" });
}

/** A time of the service in the reader's time zone, to the second. */
export const time = (text) => new Date(text).toLocaleString("en-GB", { dateStyle: "medium", timeStyle: "medium" });

/** The service's estimate of a study's cost: "551 cells in 3 chunks · about 1 s on 2 workers · up to 585 kB". */
export function costText(cost) {
  const elapsed = (coreSeconds) => duration(Math.max(coreSeconds / Math.max(Math.min(cost.workers, cost.chunks), 1), 1));
  const where = cost.workers ? plural(cost.workers, "worker") : "one core";
  const first = cost.basis === "measured" ? "" : ", once its kernel is compiled";
  const [least, most] = cost.computed_cells ?? []; // of an adaptive map
  const range = (texts) => [...new Set(texts)].join(" to ");
  const computed = most === undefined ? "" : `, about ${range([least, most].map(count))} of them computed,`;
  const times = [most === undefined ? cost.core_seconds : cost.least_core_seconds, cost.core_seconds].map(elapsed);
  const cells = `${plural(cost.cells, "cell")}${computed} in ${plural(cost.chunks, "chunk")}`;
  return `${cells} · about ${range(times)} on ${where}${first} · up to ${bytes(cost.bytes)}`;
}
