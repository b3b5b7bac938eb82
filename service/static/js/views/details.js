// Where a sweep comes from (times, versions, cost), its specification, the chunks that failed, the model that `auto`
// selected, and access from elsewhere.

import { requestJson, shared } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { downloads, wholeSweep } from "../lib/downloads.js";
import { count, duration, number, plural, time } from "../lib/format.js";
import { isSweep } from "../lib/physics.js";
import { table } from "../lib/table.js";
import { Snippets } from "../lib/snippets.js";
import { Audit } from "./audit.js";
import { sharedPage } from "./measured.js";

export class Details {
  constructor(root, { sources: [{ job }] }) {
    this.root = root;
    this.snippets = new Snippets("JSON");
    this.audit = new Audit(job);
    this.update(job);
    // The details are shown without what the service runs on until it answers; another view reports that it does not.
    requestJson("/v1/software").then((software) => { this.software = software; this.update(this.job); }, () => {});
  }

  close() {}

  update(job) {
    this.job = job;
    this.snippets.show(job.spec);
    this.root.replaceChildren(h("div", {},
      h("h2", {}, "Origin"),
      table("Origin of the sweep", null, origin(job, this.software)),
      h("h2", {}, "Specification"),
      this.snippets.element,
      job.failures?.length > 0 && failures(job.failures),
      job.choice && selection(job.choice),
      isSweep(job.spec) && job.state === "done" && !shared && this.audit.element,
      !shared && [
        h("h2", {}, "Results"),
        h("p", {}, "As an xarray dataset, loaded as needed:"),
        h("pre", { tabindex: "0" }, `xarray.open_zarr("${location.origin}/v1/jobs/${job.id}/zarr")`),
        isSweep(job.spec) && downloads([...wholeSweep(job, [["NetCDF", "nc"], ["Parquet", "parquet"]]), sharedPage(job)]),
      ],
    ));
  }
}

/** Rows of a table: [title, text]. */
function origin(job, software) {
  const { progress } = job;
  const seconds = job.started && job.finished ? (new Date(job.finished) - new Date(job.started)) / 1000 : null;
  const cells = progress.cells_computed === null ? plural(progress.cells_done, "cell") : `${count(progress.cells_computed)} of ${plural(progress.cells_done, "cell")}`;
  const each = job.core_seconds && progress.cells_done ? `, ${number((1000 * job.core_seconds) / (progress.cells_computed ?? progress.cells_done), 3)} ms per cell` : "";
  return [
    ["Job", h("code", {}, job.id)],
    job.owner && ["Submitted by", job.owner],
    job.created && ["Submitted", time(job.created)],
    job.started && ["Started", time(job.started)],
    job.finished && ["Finished", `${time(job.finished)}${seconds === null ? "" : `, after ${duration(seconds)}`}`],
    ["Computed", `${cells} in ${count(progress.chunks_done)} of ${plural(progress.chunks_total, "chunk")}`],
    ["Core-seconds", job.core_seconds ? `${number(job.core_seconds, 4)}${each}` : "not known"],
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

function selection({ model, reason, tolerance, table: rows }) {
  const cell = (value) => (value === null ? "–" : number(value, 3));
  return h("section", {},
    h("h2", {}, `Selected model: ${model}`),
    h("p", {}, `${reason} (tolerance ${number(tolerance)} rad).`),
    table("Comparison of the models", ["model", "µs per cell per plate period", "median (rad)", "95 % (rad)", "cells"],
      rows.map((row) => [row.model, cell(row.cost), cell(row.median), cell(row.percentile_95), cell(row.cells)])));
}
