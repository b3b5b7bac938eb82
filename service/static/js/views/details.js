// A sweep's origin, specification, failed chunks, the model that `auto` selected, its audit, and access from elsewhere.

import { cellQuery, link } from "../lib/address.js";
import { SERVICE, partsOf, requestDataset, requestJson, shared } from "../lib/api.js";
import { announce, downloads, h, keepFocus, problemLine, workButton } from "../lib/dom.js";
import { count, duration, number, plural, share, time } from "../lib/format.js";
import { axisText, inSymbols, isSweep } from "../lib/physics.js";
import { table } from "../lib/table.js";
import { snippets } from "../lib/snippets.js";
import { wholeStudy } from "./measured.js";
import { sourceOf } from "./plot-view.js";
import { isAudited } from "./progress.js";

export class Details {
  constructor(root, { sources: [{ job }], signal }) {
    this.root = root;
    this.snippets = snippets("JSON");
    this.audit = auditOf(job); // stays as the details around it change
    this.update(job);
    // The details are shown without what the service runs on until it answers; another view reports that it does not.
    requestJson("/v1/software", { signal }).then((software) => { this.software = software; this.update(this.job); }, () => {});
  }

  update(job) {
    this.job = job;
    this.snippets.show(job.spec);
    keepFocus(this.root, () => this.root.replaceChildren(h("div", {},
      h("h2", {}, "Origin"),
      table("Origin of the sweep", null, origin(job, this.software)),
      h("h2", {}, "Specification"),
      this.snippets.element,
      job.failures?.length > 0 && failures(job.failures),
      job.choice && selection(job.choice),
      isSweep(job.spec) && job.state === "done" && !shared && this.audit,
      !shared && [
        h("h2", {}, "Results"),
        h("p", {}, "As an xarray dataset, loaded as needed:"),
        h("pre", { tabindex: "0" }, `xarray.open_zarr("${SERVICE}/v1/jobs/${job.id}/zarr")`),
        downloads(wholeStudy(job, [["NetCDF", "nc"], ["Parquet", "parquet"]])),
      ],
    )));
  }
}

function origin(job, software) {
  const { progress } = job;
  const elapsed = job.started && job.finished ? `, after ${duration((new Date(job.finished) - new Date(job.started)) / 1000)}` : "";
  const isAdaptive = progress.cells_computed !== null;
  const cells = `${isAdaptive ? `${count(progress.cells_computed)} of ` : ""}${plural(progress.cells_done, "cell")}`;
  const milliseconds = (1000 * job.core_seconds) / (progress.cells_computed ?? progress.cells_done);
  const perCell = progress.cells_done ? `, ${number(milliseconds, 3)} ms per cell` : "";
  return [
    ["Job", h("code", {}, job.id)],
    job.owner && ["Submitted by", job.owner],
    job.created && ["Submitted", time(job.created)],
    job.started && ["Started", time(job.started)],
    job.finished && ["Finished", time(job.finished) + elapsed],
    !shared && ["Computed", `${cells} in ${count(progress.chunks_done)} of ${plural(progress.chunks_total, "chunk")}`],
    !shared && ["Core-seconds", job.core_seconds ? number(job.core_seconds, 4) + perCell : "not known"],
    ["Kernel version", job.kernel_version],
    software && ["This service", `bouncing-spring ${software.release}, kernel version ${software.kernel_version}`],
    software && ["Software", [`Python ${software.python}`, ...Object.entries(software.libraries).map(([name, version]) => `${name} ${version}`)].join(", ")],
    ...(shared ? Object.entries(shared.about).filter(([, text]) => text) : []),
  ].filter(Boolean);
}

function failures(chunks) {
  return h("section", {},
    h("h2", {}, "Failed chunks"),
    chunks.map(({ place, error, traceback, tries }) => h("details", {},
      h("summary", {}, `${place}: ${error} (${plural(tries, "attempt")})`),
      h("pre", { tabindex: "0" }, traceback ?? "No traceback: the worker process died."))));
}

function selection({ model, reason, table: rows }) {
  return h("section", {},
    h("h2", {}, `Selected model: ${model}`),
    h("p", {}, `${reason}.`),
    table("Comparison of the models", ["model", "µs per cell per plate period", "median (rad)", "95 % (rad)", "cells"],
      rows.map((row) => [row.model, ...[row.cost, row.median, row.percentile_95, row.cells].map((value) => number(value, 3))])));
}

/** A button that has workers audit the job: how many of its cells a longer computation would change. */
function auditOf(job) {
  const [problem, answer] = [problemLine(), h("div", {})];
  const audit = async () => {
    problem.show(null);
    const result = await requestDataset(`/v1/jobs/${job.id}/audit`);
    const { sentence } = result.attrs;
    answer.replaceChildren(h("p", {}, `${sentence[0].toUpperCase()}${sentence.slice(1)}.`), questionTable(result), changedCells(job, result));
    announce(sentence);
  };
  if (isAudited(job) && !shared) audit().catch(problem.show); // the service has the answer
  return h("section", {},
    h("h2", {}, "Audit"),
    h("p", {}, "How many of all cells would a longer computation change, at most? Random cells are computed again, in about a tenth of the sweep's time, or more for a small sweep."),
    h("p", {}, workButton("Audit this sweep", audit, problem.show, { busy: "Auditing …" })), problem.element, answer);
}

/** The shares that changed, by question and, where there are several, by the contact that the reference has. */
function questionTable(audit) {
  const contacts = [audit.against.data].flat();
  const titles = contacts.flatMap((against) => audit.question.data.map((question) => (contacts.length > 1 ? `${question} (${against})` : question)));
  const rows = titles.map((title, i) => [title, ...["sampled", "changed", "undecided"].map((name) => String(audit[name].data[i])),
    ...[["share", null], ["low", false], ["high", true]].map(([name, isUpper]) => share(audit[name].data[i], 3, isUpper))]);
  return table("Audit by question", ["question", "drawn", "changed", "undecided", "share", "at least", "at most"],
    rows.filter((_, i) => audit.sampled.data[i] > 0));
}

function changedCells(job, audit) {
  const [cells, { grid }] = [partsOf(audit, "cell"), sourceOf(job)];
  if (!cells.length) return h("p", {}, "None of the cells computed again has changed.");
  return h("details", {},
    h("summary", {}, `${plural(cells.length, "cell")} that changed, or that the reference does not decide`),
    h("ul", {}, cells.map(({ gamma, omega, xi, direction, stored, reference, undecided, set }) => h("li", {},
      h("a", { href: link(["job", job.id, "diagram"], cellQuery({ gamma, omega, xi, direction })) },
        `Γ = ${axisText(gamma, grid.gamma)}, Ω = ${axisText(omega, grid.omega)}, ξ = ${axisText(xi, grid.xi)}`),
      `: ${inSymbols(stored)}, by the reference ${inSymbols(reference)}${undecided ? " (undecided)" : ""}${set === "besides" ? "; a hard cell, not counted above" : ""}`))));
}
