"""How numba compiles the kernel: inner functions are typed once, each entry is optimised once.

numba optimises and emits every function by itself, and again in each of its callers. Here an *inner* function
is only typed and lowered. An *entry*, a function that Python calls, links all that it calls, directly or not,
and is optimised and emitted once. A kernel of a hundred functions compiles in a third of the time.

A cache (`cache.folder`) keeps two files for each entry and signature: the linked code before optimisation,
which is the same on all processors, and the machine code of one processor. A file appears whole or not at
all, so any number of processes share a folder; of several that need the same entry one compiles it.

Only this module uses numba's internals; `kernel.numerics.jit` imports it if it can, and
`tests/unit/kernel/numerics/test_compilation.py` fails when numba changes them.
"""

import fcntl
import functools
import gc
import hashlib
import logging
import os
import pickle
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from types import CodeType
from typing import IO, Any, Final

from numba import types
from numba.core import typed_passes as typed
from numba.core import untyped_passes as untyped
from numba.core.codegen import CodeLibrary, JITCodeLibrary
from numba.core.codegen import ll as llvm
from numba.core.compiler import CompilerBase, CompileResult, Flags
from numba.core.compiler_machinery import PassManager
from numba.core.environment import lookup_environment
from numba.core.registry import CPUDispatcher
from numba.core.serialize import dumps
from numba.core.typing.templates import AbstractTemplate, infer_global

from kernel.numerics import cache
from kernel.numerics.cache import compiling

log = logging.getLogger(__name__)

#: numba's passes that kernels need, in its order. The others are for `with`, `literal_unroll` or functions
#: inlined as Python, which kernels do not have.
_PASSES: Final = (
    untyped.TranslateByteCode,
    untyped.FixupArgs,
    untyped.InlineClosureLikes,
    untyped.RewriteSemanticConstants,
    untyped.DeadBranchPrune,
    untyped.GenericRewrites,
    untyped.ReconstructSSA,
    typed.NopythonTypeInference,
    typed.PreLowerStripPhis,
    typed.IRLegalization,
    typed.NativeLowering,
    typed.NoPythonBackend,
)

#: The modules of operators and functions whose calls' types are remembered, and the types of their arguments.
_BUILT_IN: Final = frozenset({"_operator", "builtins", "math", "kernel.numerics.elementary"})
_VALUES: Final = (
    types.Float, types.Complex, types.Integer, types.IntegerLiteral, types.Boolean, types.BooleanLiteral,
    types.Array, types.Omitted,
)  # fmt: skip

#: Functions that are not inlined into their callers.
OUTLINED: Final[set[Callable[..., Any]]] = set()

#: Objects of earlier compilations that are worth a collection, which takes as long as a small function.
_MANY: Final = 300_000

#: Seconds that a process waits for another one that compiles the same, and seconds between two looks.
WAIT_SECONDS: Final = 120.0
LOOK_SECONDS: Final = 0.05

#: LLVM's levels of optimisation, one after the other: 2 before 2, or 3, makes kernels no faster.
_SPEED_LEVELS: Final = (1, 2)


#: The objects that the last collection left.
_left: list[int] = [0]


@contextmanager
def _collecting_later() -> Iterator[None]:
    """Keep the objects that a compiler makes, up to a million, until a later one collects them."""
    collects = gc.isenabled()
    if gc.get_freeze_count() > _left[0] + _MANY:
        gc.unfreeze()
        gc.collect()
        gc.freeze()
        _left[0] = gc.get_freeze_count()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.freeze()
            gc.enable()


class _InnerLibrary(JITCodeLibrary):
    """The code of one inner function, as lowered, and the libraries that it calls."""

    outlined: bool = False

    def add_linking_library(self, library: CodeLibrary) -> None:
        """Note a library, which stays as it is."""
        self._linking_libraries.append(library)

    def add_ir_module(self, ir_module: Any) -> None:
        if self.outlined:
            for function in ir_module.functions:
                if not function.is_declaration:
                    function.attributes.add("noinline")
        super().add_ir_module(ir_module)

    def _optimize_functions(self, ll_module: Any) -> None:
        """Leave it to the entry."""
        ll_module.data_layout = self._codegen._data_layout


class _EntryLibrary(_InnerLibrary):
    """The code of an entry with that of all that it calls."""

    #: The linked code before optimisation.
    bitcode: bytes = b""

    def finalize(self) -> None:
        """Link, optimise and emit."""
        for library in _called(self):
            self._reload_init.update(library._reload_init)
            module = library._get_module_for_linking() if library._finalized else _linkable(library)
            self._final_module.link_in(module, preserve=True)
        self._linking_libraries: list[CodeLibrary] = []
        for function in self._final_module.functions:
            if not function.is_declaration and function.linkage.name == "linkonce_odr":
                function.linkage = "internal"  # LLVM inlines functions called once, and drops unused ones
        self.bitcode = self._final_module.as_bitcode()
        super().finalize()

    def _optimize_final_module(self) -> None:
        """Optimise twice: code inlined in the first round is simple enough for vectors in the second."""
        module, codegen = self._final_module, self._codegen
        _shorten(module, codegen._tm)
        cheap, builder = codegen._module_pass_manager(
            loop_vectorize=False, slp_vectorize=False, opt=0, cost="cheap"
        )
        cheap.run(module, builder)
        for level in _SPEED_LEVELS:
            options = llvm.create_pipeline_tuning_options(speed_level=level)
            options.loop_vectorization = True
            builder = llvm.create_pass_builder(codegen._tm, options)
            builder.getModulePassManager().run(module, builder)

    def get_pointer_to_function(self, name: str) -> int:
        """The address of the entry; numba would look it up in a module that loaded machine code lacks."""
        self._ensure_finalized()
        address: int = self._codegen._engine.get_function_address(name)
        return address

    @classmethod
    def loaded(cls, codegen: Any, name: str, code: bytes, *, emitted: bool) -> "_EntryLibrary":
        """The library of machine code, or of linked code, which is optimised and emitted."""
        library = cls(codegen, name)
        library.enable_object_caching()
        if emitted:
            library._set_compiled_object(code)
        else:
            library._final_module = llvm.parse_bitcode(code)
            library._optimize_final_module()
        library._finalize_final_module()
        return library


def _shorten(module: Any, machine: Any) -> None:
    """Simplify each function, to a fifth of its length as lowered, before others have copies of it."""
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=1))
    passes = llvm.create_new_function_pass_manager()
    passes.add_sroa_pass()
    passes.add_simplify_cfg_pass()
    passes.add_instruction_combine_pass()
    for function in module.functions:
        if not function.is_declaration:
            passes.run(function, builder)


def _called(library: CodeLibrary) -> list[CodeLibrary]:
    """The libraries that `library` calls, directly or through others that are not finalised, once each."""
    seen: dict[CodeLibrary, None] = {}
    waiting = [library]
    while waiting:
        for called in waiting.pop()._linking_libraries:
            if called not in seen:
                seen[called] = None
                if not called._finalized:
                    waiting.append(called)
    return list(seen)


def _linkable(library: CodeLibrary) -> Any:
    """A copy of a library's code whose functions may be inlined and dropped."""
    module = library._final_module.clone()
    for function in module.functions:
        if not function.is_declaration and function.linkage.name == "external":
            function.linkage = "linkonce_odr"
    return module


class _Flags(Flags):
    """numba's flags, compared faster: it does so 200 times for each function."""

    __slots__ = ()

    def __hash__(self) -> int:
        return hash((len(self._values), self._values.get("forceinline"), self._values.get("nrt")))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Flags) and self._values == other._values


class _Typing:
    """numba's typing context, in which operators remember the types of their calls."""

    def __init__(self, context: Any) -> None:
        self._context = context

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)

    def resolve_function_type(self, function: Any, args: tuple[Any, ...], kws: dict[str, Any]) -> Any:
        module = getattr(getattr(function, "typing_key", None), "__module__", None)
        if module in _BUILT_IN and "get_call_type" not in vars(function):
            function.get_call_type = _remembering(function.get_call_type)
        return self._context.resolve_function_type(function, args, kws)


def _remembering(resolve: Callable[..., Any]) -> Callable[..., Any]:
    """The `get_call_type` of an operator, which asks `resolve` once: that tries dozens of rules."""
    known: dict[tuple[Any, ...], Any] = {}

    def get_call_type(context: Any, args: tuple[Any, ...], kws: dict[str, Any]) -> Any:
        if kws or not all(type(arg) in _VALUES for arg in args):
            return resolve(context, args, kws)
        if args not in known:
            known[args] = resolve(context, args, kws)
        return known[args]

    return get_call_type


class _Passes(PassManager):
    """numba's passes one after the other, without the checks and tables that it makes after each.

    Left out where it does nothing: inlining closures. Where references are not counted: marking where each
    variable ends.
    """

    def _runPass(self, index: int, each: Any, state: Any) -> None:  # noqa: N802 - numba's name
        needed = True
        if isinstance(each, untyped.InlineClosureLikes):
            needed = any(isinstance(constant, CodeType) for constant in state.func_id.code.co_consts)
        elif isinstance(each, typed.IRLegalization):
            needed = state.flags.nrt
        if needed:
            each.analysis = self._analysis
            each.run_pass(state)


class _Compiler(CompilerBase):
    """numba's compiler with the passes above."""

    def __init__(
        self, typing: Any, target: Any, library: Any, args: Any, returned: Any, flags: Any, locals: Any
    ) -> None:
        super().__init__(_Typing(typing), target, library, args, returned, _Flags(flags), locals)

    def define_pipelines(self) -> list[PassManager]:
        passes = _Passes("kernel")
        for needed in _PASSES:
            passes.add_pass(needed, needed.__name__)
        passes.finalize()
        return [passes]


class Inner(_Compiler):
    """Types and lowers a function for its callers."""

    def compile_extra(self, func: Any) -> Any:
        """The result, whose entry point is only a key by which callers find it."""
        state = self.state
        state.flags.no_compile = state.flags.no_cpython_wrapper = state.flags.no_cfunc_wrapper = True
        state.library = _InnerLibrary(state.targetctx.codegen(), func.__qualname__)
        state.library.outlined = func in OUTLINED
        result = super().compile_extra(func)
        key: Any = [].append  # numba takes built-in functions only, and this is a new one
        state.targetctx.insert_user_function(key, result.fndesc, [result.library])
        return result._replace(entry_point=key)


class _EntryCompiler(_Compiler):
    """Compiles a function for Python with all that it calls."""

    def compile_extra(self, func: Any) -> Any:
        state = self.state
        state.flags.no_cfunc_wrapper = True
        state.library = library = _EntryLibrary(state.targetctx.codegen(), func.__qualname__)
        library.enable_object_caching()
        with _collecting_later():
            result = super().compile_extra(func)
        for environment in _environments(library):
            library.codegen.set_env(environment.env_name, environment)
        return result


def _environments(library: Any) -> list[Any]:
    """numba's environments of an entry: Python objects that its code refers to."""
    variables = library._final_module.global_variables
    environments = (lookup_environment(variable.name) for variable in variables)
    return [each for each in environments if each is not None and each.can_cache()]


class Entry(CPUDispatcher):
    """A function for Python: compiled with all that it calls, or read from the cache."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        super().__init__(function, targetoptions={"nopython": True, **options}, pipeline_class=_EntryCompiler)
        self._cache = _EntryCache(function)

    def compile(self, sig: Any) -> Any:
        """Compile the function for arguments of these types, or load it, unless that is done."""
        arguments = tuple(sig.args) if hasattr(sig, "args") else tuple(sig)
        if arguments in self.overloads:
            return super().compile(sig)
        with compiling(self._cache.described(arguments)), self._cache.locked(arguments):
            return super().compile(sig)

    def is_compiled(self, *arguments: Any) -> bool:
        """Whether a call compiles nothing: this process or the cache has the function for such arguments."""
        types = tuple(map(self.typeof_pyval, arguments))
        return types in self.overloads or self._cache.has(types, self.targetctx.codegen())


class Kernel(CPUDispatcher):
    """A function that is compiled into its callers; for Python it is compiled as an entry of its own."""

    @functools.cached_property
    def entry(self) -> Any:
        """The function for Python."""
        return Entry(self.py_func, {**self.targetoptions, "forceinline": False, "_nrt": True})

    def __call__(self, *args: Any) -> Any:
        return self.entry(*args)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """As numba does, but one template for all constant integers."""
        plain = (types.unliteral(arg) if isinstance(arg, types.IntegerLiteral) else arg for arg in args)
        return super().get_call_template(tuple(plain), kws)


def declare(function: Callable[..., Any], options: dict[str, Any]) -> Kernel:
    """A kernel function."""
    return Kernel(function, targetoptions={"nopython": True, **options}, pipeline_class=Inner)


def declare_choice(called: Callable[..., Any], choose: Callable[[Any], Any]) -> None:
    """Let compiled code that calls `called` call the kernel function `choose(type of its first argument)`."""

    class Template(AbstractTemplate):
        key = called

        def generic(self, args: Any, kws: Any) -> Any:
            function = choose(args[0])
            if function is None:
                return None
            dispatcher = types.Dispatcher(function)
            signature = dispatcher.get_call_type(self.context, args, kws)
            self._implementation = dispatcher.get_impl_key(signature)
            return signature

        def get_impl_key(self, sig: Any) -> Any:
            return self._implementation

    infer_global(called, types.Function(Template))


class _EntryCache:
    """The cached signatures of an entry, as numba's dispatchers use a cache."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._name = f"{function.__module__}.{function.__qualname__}"
        self._short = function.__name__.strip("_")

    def described(self, arguments: tuple[Any, ...]) -> str:
        """The contact model that its first argument belongs to, or else the function."""
        return f"{_module(arguments).rpartition('.')[2] or self._short} kernel"

    def has(self, arguments: tuple[Any, ...], codegen: Any) -> bool:
        """Whether there is machine code for arguments of these types."""
        path = self._path(arguments)
        return path is not None and _machine_code(path, codegen).exists()

    def load_overload(self, sig: Any, target: Any) -> Any:
        target.refresh()
        codegen = target.codegen()
        if (path := self._path(sig)) is None:
            return None
        machine_code = _machine_code(path, codegen)
        for file in (machine_code, path):
            if (saved := _load(file)) is not None:
                code, facts = saved
                library = _EntryLibrary.loaded(codegen, self._name, code, emitted=file == machine_code)
                result = _rebuilt(target, library, facts)
                if file == path:
                    _save(machine_code, (library._get_compiled_object(), facts))
                return result
        return None

    def save_overload(self, sig: Any, result: CompileResult) -> None:
        if (path := self._path(sig)) is None:
            return
        library, described = result.library, result.fndesc
        described.typemap = described.calltypes = None  # cannot be pickled, and is not needed any more
        facts = (described, result.environment, result.signature, result.reload_init, _environments(library))
        _save(path, (library.bitcode, facts))
        _save(_machine_code(path, result.codegen), (library._get_compiled_object(), facts))

    @contextmanager
    def locked(self, arguments: tuple[Any, ...]) -> Iterator[None]:
        """One process at a time compiles a signature; others wait, and find it in the cache.

        One that waits longer than WAIT_SECONDS compiles it too: the other process may be suspended.
        """
        path = self._path(arguments)
        with ExitStack() as stack:
            with suppress(OSError):  # a disk that is read-only, or without locks: compiled more than once
                if path is not None:
                    lock = stack.enter_context(Path(f"{path}.lock").open("a"))
                    _lock(lock, time.monotonic() + WAIT_SECONDS)
            yield

    def _path(self, sig: Any) -> Path | None:
        """The file of a signature before optimisation; None without a cache, and for models of others."""
        arguments = tuple(sig.args) if hasattr(sig, "args") else tuple(sig)
        module, folder = _module(arguments), cache.folder
        if folder is None or not (module or "kernel.").startswith("kernel."):
            return None
        identity = hashlib.sha256(f"{self._name} {module} {arguments}".encode()).hexdigest()[:12]
        return folder / f"{self.described(arguments).replace(' ', '-')}-{identity}"


def _lock(file: IO[str], deadline: float) -> None:
    """Lock a file, unless another process has it until the deadline. Raises OSError."""
    while time.monotonic() < deadline:
        with suppress(BlockingIOError):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return
        time.sleep(LOOK_SECONDS)
    log.warning("%s: the process that compiles this may be suspended, so another compiles it too", file.name)


def _module(arguments: tuple[Any, ...]) -> str:
    """The module of the first argument's class; "" if that is not a NamedTuple."""
    return getattr(getattr(next(iter(arguments), None), "instance_class", None), "__module__", "")


def _machine_code(path: Path, codegen: Any) -> Path:
    """The file of the machine code for this processor, beside that of the code before optimisation."""
    processor = hashlib.sha256(repr(codegen.magic_tuple()).encode()).hexdigest()[:8]
    return path.with_name(f"{path.name}.{processor}")


def _rebuilt(target: Any, library: _EntryLibrary, facts: Any) -> CompileResult:
    """numba's result of a compilation, from an emitted library."""
    described, environment, signature, reload_init, environments = facts
    for function in reload_init:
        function()
    entry_point = target.get_executable(library, described, environment)
    for referenced in environments:
        library.codegen.set_env(referenced.env_name, referenced)
    return CompileResult(
        typing_context=target.typing_context, target_context=target, entry_point=entry_point,
        typing_error=None, type_annotation="", signature=signature, objectmode=False, lifted=(),
        fndesc=described, library=library, call_helper=None, environment=environment, metadata=None,
        reload_init=reload_init, referenced_envs=environments,
    )  # fmt: skip


def _load(path: Path) -> Any:
    """The content of `_save`; None if the file is missing or damaged."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    return pickle.loads(content[32:]) if hashlib.sha256(content[32:]).digest() == content[:32] else None


def _save(path: Path, content: Any) -> None:
    """Write a file completely or not at all; without it the next process compiles again."""
    draft = path.with_name(f"{path.name}.{os.getpid()}-{threading.get_ident()}")
    try:
        pickled = dumps(content)
        draft.write_bytes(hashlib.sha256(pickled).digest() + pickled)
        draft.replace(path)
    except OSError:
        with suppress(OSError):
            draft.unlink()
