// Numbers, sizes and times as text.

const [DIGITS, RAISED] = ["-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"];
const translated = (text, from, to) => text.replace(/./g, (digit) => to[from.indexOf(digit)]);

/** Up to `digits` significant digits, no trailing zeros. */
export function number(value, digits = 5) {
  if (!Number.isFinite(value)) return "–";
  const text = String(Number(value.toPrecision(digits)));
  const [mantissa, exponent] = text.split("e");
  const power = exponent && `10${translated(String(Number(exponent)), DIGITS, RAISED)}`;
  return (power ? (mantissa === "1" ? power : `${mantissa}·${power}`) : mantissa).replaceAll("-", "−");
}

/** The text of numbers as programs read it: 2.38·10⁻⁷ is 2.38e-7, what is missing is nothing. */
export const plain = (text) => text.replace(/^–$/, "").replaceAll("−", "-").replace(/(·?)10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)/g, (_, times, power) => `${times ? "" : "1"}e${translated(power, RAISED, DIGITS)}`);

/** A part of 1 in percent. */
export const share = (part, digits = 3) => (Number.isNaN(part) ? "–" : `${number(100 * part, digits)} %`);

export const count = (value) => String(value).replace(/\B(?=(\d{3})+$)/g, ","); // toLocaleString takes 20 ms the first time

export const plural = (n, singular, many = `${singular}s`) => `${count(n)} ${n === 1 ? singular : many}`;

export function bytes(value) {
  const units = ["bytes", "kB", "MB", "GB", "TB"];
  const step = Math.min(Math.floor(Math.log10(Math.max(value, 1)) / 3), units.length - 1);
  return `${number(value / 1000 ** step, 3)} ${units[step]}`;
}

/** A duration in seconds. */
export function duration(value) {
  if (value < 0.1) return "less than 0.1 s";
  if (value < 90) return `${number(value, 2)} s`;
  if (value < 5400) return `${Math.round(value / 60)} min`;
  return `${number(value / 3600, 2)} h`;
}

/** How long ago a time was; after 36 h, its date. */
export function ago(time) {
  const seconds = Math.max(0, (Date.now() - new Date(time)) / 1000);
  if (seconds < 10) return "just now";
  if (seconds < 129600) return `${duration(seconds)} ago`;
  return new Date(time).toLocaleDateString("en", { day: "numeric", month: "short", year: "numeric" });
}

/** A time of the service in the reader's time zone, to the second. */
export const time = (text) => new Date(text).toLocaleString("en-GB", { dateStyle: "medium", timeStyle: "medium" });

/** What a study would cost: "551 cells in 3 chunks · about 1 s on 2 workers · up to 585 kB", of the service's estimate. */
export function costText(cost) {
  const atOnce = Math.max(Math.min(cost.workers, cost.chunks), 1);
  const where = cost.workers ? plural(cost.workers, "worker") : "one core";
  const first = cost.basis === "measured" ? "" : ", once its kernel is compiled";
  const [least, most] = cost.computed_cells ?? [];
  const computed = most === undefined ? "" : `, about ${count(least)} to ${count(most)} of them computed,`;
  const seconds = most === undefined ? "" : `${duration(Math.max(cost.least_core_seconds / atOnce, 1))} to `;
  return `${plural(cost.cells, "cell")}${computed} in ${plural(cost.chunks, "chunk")} · about ${seconds}${duration(Math.max(cost.core_seconds / atOnce, 1))} on ${where}${first} · up to ${bytes(cost.bytes)}`;
}
