"""How kernel functions are declared, and how one is chosen by the type of its first argument.

A function is compiled into its callers (`kernel.numerics.compilation`), and on its own when Python calls it.
Every function also runs without compilation (NUMBA_DISABLE_JIT=1), for coverage and debugging.
"""

import functools
import os
from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

import numba
from numba import types
from numba.core.registry import CPUDispatcher
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.extending import register_jitable

from kernel.numerics.compilation import Entry, Inner

_Function = TypeVar("_Function", bound=Callable[..., Any])

#: Plain `numba.njit`, should numba's internals change: see `kernel.numerics.compilation`.
PLAIN: Final = bool(os.environ.get("BOUNCE_PLAIN_NJIT"))

# No "contract": which products are fused with sums would depend on how LLVM inlines: see `elementary.fma`.
# Every option is stated: numba hands "forceinline" and "_nrt" down from the function that it is compiling.
# "_nrt": without numba's runtime no array is counted up and down as it passes through a function, which was
# a tenth to a fifth of the time in lanes.
_ALLOCATING: Final[Any] = {"nogil": True, "error_model": "numpy", "forceinline": False, "_nrt": True}
_OPTIONS: Final[Any] = {**_ALLOCATING, "_nrt": False}
_INLINED: Final[Any] = {**_OPTIONS, "forceinline": True}


class _Kernel(CPUDispatcher):
    """A function that is compiled into its callers; for Python it is compiled as an entry of its own."""

    @functools.cached_property
    def entry(self) -> Any:
        """The function for Python."""
        return Entry(self.py_func, _ALLOCATING)

    def __call__(self, *args: Any) -> Any:
        return self.entry(*args)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """As numba does, but not for each constant that is passed as an integer anew."""
        plain = (types.unliteral(each) if isinstance(each, types.IntegerLiteral) else each for each in args)
        return super().get_call_template(tuple(plain), kws)

    def compile(self, sig: Any) -> Any:
        """As numba does, quicker where that is done: it asks at every call that it types."""
        done = self.overloads.get(sig) if isinstance(sig, tuple) else None
        return super().compile(sig) if done is None else done.entry_point


def _declare(function: _Function, options: dict[str, Any]) -> _Function:
    if PLAIN or numba.config.DISABLE_JIT:
        return cast(_Function, numba.njit(**options)(function))
    return cast(
        _Function, _Kernel(function, targetoptions={"nopython": True, **options}, pipeline_class=Inner)
    )


def jit(function: _Function) -> _Function:
    """Compile without the GIL and without exceptions, IEEE arithmetic as written.

    The function must not make arrays or lists, nor call what returns them.
    """
    return _declare(function, _OPTIONS)


def inlined(function: _Function) -> _Function:
    """As `jit`, but inlined into every caller, whatever its size: chosen by profile."""
    return _declare(function, _INLINED)


def allocating(function: _Function) -> _Function:
    """As `jit`, for functions that make arrays or lists, or call what returns them."""
    return _declare(function, _ALLOCATING)


def compilable(function: _Function) -> _Function:
    """Let compiled code call a plain Python function, which stays one for its other callers."""
    pipeline = {} if PLAIN else {"pipeline_class": Inner}
    return register_jitable(**_OPTIONS, **pipeline)(function)  # type: ignore[no-any-return]


class by_type:  # noqa: N801 - a decorator
    """Decorator: a kernel function with one implementation for each type of its first argument.

    The types are NamedTuples. The choice is made at compile time; functions passed as arguments could not be
    cached. Called from Python it is a look-up, which raises TypeError for a type without an implementation.
    """

    def __init__(self, declaration: Callable[..., Any]) -> None:
        functools.update_wrapper(self, declaration)
        self._implementations: dict[type, Callable[..., Any]] = {}
        self._otherwise: Callable[..., Any] | None = None
        infer_global(self, types.Function(self._template()))

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

    def _template(self) -> type:
        """numba's side of the call, which it types and lowers as one of the implementation."""
        chosen = self._chosen

        class Template(AbstractTemplate):
            key = self

            def generic(self, args: Any, kws: Any) -> Any:
                function = chosen(getattr(args[0], "instance_class", type(None)))
                if function is None:
                    return None
                dispatcher = types.Dispatcher(function)
                signature = dispatcher.get_call_type(self.context, args, kws)
                self._implementation = dispatcher.get_impl_key(signature)
                return signature

            def get_impl_key(self, sig: Any) -> Any:
                return self._implementation

        return Template

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
