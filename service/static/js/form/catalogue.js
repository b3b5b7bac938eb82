// Sweeps to start from: those behind the paper's figures, as the service has them, and one of the page's own.

import { askJson } from "../lib/api.js";

const OWN = {
  title: "a map of modes",
  sweeps: [{
    name: "a map of modes", gamma: { start: 0.1, stop: 5, num: 197 }, omega: { start: 0.3, stop: 1.7, num: 141 }, xi: 0.05,
    model: { kind: "rigid" }, settle: 150, observe: 60, keep: 48,
  }],
};

let asked = null;

/** [{label, title, sweeps: [{key, spec}, …]}, …]; `key` is what an address calls a sweep: "7" or "7.2". */
export async function presets() {
  asked ??= askJson("/v1/figures").catch((error) => {
    asked = null; // so that it is asked again when the service is back
    throw error;
  });
  return [...(await asked).map((figure) => ({ ...figure, label: `Fig. ${figure.number}` })), { ...OWN, label: "Beyond it" }]
    .map(({ number = "map", label, title, sweeps }) => ({
      label, title, sweeps: sweeps.map((spec, i) => ({ spec, key: i ? `${number}.${i + 1}` : String(number) })),
    }));
}
