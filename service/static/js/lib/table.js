// Tables: plain ones, and long ones in pages, which can be copied and saved.

import { button, copyButton, downloads, h, keepFocus } from "./dom.js";
import { count, plain } from "./format.js";

const PAGE = 25; // rows

/** A table in a region that scrolls. The first cell of a row names it; cells are texts or nodes. */
export function table(label, titles, rows) {
  const head = titles && h("thead", {}, h("tr", {}, titles.map((title) => h("th", { scope: "col", style: title.includes(" ") ? null : "white-space: nowrap" }, title))));
  const unbroken = (cell) => (typeof cell === "string" ? cell.replace(/(?<=\([<>]?\d+,) (?=\d)/g, "\u00a0") : cell); // of a mode both numbers
  const cells = ([first, ...others]) => [h("th", { scope: "row" }, unbroken(first)), ...others.map((cell) => h("td", {}, unbroken(cell)))];
  const body = h("tbody", {}, rows.map((row) => h("tr", {}, cells(row))));
  return h("div", { className: "scroll", tabindex: "0", role: "region", "aria-label": label }, h("table", {}, head, body));
}

/** A table as text, with numbers as programs read them; in CSV, cells with commas or quotes are quoted. */
function textOf([columns, items], separator) {
  const rows = [columns.map(([title]) => title), ...items.map((item) => columns.map(([, text]) => text(item, true)))];
  const quoted = (cell) => (separator === "," && /[",]/.test(cell) ? `"${cell.replaceAll('"', '""')}"` : cell);
  return rows.map((cells) => cells.map((cell) => plain(quoted(cell))).join(separator)).join("\n");
}

/** A table in pages, folded away. `read()`: its columns, [[title, (item, whole: not shortened) => text, isCommon: in files alone], …], and items; `name()`: of its file. */
export class PagedTable {
  constructor(label, read, name, open = false) {
    Object.assign(this, { label, read, first: 0 });
    this.body = h("div", {});
    this.range = h("span", { className: "note", role: "status" });
    [this.previous, this.next] = [button("Previous rows", () => this.update(-PAGE)), button("Next rows", () => this.update(PAGE))];
    const file = () => new Blob([textOf(this.read(), ",")], { type: "text/csv" });
    this.element = h("details", { className: "paged", open, ontoggle: () => this.update() }, h("summary", {}, label), this.body,
      h("div", { className: "actions" }, this.previous, this.next, this.range),
      h("div", { className: "actions" }, copyButton("the table", () => textOf(this.read(), "\t")), downloads([["table as CSV", name, file]])));
  }

  /** While the table is open, show the rows that there are now, or those of the page before or after. */
  update(turn = 0) {
    if (!this.element.open) return;
    const [all, items] = this.read();
    const columns = all.filter(([, , isCommon]) => !isCommon);
    const { length } = items;
    this.first = Math.max(0, Math.min(this.first + turn, Math.ceil(length / PAGE) * PAGE - PAGE));
    const last = Math.min(this.first + PAGE, length);
    keepFocus(this.body, () => this.body.replaceChildren(table(this.label, columns.map(([title]) => title), items.slice(this.first, last).map((item) => columns.map(([, text]) => text(item))))));
    this.range.textContent = length ? `${count(this.first + 1)} to ${count(last)} of ${count(length)}` : all.length ? "no rows" : "not loaded yet";
    this.previous.hidden = !this.first;
    this.next.hidden = last === length;
    if (turn) [this.next, this.previous].find((other) => !other.hidden && (turn > 0 ? this.next : this.previous).hidden)?.focus();
  }
}
