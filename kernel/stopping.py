"""Ends a long computation between two of its steps once nobody wants its result."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar


class Stopped(Exception):
    """The computation was ended before it had a result."""


_is_unwanted: ContextVar[Callable[[], bool]] = ContextVar("is_unwanted", default=lambda: False)


@contextmanager
def stopped_if(is_unwanted: Callable[[], bool]) -> Iterator[None]:
    """Make computations of this thread within the block raise Stopped once `is_unwanted()`.

    They call it very often.
    """
    token = _is_unwanted.set(is_unwanted)
    try:
        yield
    finally:
        _is_unwanted.reset(token)


def check() -> None:
    """Raise Stopped if nobody wants the result; called between steps."""
    if _is_unwanted.get()():
        raise Stopped
