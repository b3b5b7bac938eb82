"""What a request's body must be before anything is made of it: small, and there in time."""

import asyncio

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.problems import problem_of
from service.errors import BodyTimeout, ServiceError, TooLarge


class BodyLimit:
    """Middleware: takes in the body up to a cap and within a time, then passes the request on.

    A body that is too long is refused as soon as that is known, without reading it to the end.
    """

    def __init__(self, app: ASGIApp, max_bytes: int, seconds: float) -> None:
        self._app, self._max_bytes, self._seconds = app, max_bytes, seconds

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        try:
            self._check_declared(Headers(scope=scope).get("content-length"))
            body = await asyncio.wait_for(self._taken_in(receive), self._seconds)
        except TimeoutError:
            await _refuse(
                BodyTimeout(f"the body did not arrive within {self._seconds:g} s"), scope, receive, send
            )
        except ServiceError as error:
            await _refuse(error, scope, receive, send)
        else:
            if body is not None:
                await self._app(scope, _replay(body, receive), send)

    def _check_declared(self, length: str | None) -> None:
        if length is not None and length.isdecimal() and int(length[:20]) > self._max_bytes:
            raise self._too_long()

    async def _taken_in(self, receive: Receive) -> bytes | None:
        """The whole body; None if the client went away."""
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
    """A `receive` that hands over the body once and then what else comes (the client going away)."""
    messages: list[Message] = [{"type": "http.request", "body": body, "more_body": False}]

    async def next_message() -> Message:
        return messages.pop() if messages else await receive()

    return next_message


async def _refuse(error: ServiceError, scope: Scope, receive: Receive, send: Send) -> None:
    """Answer with the problem, and end the connection: the rest of the body may still be on its way."""
    problem = problem_of(error)
    problem.headers["Connection"] = "close"
    await problem(scope, receive, send)
