"""Limits on request bodies: their size and how long they may take to arrive."""

import asyncio

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.problems import problem_response
from service.errors import BodyTimeout, ServiceError, TooLarge


class BodyLimit:
    """Middleware: reads the body, at most `max_bytes` within `timeout` seconds, then passes the request on.

    A body that is too long is refused as soon as that is known, without reading the rest.
    """

    def __init__(self, app: ASGIApp, max_bytes: int, timeout: float) -> None:
        self._app, self._max_bytes, self._timeout = app, max_bytes, timeout

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        try:
            self._check_declared(Headers(scope=scope).get("content-length"))
            body = await asyncio.wait_for(self._read(receive), self._timeout)
        except TimeoutError:
            error = BodyTimeout(f"the body did not arrive within {self._timeout:g} s")
            await _refuse(error, scope, receive, send)
        except ServiceError as error:
            await _refuse(error, scope, receive, send)
        else:
            if body is not None:
                await self._app(scope, _replay(body, receive), send)

    def _check_declared(self, length: str | None) -> None:
        if length is not None and length.isdecimal() and int(length[:20]) > self._max_bytes:
            raise self._too_long()

    async def _read(self, receive: Receive) -> bytes | None:
        """The whole body; None if the client disconnected."""
        parts, size = [], 0
        while True:
            message = await receive()
            if message["type"] == "http.disconnect":
                return None
            parts.append(message.get("body", b""))
            size += len(parts[-1])
            if size > self._max_bytes:
                raise self._too_long()
            if not message.get("more_body", False):
                return b"".join(parts)

    def _too_long(self) -> TooLarge:
        return TooLarge(
            f"the body is longer than {self._max_bytes:,} bytes; an evenly spaced axis is shorter as a range"
            ' {"start", "stop", "num"}'
        )


def _replay(body: bytes, receive: Receive) -> Receive:
    """A `receive` that returns the body once, then the server's next message (a disconnect)."""
    messages: list[Message] = [{"type": "http.request", "body": body, "more_body": False}]

    async def next_message() -> Message:
        return messages.pop() if messages else await receive()

    return next_message


async def _refuse(error: ServiceError, scope: Scope, receive: Receive, send: Send) -> None:
    """Send the problem and close the connection, where the rest of the body may still arrive."""
    response = problem_response(error)
    response.headers["Connection"] = "close"
    await response(scope, receive, send)
