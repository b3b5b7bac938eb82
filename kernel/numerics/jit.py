"""The one way a kernel function is compiled, and the one way it is chosen.

Compiled code is cached on disk only where NUMBA_CACHE_DIR says so. Numba looks at
the file of the outermost function alone to decide whether a cached one is stale,
so whoever sets that folder must name it after the kernel's sources (the worker
does); a cache beside the sources would outlive a change in an inner file.
"""

import functools
import os
from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

import numba
from numba.extending import overload

_Function = TypeVar("_Function", bound=Callable[..., Any])

# No "contract": which products are fused with sums would hang on how LLVM inlines, and code read from the
# cache then differs in the last digit from code just compiled. What gains by it writes it out: see
# `kernel.numerics.intrinsics`.
_OPTIONS: Final[Any] = {"nogil": True, "error_model": "numpy"}


def jit(function: _Function) -> _Function:
    """Compile without the GIL and without exceptions, IEEE arithmetic as written."""
    return cast(_Function, numba.njit(cache=_cached(), **_OPTIONS)(function))


def inlined(function: _Function) -> _Function:
    """As `jit`, but made part of its caller: for what a lane does every phase, where a call costs as much."""
    return cast(_Function, numba.njit(cache=_cached(), forceinline=True, **_OPTIONS)(function))


def _cached() -> bool:
    return "NUMBA_CACHE_DIR" in os.environ


class by_type:  # noqa: N801 - a decorator
    """A kernel function with one implementation for each type of its first argument, a NamedTuple.

    Resolved while compiling, so it costs nothing; functions passed as arguments would do the
    same but cannot be cached. Without compilation (NUMBA_DISABLE_JIT=1) it is an ordinary look-up.
    """

    def __init__(self, declaration: Callable[..., Any]) -> None:
        functools.update_wrapper(self, declaration)
        self._implementations: dict[type, Callable[..., Any]] = {}
        self._otherwise: Callable[..., Any] | None = None
        overload(self, jit_options=_OPTIONS)(lambda first, *rest: self._resolve(first))

    def __call__(self, first: Any, *rest: Any) -> Any:
        chosen = self._chosen(type(first))
        if chosen is None:
            raise TypeError(f"no model answers this for a {type(first).__name__}")
        return chosen(first, *rest)

    def __contains__(self, kind: type) -> bool:
        """Whether a function is registered for first arguments of this type."""
        return kind in self._implementations

    def _chosen(self, kind: type) -> Callable[..., Any] | None:
        return self._implementations.get(kind, self._otherwise)

    def _resolve(self, first: Any) -> Callable[..., Any] | None:
        chosen = self._chosen(getattr(first, "instance_class", type(None)))
        return None if chosen is None else lambda first, *rest: chosen(first, *rest)  # noqa: PLW0108

    def register(self, kind: type) -> Callable[[_Function], _Function]:
        """Decorator: this function answers for first arguments of type `kind`."""

        def remember(function: _Function) -> _Function:
            self._implementations[kind] = function
            return function

        return remember

    def otherwise(self, function: _Function) -> _Function:
        """Decorator: this function answers for first arguments of all other types."""
        self._otherwise = function
        return function
