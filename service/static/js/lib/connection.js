// The banner shown while the service does not answer, the note on what requests wait for, and the dialog for its access token.

import { connection, request, setToken, sleep } from "./api.js";
import { announce } from "./dom.js";

const RETRY_MS = 1000;
const TIMEOUT_MS = 3000;

/** Show the banner and the dialog when they are needed; `onRestored` is called when requests can succeed again. */
export function watchConnection(onRestored) {
  const banner = document.getElementById("offline");
  const dialog = document.getElementById("token");

  connection.addEventListener("unreachable", async () => {
    if (!banner.hidden) return; // retrying already
    banner.hidden = false;
    while (!(await request("/healthz", { timeout: TIMEOUT_MS }).catch(() => null))) await sleep(RETRY_MS);
    banner.hidden = true;
    announce("The service answers again.");
    onRestored();
  });

  const busy = document.getElementById("busy");
  connection.addEventListener("waiting", ({ detail: why }) => Object.assign(busy, { hidden: !why }, why && { textContent: why }));

  const refusal = dialog.querySelector(".problem");
  connection.addEventListener("unauthorized", ({ detail: { refused } }) => {
    refusal.hidden = !refused;
    if (dialog.open) return;
    dialog.returnValue = "";
    dialog.showModal();
  });
  const input = dialog.querySelector("input");
  dialog.addEventListener("submit", () => setToken(input.value.trim()));
  dialog.addEventListener("close", () => {
    if (!dialog.returnValue) return dialog.showModal(); // after Escape: nothing can be shown
    input.value = "";
    onRestored();
  });
}
