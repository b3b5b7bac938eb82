// The audit of a sweep: how many of its cells a longer computation would change.

import { link } from "../lib/address.js";
import { isHandledElsewhere, partsOf, requestDataset } from "../lib/api.js";
import { announce, h } from "../lib/dom.js";
import { number, plural, share } from "../lib/format.js";
import { table } from "../lib/table.js";

/** A button that has workers audit the job, and what they find; `element` stays as the details around it change. */
export class Audit {
  constructor(job) {
    this.job = job;
    this.button = h("button", { type: "button", onclick: () => this.run() }, "Audit this sweep");
    this.found = h("div", {});
    this.element = h("section", {},
      h("h2", {}, "Audit"),
      h("p", {}, "Random cells are computed again so that they can be trusted: how many of all cells would change, at most?"),
      h("p", {}, this.button), this.found);
  }

  async run() {
    this.button.disabled = true;
    this.button.textContent = "Auditing …";
    try {
      const audit = await requestDataset(`/v1/jobs/${this.job.id}/audit`);
      const sentence = `${audit.attrs.sentence[0].toUpperCase()}${audit.attrs.sentence.slice(1)}.`;
      this.found.replaceChildren(h("p", {}, sentence), questions(audit), changed(this.job, audit));
      announce(audit.attrs.sentence);
    } catch (error) {
      if (!isHandledElsewhere(error)) this.found.replaceChildren(h("p", { role: "alert" }, error.message));
    } finally {
      this.button.disabled = false;
      this.button.textContent = "Audit this sweep";
    }
  }
}

function questions(audit) {
  const contacts = audit.against.data instanceof Array ? audit.against.data : [audit.against.data];
  const asked = audit.question.data;
  const rows = contacts.flatMap((against, k) => asked.map((question, i) => ({ against, question, at: k * asked.length + i })));
  const cells = ({ at }) => [...["sampled", "changed", "undecided"].map((name) => String(audit[name].data[at])), ...["share", "low", "high"].map((name) => share(audit[name].data[at]))];
  return table("Audit by question", ["question", "drawn", "changed", "undecided", "share", "at least", "at most"],
    rows.filter(({ at }) => audit.sampled.data[at] > 0).map((row) => [contacts.length > 1 ? `${row.question} (${row.against})` : row.question, ...cells(row)]));
}

function changed(job, audit) {
  const cells = partsOf(audit, "cell");
  if (!cells.length) return h("p", {}, "No cell looked at has changed.");
  return h("details", {},
    h("summary", {}, `${plural(cells.length, "cell")} that changed, or that the reference does not decide`),
    h("ul", {}, cells.map((cell) => h("li", {},
      h("a", { href: link(["job", job.id, "diagram"], { cell: [cell.cell_gamma, cell.cell_omega, cell.cell_xi, cell.cell_direction].join(",") }) },
        `Γ = ${number(cell.cell_gamma)}, Ω = ${number(cell.cell_omega)}, ξ = ${number(cell.cell_xi)}`),
      `: ${cell.cell_stored}, by the reference ${cell.cell_reference}${cell.cell_undecided ? " (undecided)" : ""}`))));
}
