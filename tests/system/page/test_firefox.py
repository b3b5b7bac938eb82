"""A shared file in Firefox, opened from disk: everything that is requested fails."""

import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from scripted import DEADLINE
from served import done
from studies import spec_of
from tornado.ioloop import IOLoop
from tornado.websocket import websocket_connect

from service.cli.main import main

FIREFOX = shutil.which("firefox-esr") or shutil.which("firefox")
SWEEP = spec_of((0.5, 1.4, 46), [0.5, 0.6, 0.7], 0.05, name="Shared", ramp="both", window=(120, 30, 24))

#: Opens a tab and returns what it says, once its plot, if there is one, is drawn.
TAB = """async name => {
    const wait = (ms) => new Promise((next) => setTimeout(next, ms));
    const tab = () => [...document.querySelectorAll(".tabs a")].find((a) => a.textContent === name);
    while (!tab()) await wait(50);
    tab().click();
    while (tab().getAttribute("aria-current") !== "page") await wait(50);
    while (!document.querySelector(name === "Details" ? ".snippets" : ".panel .plot[data-shown]"))
        await wait(50);
    const pixels = ({ width, height }, context) => context.getImageData(0, 0, width, height).data.buffer;
    const colours = (canvas) => new Set(new Uint32Array(pixels(canvas, canvas.getContext("2d")))).size;
    const canvas = document.querySelector(".panel .plot canvas");
    return `${canvas ? colours(canvas) : 0} ${document.body.innerText}`;
}"""


@contextmanager
def firefox(folder: Path) -> Iterator[str]:
    """The address at which a Firefox without a network takes commands."""
    offline = {"type": 1, "http": "127.0.0.1", "http_port": 9, "ssl": "127.0.0.1", "ssl_port": 9}
    lines = (f'user_pref("network.proxy.{name}", {json.dumps(value)});' for name, value in offline.items())
    (folder / "user.js").write_text("\n".join(lines))
    command = [FIREFOX, "--headless", "--no-remote", "--profile", str(folder), "--remote-debugging-port", "0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
        try:
            found = (
                re.search(r"listening on (ws://127\.0\.0\.1:\d+)", line) for line in process.stderr or ()
            )
            yield next(match[1] for match in found if match)
        finally:
            process.terminate()


async def _said(address: str, page: str, tabs: list[str]) -> tuple[list[str], list[str]]:
    """What the tabs of a page say, and what its console says."""
    socket = await websocket_connect(f"{address}/session")
    console: list[str] = []

    async def do(method: str, **parameters: Any) -> Any:
        await socket.write_message(json.dumps({"id": 1, "method": method, "params": parameters}))
        while True:
            answer = json.loads(await socket.read_message() or "{}")
            if answer.get("method") == "log.entryAdded":
                console.append(str(answer["params"]["text"]))
            elif "id" in answer:
                assert answer["type"] == "success", answer
                return answer["result"]

    await do("session.new", capabilities={})
    await do("session.subscribe", events=["log.entryAdded"])
    context = (await do("browsingContext.getTree"))["contexts"][0]["context"]
    await do("browsingContext.navigate", context=context, url=page, wait="complete")
    texts = []
    for tab in tabs:
        argument = {"type": "string", "value": tab}
        result = await do(
            "script.callFunction",
            functionDeclaration=TAB,
            arguments=[argument],
            target={"context": context},
            awaitPromise=True,
        )
        texts.append(result["result"]["value"])
    socket.close()
    return texts, console


@pytest.mark.skipif(
    FIREFOX is None, reason="Firefox is not installed; on Debian: apt-get install firefox-esr"
)
def test_a_shared_file_opens_in_firefox_without_a_network(address: str, tmp_path: Path):
    job = done(address, SWEEP)
    file = tmp_path / "shared.html"
    assert CliRunner().invoke(main, ["share", job, "-o", str(file), "--url", address]).exit_code == 0
    tabs = ["Diagram", "Mode map", "Thresholds", "Details"]
    with firefox(tmp_path) as listening:
        said, console = IOLoop(make_current=False).run_sync(
            lambda: _said(listening, file.as_uri(), tabs), timeout=DEADLINE
        )
    assert console == []
    for text, shown in zip(
        said, ["flight time φ", "threshold, Eq. 25", "threshold Γ", "Kernel version"], strict=True
    ):
        assert shown in text
    assert [int(text.split()[0]) > 4 for text in said] == [True, True, True, False]
