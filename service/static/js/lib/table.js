// Tables: plain ones, and long ones in pages, which can be copied and saved.

import { copyButton, h } from "./dom.js";
import { downloads } from "./downloads.js";
import { count, plain } from "./format.js";

const PAGE = 25; // rows

/** A table in a region that scrolls. The first cell of a row names it; cells are texts or nodes, `rowClass(i)` a row's class. */
export const table = (label, titles, rows, rowClass = () => undefined) => h("div", { className: "scroll", tabindex: "0", role: "region", "aria-label": label }, h("table", {},
  titles && h("thead", {}, h("tr", {}, titles.map((title) => h("th", { scope: "col" }, title)))),
  h("tbody", {}, rows.map(([first, ...others], i) => h("tr", { className: rowClass(i) }, h("th", { scope: "row" }, first), others.map((cell) => h("td", {}, cell)))))));

/** Rows as lines, their cells separated by `separator`, with numbers as programs read them; in CSV cells with commas or quotes are quoted. */
const lines = ([columns, items], separator) => [columns.map(([title]) => title), ...items.map((item) => columns.map(([, text]) => text(item, true)))]
  .map((cells) => cells.map((cell) => plain(separator === "," && /[",]/.test(cell) ? `"${cell.replaceAll('"', '""')}"` : cell)).join(separator)).join("\n");

/** A table of PAGE rows at a time, folded away; `read()` gives its columns, [[title, (item, whole) => text, shortened or not], …], and the items whenever it is shown, `name()` the CSV's name. */
export class PagedTable {
  constructor(label, read, name, open = false) {
    Object.assign(this, { label, read, first: 0 });
    const turn = (title, rows) => h("button", { type: "button", className: "quiet", onclick: () => { this.first += rows; this.update(); } }, title);
    this.body = h("div", {});
    this.range = h("span", { className: "note", role: "status" });
    [this.previous, this.next] = [turn("Previous rows", -PAGE), turn("Next rows", PAGE)];
    this.element = h("details", { className: "paged", open, ontoggle: () => this.update() }, h("summary", {}, label), this.body,
      h("div", { className: "actions" }, this.previous, this.next, this.range),
      h("div", { className: "actions" }, copyButton(() => lines(this.read(), "\t")), downloads([["table as CSV", name, () => new Blob([lines(this.read(), ",")], { type: "text/csv" })]])));
  }

  /** Show the rows that there are now, while the table is open. */
  update() {
    if (!this.element.open) return;
    const [columns, items] = this.read();
    const { length } = items;
    this.first = Math.max(0, Math.min(this.first, Math.ceil(length / PAGE) * PAGE - PAGE));
    const last = Math.min(this.first + PAGE, length);
    this.body.replaceChildren(table(this.label, columns.map(([title]) => title), items.slice(this.first, last).map((item) => columns.map(([, text]) => text(item)))));
    this.range.textContent = length ? `${count(this.first + 1)} to ${count(last)} of ${count(length)}` : "no rows";
    this.previous.hidden = !this.first;
    this.next.hidden = last === length;
  }
}
