// What was asked, word for word, and what `auto` chose.

import { link } from "../lib/address.js";
import { h } from "../lib/dom.js";
import { downloads, fileName, netcdf } from "../lib/downloads.js";
import { blobOf } from "../lib/api.js";
import { number, plural } from "../lib/format.js";
import { axisValues } from "../lib/physics.js";

export class Details {
  constructor(root, { job }) {
    this.root = root;
    this.update(job);
  }

  close() {}

  update(job) {
    this.root.replaceChildren(h("div", {},
      h("h2", {}, "The sweep as it was submitted"),
      h("pre", { tabindex: "0" }, JSON.stringify(job.spec, null, 2)),
      h("p", {}, h("a", { href: link(["new"], { from: job.id }) }, "Start another sweep from this one")),
      job.failures?.length > 0 && failures(job.failures),
      job.choice && choice(job.choice),
      h("h2", {}, "Elsewhere"),
      h("p", {}, "All of it in Python, loaded as it is used; the diagram from the shell:"),
      h("pre", { tabindex: "0" }, `xarray.open_zarr("${location.origin}/v1/jobs/${job.id}/zarr")\n${command(job)}`),
      downloads([
        ["NetCDF", () => fileName(job, "sweep", "nc"), netcdf(job)],
        ["Parquet", () => fileName(job, "sweep", "parquet"), () => blobOf(`/v1/jobs/${job.id}/export?format=parquet`)],
      ]),
    ));
  }
}

function command({ id, spec }) {
  const middles = ["omega", "xi"].map((axis) => [axis, axisValues(spec[axis])]).filter(([, values]) => values.length > 1)
    .map(([axis, values]) => ` --${axis} ${Number(values[values.length >> 1].toPrecision(6))}`);
  return `bounce diagram ${id}${middles.join("")} -o diagram.svg`;
}

function failures(all) {
  return h("section", {},
    h("h2", {}, "What could not be computed"),
    all.map(({ place, error, traceback, tries }) => h("details", {},
      h("summary", {}, `${place}: ${error} (${plural(tries, "try", "tries")})`),
      h("pre", { tabindex: "0" }, traceback ?? "A worker process died of it."))));
}

function choice({ model, reason, tolerance, table }) {
  const cell = (value) => h("td", {}, value === null ? "–" : number(value, 3));
  return h("section", {},
    h("h2", {}, `Why ${model}`),
    h("p", {}, `${reason} (tolerance ${number(tolerance)} rad).`),
    h("div", { className: "scroll", tabindex: "0", role: "region", "aria-label": "Models compared" },
      h("table", {},
        h("thead", {}, h("tr", {}, ["model", "µs a cell and period", "median (rad)", "95 % (rad)", "cells"].map((title) => h("th", { scope: "col" }, title)))),
        h("tbody", {}, table.map((row) => h("tr", {}, h("th", { scope: "row" }, row.model), cell(row.cost), cell(row.median), cell(row.percentile_95), cell(row.cells)))))));
}
