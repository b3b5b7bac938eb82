"""How kernel functions are declared, and how one is chosen by the type of its first argument.

A function is compiled into its callers (`kernel.numerics.compilation`), and on its own when Python calls it.
If numba's internals have changed, or with BOUNCE_PLAIN_NJIT=1, `numba.njit` compiles the kernel: to the same
numbers, more slowly, and again in each process. Every function also runs without compilation
(NUMBA_DISABLE_JIT=1), for coverage and debugging.
"""

import functools
import importlib
import logging
import os
from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

import numba
from numba.extending import overload, register_jitable

log = logging.getLogger(__name__)

_Function = TypeVar("_Function", bound=Callable[..., Any])

#: Set by users, and by a process for those that it starts.
_VARIABLE: Final = "BOUNCE_PLAIN_NJIT"


def _own_compiler() -> Any:
    """`kernel.numerics.compilation`; None where `numba.njit` compiles."""
    if os.environ.get(_VARIABLE):
        return None
    try:
        return importlib.import_module("kernel.numerics.compilation")
    except (ImportError, AttributeError, TypeError) as error:
        os.environ[_VARIABLE] = "1"  # so that the processes that this one starts do not warn again
        log.warning(
            "numba %s differs from what the kernel was tried with (%s): every process now compiles its "
            "kernels anew, for a minute or two; results are the same",
            numba.__version__, str(error).partition(" (")[0],
        )  # fmt: skip
        return None


_compiler: Final = _own_compiler()
PLAIN: Final = _compiler is None

# No "contract": which products are fused with sums would depend on how LLVM inlines: see `elementary.fma`.
# Every option is stated: numba hands "forceinline" and "_nrt" down from the function that it is compiling.
# "_nrt": without numba's runtime no array is counted up and down as it passes through a function, which was
# a tenth to a fifth of the time in lanes.
_PUBLIC: Final[Any] = {"nogil": True, "error_model": "numpy", "forceinline": False}
_ALLOCATING: Final[Any] = _PUBLIC if PLAIN else {**_PUBLIC, "_nrt": True}
_OPTIONS: Final[Any] = _PUBLIC if PLAIN else {**_PUBLIC, "_nrt": False}
_INLINED: Final[Any] = {**_OPTIONS, "forceinline": True}

#: Further arguments of numba's `overload` and `register_jitable`.
PIPELINE: Final[Any] = {} if PLAIN else {"pipeline_class": _compiler.Inner}


def _declare(function: _Function, options: dict[str, Any]) -> _Function:
    if PLAIN or numba.config.DISABLE_JIT:
        return cast(_Function, numba.njit(**options)(function))
    return cast(_Function, _compiler.declare(function, options))


def jit(function: _Function) -> _Function:
    """Compile without the GIL and without exceptions, IEEE arithmetic as written.

    The function must not make arrays or lists, nor call what returns them.
    """
    return _declare(function, _OPTIONS)


def is_compiled(function: Any, *arguments: Any) -> bool:
    """Whether a call with such arguments compiles nothing; True where that is unknown."""
    return not hasattr(function, "entry") or bool(function.entry.is_compiled(*arguments))


def inlined(function: _Function) -> _Function:
    """As `jit`, but inlined into every caller, whatever its size: chosen by profile."""
    return _declare(function, _INLINED)


def outlined(function: _Function) -> _Function:
    """As `jit`, but never inlined: chosen for what runs rarely, so that its caller compiles faster."""
    if not PLAIN:
        _compiler.OUTLINED.add(function)
    return _declare(function, _OPTIONS)


def allocating(function: _Function) -> _Function:
    """As `jit`, for functions that make arrays or lists, or call what returns them."""
    return _declare(function, _ALLOCATING)


def compilable(function: _Function) -> _Function:
    """Let compiled code call a plain Python function, which stays one for its other callers."""
    return register_jitable(**_OPTIONS, **PIPELINE)(function)  # type: ignore[no-any-return]


def by_type(declaration: Callable[..., Any]) -> Any:
    """Decorator: a kernel function with one implementation for each type of its first argument.

    The types are NamedTuples; `register(object)` is for all others. The choice is made at compile time;
    functions passed as arguments could not be cached. Called from Python it is a look-up, which raises
    TypeError for a type without an implementation.
    """

    @functools.singledispatch
    @functools.wraps(declaration)
    def chosen(first: Any, *rest: Any) -> Any:
        raise TypeError(f"not implemented for {type(first).__name__}")

    missing = chosen.dispatch(object)

    def implementation(first: Any, *rest: Any) -> Any:
        """The implementation for numba's type of the first argument, or None."""
        function = chosen.dispatch(getattr(first, "instance_class", object))
        return None if function is missing else function

    if PLAIN:  # `overload` takes Python functions

        @overload(chosen, _OPTIONS, strict=False)
        def python_of_chosen(first: Any, *rest: Any) -> Callable[..., Any] | None:
            return getattr(implementation(first, *rest), "py_func", None)

    else:
        _compiler.declare_choice(chosen, implementation)
    return chosen
