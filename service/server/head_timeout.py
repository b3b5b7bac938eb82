"""How long a connection may take to say what it wants. The web server itself would wait for ever."""

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol

_TOO_SLOW = b"HTTP/1.1 408 Request Timeout\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


class HeadTimeout(H11Protocol):
    """A connection that is closed unless the head of a request is there within `seconds` from its first byte,
    or from when it was opened. The body is `BodyLimit`'s business.
    """

    seconds = 10.0
    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        """Called by the event loop."""
        super().connection_made(transport)
        self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        """Called by the event loop."""
        self._wait_no_more()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Called by the event loop."""
        super().data_received(data)
        if self._answering:
            self._wait_no_more()
        elif self._deadline is None:
            self._wait()

    @property
    def _answering(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _wait(self) -> None:
        self._deadline = self.loop.call_later(self.seconds, self._give_up)

    def _wait_no_more(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _give_up(self) -> None:
        self._deadline = None
        if not self._answering and not self.transport.is_closing():
            self.transport.write(_TOO_SLOW)
            self.transport.close()


def with_head_timeout(seconds: float) -> type[H11Protocol]:
    """The protocol for a web server that waits so long for the head of a request."""
    return type("HeadTimeout", (HeadTimeout,), {"seconds": seconds})
