"""An HTTP server that gives the answers of a script, or those of paths, and records what it is asked."""

import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any

from service.client import Client

ID = "0123456789abcdef" * 2
LOST = None  # the connection is closed instead of an answer


def view(state: str = "running", done: int = 0) -> dict[str, Any]:
    progress = {
        "chunks_done": 0,
        "chunks_total": 1,
        "cells_done": done,
        "cells_total": 10,
        "percent": 10.0 * done,
    }
    return {"id": ID, "name": "", "state": state, "progress": progress | {"eta_seconds": None}, "error": None}


class Answer:
    """One answer, as written in a script."""

    def __init__(self, status: int = 200, body: Any = None, **headers: str) -> None:
        self.status, self.headers = status, {name.replace("_", "-"): value for name, value in headers.items()}
        self.body = (
            body if isinstance(body, bytes) else json.dumps(body).encode() if body is not None else b""
        )


class Server(HTTPServer):
    """Gives the answers of a script one by one, or each path its own, and records the requests."""

    script: list[Answer | None]
    contents: dict[str, Answer] | None
    requests: list[tuple[str, str, dict[str, str]]]
    when: list[float]


class Handler(BaseHTTPRequestHandler):
    server: Server

    def answer(self) -> None:
        self.rfile.read(int(self.headers.get("Content-Length", 0)))
        self.server.requests.append((self.command, self.path, dict(self.headers)))
        self.server.when.append(time.monotonic())
        contents = self.server.contents
        answer = self.server.script.pop(0) if contents is None else contents.get(self.path, Answer(404))
        if answer is LOST:
            self.connection.shutdown(socket.SHUT_RDWR)
            return
        self.send_response(answer.status)
        length = {} if "Connection" in answer.headers else {"Content-Length": str(len(answer.body))}
        for name, value in (length | answer.headers).items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(answer.body)

    do_GET = do_POST = do_DELETE = answer  # noqa: N815 - the names http.server looks for

    def log_message(self, *_: object) -> None: ...


@contextmanager
def scripted(
    *script: Answer | None, contents: dict[str, Answer] | None = None
) -> Iterator[tuple[Server, Client]]:
    """A server that gives these answers, all of which must be used at the end, and a client."""
    with Server(("127.0.0.1", 0), Handler) as server:
        server.script, server.contents, server.requests, server.when = list(script), contents, [], []
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            with Client(f"http://127.0.0.1:{server.server_port}/") as client:
                yield server, client
        finally:
            server.shutdown()
            thread.join()
        assert server.script == []
