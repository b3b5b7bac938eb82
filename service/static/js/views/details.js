// The specification of a sweep, the chunks that failed, the model that `auto` selected, and access from elsewhere.

import { link } from "../lib/address.js";
import { requestBlob } from "../lib/api.js";
import { h } from "../lib/dom.js";
import { downloads, fileName, netcdf } from "../lib/downloads.js";
import { number, plural } from "../lib/format.js";
import { axisValues, isSweep } from "../lib/physics.js";

export class Details {
  constructor(root, { job }) {
    this.root = root;
    this.update(job);
  }

  close() {}

  update(job) {
    this.root.replaceChildren(h("div", {},
      h("h2", {}, "Specification"),
      h("pre", { tabindex: "0" }, JSON.stringify(job.spec, null, 2)),
      isSweep(job.spec) && h("p", {}, h("a", { href: link(["new"], { from: job.id }) }, "New sweep from this specification")),
      job.failures?.length > 0 && failures(job.failures),
      job.choice && selection(job.choice),
      h("h2", {}, "Python and command line"),
      h("p", {}, "The results as an xarray dataset, loaded as needed:"),
      h("pre", { tabindex: "0" }, `xarray.open_zarr("${location.origin}/v1/jobs/${job.id}/zarr")`),
      ...(isSweep(job.spec) ? files(job) : []),
    ));
  }
}

function files(job) {
  return [
    h("p", {}, "The bifurcation diagram as a file:"),
    h("pre", { tabindex: "0" }, diagramCommand(job)),
    downloads([
      ["NetCDF", () => fileName(job, "sweep", "nc"), netcdf(job)],
      ["Parquet", () => fileName(job, "sweep", "parquet"), () => requestBlob(`/v1/jobs/${job.id}/export?format=parquet`)],
    ]),
  ];
}

/** The command needs a value for each fixed axis of several: the middle one. */
function diagramCommand({ id, spec }) {
  const fixed = ["omega", "xi"].map((axis) => [axis, axisValues(spec[axis])]).filter(([, values]) => values.length > 1)
    .map(([axis, values]) => ` --${axis} ${Number(values[values.length >> 1].toPrecision(6))}`);
  return `bounce diagram ${id}${fixed.join("")} -o diagram.svg`;
}

function failures(chunks) {
  return h("section", {},
    h("h2", {}, "Failed chunks"),
    chunks.map(({ place, error, traceback, tries }) => h("details", {},
      h("summary", {}, `${place}: ${error} (${plural(tries, "attempt")})`),
      h("pre", { tabindex: "0" }, traceback ?? "No traceback: the worker process died."))));
}

function selection({ model, reason, tolerance, table }) {
  const cell = (value) => h("td", {}, value === null ? "–" : number(value, 3));
  const columns = ["model", "µs per cell per plate period", "median (rad)", "95 % (rad)", "cells"];
  return h("section", {},
    h("h2", {}, `Selected model: ${model}`),
    h("p", {}, `${reason} (tolerance ${number(tolerance)} rad).`),
    h("div", { className: "scroll", tabindex: "0", role: "region", "aria-label": "Comparison of the models" },
      h("table", {},
        h("thead", {}, h("tr", {}, columns.map((title) => h("th", { scope: "col" }, title)))),
        h("tbody", {}, table.map((row) => h("tr", {}, h("th", { scope: "row" }, row.model), cell(row.cost), cell(row.median), cell(row.percentile_95), cell(row.cells)))))));
}
