"""How kernel functions are compiled, and how one is chosen by the type of its first argument.

Compiled code is cached on disk only if NUMBA_CACHE_DIR is set. Numba looks at the file of the outermost
function alone to decide whether a cached one is stale, so the folder must be named after the kernel's
sources, as `worker.kernel_cache` does; a cache beside the sources would outlive a change in an inner
file.

Every function also runs without compilation (NUMBA_DISABLE_JIT=1), for coverage and debugging.
"""

import functools
import os
from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

import numba
from numba.extending import overload, register_jitable

_Function = TypeVar("_Function", bound=Callable[..., Any])

# No "contract": which products are fused with sums would depend on how LLVM inlines, and code read from the
# cache would differ in the last digit from code just compiled. Functions that gain by fused multiply-adds
# write them out: see `kernel.numerics.intrinsics`.
_OPTIONS: Final[Any] = {"nogil": True, "error_model": "numpy"}

# Without numba's runtime: no array is counted up and down as it passes through an inlined function, which was
# a tenth to a fifth of the time in lanes. Such a function must not make arrays or use lists.
_INLINED: Final[Any] = {**_OPTIONS, "forceinline": True, "_nrt": False}


def jit(function: _Function) -> _Function:
    """Compile without the GIL and without exceptions, IEEE arithmetic as written."""
    return cast(_Function, numba.njit(cache=_cached(), **_OPTIONS)(function))


def inlined(function: _Function) -> _Function:
    """As `jit`, but inlined into its caller: for short functions whose call would cost as much as they do.

    They must not make arrays, nor use lists.
    """
    return cast(_Function, numba.njit(cache=_cached(), **_INLINED)(function))


def compilable(function: _Function) -> _Function:
    """Let compiled code call a plain Python function, which stays one for its other callers."""
    return register_jitable(error_model=_OPTIONS["error_model"])(function)


def _cached() -> bool:
    """Whether compiled code goes to disk."""
    return "NUMBA_CACHE_DIR" in os.environ


class by_type:  # noqa: N801 - a decorator
    """Decorator: a kernel function with one implementation for each type of its first argument.

    The types are NamedTuples. The choice is made at compile time and costs nothing at run time;
    functions passed as arguments would serve as well but cannot be cached. Called from Python it is a
    look-up, which raises TypeError for a type without an implementation. With `inline` the implementation,
    if it is `inlined`, becomes part of its caller.
    """

    def __init__(self, declaration: Callable[..., Any], *, inline: bool = False) -> None:
        functools.update_wrapper(self, declaration)
        self._implementations: dict[type, Callable[..., Any]] = {}
        self._otherwise: Callable[..., Any] | None = None
        options = _INLINED if inline else _OPTIONS
        overload(self, jit_options=options)(lambda first, *rest: self._resolve(first))

    def __call__(self, first: Any, *rest: Any) -> Any:
        chosen = self._chosen(type(first))
        if chosen is None:
            raise TypeError(f"not implemented for {type(first).__name__}")
        return chosen(first, *rest)

    def __contains__(self, kind: type) -> bool:
        """Whether a function is registered for first arguments of this type."""
        return kind in self._implementations

    def _chosen(self, kind: type) -> Callable[..., Any] | None:
        """The implementation for a type, or the default one, or None."""
        return self._implementations.get(kind, self._otherwise)

    def _resolve(self, first: Any) -> Callable[..., Any] | None:
        """Numba's side of the call: `first` is the type of the argument, as numba describes it."""
        chosen = self._chosen(getattr(first, "instance_class", type(None)))
        return None if chosen is None else lambda first, *rest: chosen(first, *rest)  # noqa: PLW0108

    def register(self, kind: type) -> Callable[[_Function], _Function]:
        """Decorator: the implementation for first arguments of type `kind`."""

        def add(function: _Function) -> _Function:
            self._implementations[kind] = function
            return function

        return add

    def otherwise(self, function: _Function) -> _Function:
        """Decorator: the implementation for first arguments of all other types."""
        self._otherwise = function
        return function
