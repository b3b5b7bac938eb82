"""How the kernel is compiled: entries once, inner functions into them, the cache shared by processes.

These tests fail where numba has changed what `kernel.numerics.compilation` rests on.
"""

import fcntl
import threading
from pathlib import Path
from typing import Any

import pytest

from kernel.numerics import cache, compilation
from kernel.numerics.cache import USUAL, compilations, compiling
from kernel.numerics.compilation import Entry
from kernel.numerics.jit import inlined, jit


@inlined
def doubled(x: float) -> float:
    return x + x


@jit
def quadrupled(x: float) -> float:
    return doubled(doubled(x))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A cache of its own for the functions above, which count as the kernel's."""
    monkeypatch.setattr(cache, "folder", tmp_path)
    return tmp_path


def entry(function: Any) -> Entry:
    """A new entry of a kernel function, as another process would have it."""
    return Entry(function.py_func, {"nogil": True, "error_model": "numpy"})


def codes(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.suffix != ".lock")


def test_an_entry_is_read_from_the_cache_by_the_next_process(folder, monkeypatch):
    assert not entry(quadrupled).is_compiled(2.0)
    entry(quadrupled)(2.0)
    monkeypatch.setattr(compilation._EntryCompiler, "compile_extra", None)  # would raise
    assert entry(quadrupled).is_compiled(2.5)
    assert not entry(quadrupled).is_compiled(2)
    assert entry(quadrupled)(2.5) == 10.0


def test_on_another_processor_only_machine_code_is_made_anew(folder, monkeypatch):
    entry(quadrupled)(2.0)
    before, after = codes(folder)
    (folder / after).rename(folder / f"{before}.another")
    monkeypatch.setattr(compilation._EntryCompiler, "compile_extra", None)
    assert entry(quadrupled)(2.5) == 10.0
    assert codes(folder) == sorted([before, after, f"{before}.another"])


@pytest.mark.parametrize("damage", [lambda code: code[:-100], lambda code: b"", lambda code: b"?" * 500])
def test_a_damaged_file_is_compiled_again(folder, damage):
    entry(quadrupled)(2.0)
    whole = {name: (folder / name).read_bytes() for name in codes(folder)}
    for name, content in whole.items():
        (folder / name).write_bytes(damage(content))
    assert entry(quadrupled)(2.5) == 10.0
    assert all((folder / name).stat().st_size > 500 for name in whole)


def test_threads_that_need_the_same_entry_compile_it_once(folder, monkeypatch):
    compiled, shared = [], entry(quadrupled)
    compile_extra = compilation._EntryCompiler.compile_extra

    def counted(self: Any, function: Any) -> Any:
        compiled.append(function)
        return compile_extra(self, function)

    monkeypatch.setattr(compilation._EntryCompiler, "compile_extra", counted)
    threads = [threading.Thread(target=shared, args=[2.0]) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(compiled) == 1


def test_a_process_that_is_suspended_while_it_compiles_keeps_no_other_from_it(folder, monkeypatch):
    monkeypatch.setattr(compilation, "WAIT_SECONDS", 0.1)
    entry(quadrupled)(2.0)
    [lock] = folder.glob("*.lock")
    for name in codes(folder):
        (folder / name).unlink()
    with lock.open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert entry(quadrupled)(2.0) == 8.0
    assert len(codes(folder)) == 2


def test_a_compilation_tells_how_long_it_took_the_last_time(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(cache, "_took", {})

    def usual() -> float:
        with compiling("soft kernel"):
            return compilations()[-1].usual

    assert [usual(), usual()] == [USUAL["soft kernel"]] * 2  # from the cache, at once
    monkeypatch.setattr(cache, "LOADED", 0.0)
    usual()
    assert 0.0 < usual() < 1.0
