// The service goes away and comes back; it may want a token. Both are said at the top of the page.

import { ask, connection, setToken } from "./api.js";
import { say } from "./dom.js";

const AGAIN = 1000;
let trying = false;

/** Watches the connection; `back` is called when asking makes sense again. */
export function watch(back) {
  const banner = document.getElementById("lost");
  const dialog = document.getElementById("token");

  connection.addEventListener("lost", () => {
    if (trying) return;
    trying = true;
    banner.hidden = false;
    tryAgain(() => {
      trying = false;
      banner.hidden = true;
      say("The service answers again.");
      back();
    });
  });

  connection.addEventListener("token", () => {
    if (!dialog.open) dialog.showModal();
  });
  dialog.querySelector("form").addEventListener("submit", (event) => {
    event.preventDefault();
    const field = dialog.querySelector("input");
    setToken(field.value.trim());
    field.value = "";
    dialog.close();
    back();
  });
}

async function tryAgain(then) {
  try {
    await ask("/healthz", { patience: 3000 });
    then();
  } catch {
    setTimeout(() => tryAgain(then), AGAIN);
  }
}
