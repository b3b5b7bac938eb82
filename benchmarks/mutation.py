"""Whether the tests notice: random changes to `service/` and `worker/`, each tried on the tests that run it.

    python -m benchmarks.mutation --count 200 --seed 1 --keep FOLDER

A change is one of: another comparison, a condition negated, another sign or operator, `return None`, a call
left out, another constant. It is made in a copy of the project, and up to 40 of the tests that run the
changed line are run: those first that run few lines and take little time, or most of the changed file. A
change is noticed if one of them fails that passes without it, or if they do not end.

Which tests run which line is measured first, test file by test file. Tests whose work is done in other
processes (a browser, a service of its own, the documents) do not take part; `--tests` names others. Only
lines that some test runs are changed; how many others there are is printed. What only somebody who looks at a
picture or reads a text can judge is not changed: colours, sizes, fonts, texts, the log.

FOLDER keeps the copy, what is measured, and the results. Called again, the program goes on where it was: the
copy keeps its sources, so that a sample stays the same; test files that changed are copied and measured anew.
`--again` tries the changes of this sample again that were not noticed; with `--further 300` it runs other
tests of the line, too, five minutes of them at most. `--minutes` ends after so long.
"""

import argparse
import ast
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter, defaultdict
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import suppress
from importlib.util import cache_from_source
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from benchmarks.tables import table

ROOT = Path(__file__).parents[1]
PACKAGES = ("service", "worker")
#: Tests of one change at most.
MOST_TESTS = 40
#: Seconds that the first tests of a change may take, as measured; the others follow if these notice nothing.
FIRST_SECONDS = 8.0
#: A test that takes longer is not run for a change.
LONGEST = 60.0
#: What the processes of a cluster take to start.
CLUSTER_SECONDS = 6.0
#: Times what its tests took unchanged, and seconds beside, after which a change counts as noticed: it hangs.
SLACK, PATIENCE = 8.0, 60.0

#: Test files that take part.
TEST_FILES = (
    "unit/service/test_*.py", "unit/worker/test_*.py", "system/service/test_*.py", "system/worker/test_*.py",
    "system/faults/test_damage.py",
)  # fmt: skip
#: Of these, the ones that do their work in other processes, or that take long and run everything.
ELSEWHERE = (
    "system/service/test_fuzz.py", "system/service/test_import_light.py", "system/worker/test_executors.py",
    "system/worker/test_kernel_cache.py", "system/worker/test_s3.py",
)  # fmt: skip

#: Loaded once, for all runs of tests.
LIBRARIES = (
    *(
        "pytest",
        "hypothesis",
        "coverage",
        "scipy",
        "matplotlib.pyplot",
        "xarray",
        "zarr",
        "fastapi.testclient",
    ),
    *("distributed", "pyarrow.parquet", "h5netcdf", "uvicorn", "httpx2", "rich", "click.testing"),
)

#: Modules and keyword arguments of pictures that say how something looks, not what is drawn.
LOOKS = {"service/render/style.py"}
LOOK_KEYWORDS = {
    *(
        "alpha",
        "color",
        "colors",
        "dpi",
        "fontfamily",
        "fontsize",
        "handletextpad",
        "labelcolor",
        "labelsize",
    ),
    *("length", "linewidth", "loc", "markeredgewidth", "markersize", "markerscale", "math_fontfamily", "pad"),
    *(
        "prop",
        "rasterized",
        "textcoords",
        "verticalalignment",
        "zorder",
        "bbox",
        "ha",
        "va",
        "frameon",
        "direction",
    ),
}
LOOK_CALLS = {"tick_params", "set_axis_off", "set_zorder", "set_math_fontfamily", "set_minor_locator"}

COMPARISONS: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
}  # fmt: skip


class Change(NamedTuple):
    """One possible change: the nth one of its kind that `changes` finds in a file."""

    file: str
    number: int
    line: int
    kind: str
    text: str  # what is there, and what takes its place


# Changes


def changes(file: str, tree: ast.Module) -> Iterator[tuple[Change, Callable[[], None]]]:
    """Every change of a file, with the function that makes it in the tree."""
    number = 0
    for node in _walk(tree):
        for kind, after, make in _changes_of(node):
            before = ast.unparse(node)
            yield Change(file, number, node.lineno, kind, f"{_short(before)}  →  {_short(after)}"), make
            number += 1


def _walk(node: ast.AST, *, in_function: bool = False) -> Iterator[Any]:
    """The expressions and statements inside functions that can be changed, without types, texts and looks."""
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        for statement in node.body:
            if not _is_look(statement):
                yield from _walk(statement, in_function=True)
        return
    if in_function and hasattr(node, "lineno"):
        yield node
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and name != "annotation" and not _is_look(child):
                yield from _walk(child, in_function=in_function)


def _is_look(node: ast.AST) -> bool:
    if isinstance(node, ast.keyword):
        return node.arg in LOOK_KEYWORDS or node.arg == "strict"  # of zip: an assertion
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        return _called(node.value) in LOOK_CALLS or _logs(node.value)
    return isinstance(node, ast.JoinedStr | ast.Raise | ast.Assert) or _type_checking(node)


def _called(call: ast.Call) -> str:
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def _logs(call: ast.Call) -> bool:
    function = call.func
    return isinstance(function, ast.Attribute) and getattr(function.value, "id", "") in (
        "log",
        "_LOG",
        "logger",
    )


def _type_checking(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"


def _changes_of(node: Any) -> Iterator[tuple[str, str, Callable[[], None]]]:
    """Kind, new text, and the function that makes the change, of one node."""
    if isinstance(node, ast.Compare):
        for i, operator in enumerate(node.ops):
            other = COMPARISONS[type(operator)]()
            changed = [*node.ops[:i], other, *node.ops[i + 1 :]]
            yield _setting("comparison", node, "ops", changed)
    elif isinstance(node, ast.BoolOp):
        yield _setting("negation", node, "op", ast.Or() if isinstance(node.op, ast.And) else ast.And())
    elif isinstance(node, ast.If | ast.IfExp | ast.While) and not isinstance(node.test, ast.Constant):
        if not isinstance(node.test, ast.Compare | ast.BoolOp):
            yield _setting("negation", node, "test", ast.UnaryOp(ast.Not(), node.test))
    elif isinstance(node, ast.BinOp) and type(node.op) in OPERATORS and not _is_text(node):
        yield _setting("sign", node, "op", OPERATORS[type(node.op)]())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield _setting("sign", node, "op", ast.UAdd())
    elif isinstance(node, ast.Return) and node.value is not None and not _is_none(node.value):
        yield _setting("return", node, "value", ast.Constant(None))
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call | ast.Await):
        yield _setting("dropped call", node, "value", ast.Constant(None))
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
        value = not node.value if isinstance(node.value, bool) else node.value + 1
        yield _setting("constant", node, "value", value)


def _setting(kind: str, node: Any, name: str, value: Any) -> tuple[str, str, Callable[[], None]]:
    old = getattr(node, name)
    setattr(node, name, value)
    text = ast.unparse(node)
    setattr(node, name, old)
    return kind, text, lambda: setattr(node, name, value)


def _is_text(node: ast.BinOp) -> bool:
    sides = (node.left, node.right)
    return any(
        isinstance(side, ast.JoinedStr) or isinstance(getattr(side, "value", 0), str) for side in sides
    )


def _is_none(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and node.value is None


def _short(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= 70 else line[:67] + "..."


# Running tests


def copied(folder: Path) -> Path:
    """A copy of what git tracks or would track; one that exists keeps its sources, only tests are renewed."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    exists = folder.exists()
    for name in filter(None, listed.split("\0")):
        original, copy = ROOT / name, folder / name
        if not original.is_file() or (exists and not name.startswith(("tests/", "benchmarks/"))):
            continue
        if not copy.exists() or copy.read_bytes() != original.read_bytes():
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(original, copy)
    return folder


def preload(folder: Path) -> None:
    """Import libraries and kernels here, once for all runs of tests; each run imports what may change."""
    os.chdir(folder)
    sys.path[:0] = [str(folder), str(folder / "tests" / "support")]
    os.environ["PYTHONPATH"] = str(folder)  # for the processes that tests start
    for name in [name for name in sys.modules if name.split(".")[0] in (*PACKAGES, "kernel")]:
        del sys.modules[name]
    from worker.kernel_cache import warm

    warm(folder / ".numba-cache")
    for name in [name for name in sys.modules if name.split(".")[0] in PACKAGES]:
        del sys.modules[name]
    for name in LIBRARIES:
        __import__(name)


def in_child(work: Callable[[], int], seconds: float, log: Path) -> int | None:
    """The exit status of `work` in a forked process, whose output goes to `log`; None if it does not end."""
    child = os.fork()
    if child == 0:
        os.setsid()
        with log.open("wb") as output:
            os.dup2(output.fileno(), 1)
            os.dup2(output.fileno(), 2)
            status = 99
            try:
                status = work()
            except BaseException:  # noqa: BLE001 - the process ends here, whatever it is
                traceback.print_exc()
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(status)
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            _end_group(child)
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.05)
    _end_group(child)
    os.waitpid(child, 0)
    return None


def _end_group(leader: int) -> None:
    with suppress(ProcessLookupError):
        os.killpg(leader, signal.SIGKILL)


def run_pytest(arguments: Sequence[str], plugins: Sequence[object] = ()) -> int:
    common = ["-q", "-n", "0", "-p", "no:cacheprovider", "--no-header", "--tb=short"]
    preloaded = ["-W", "ignore:Module already imported"]  # plugins among the libraries
    return int(pytest.main([*common, *preloaded, *arguments], plugins=list(plugins)))


class Recorder:
    """A pytest plugin: which lines each test runs, how long it takes, and whether it passes.

    The lines of a fixture that several tests share count for each test of the file that uses it.
    """

    def __init__(self, folder: Path) -> None:
        import coverage

        self.coverage = coverage.Coverage(
            data_file=None, config_file=False, source=[str(folder / name) for name in PACKAGES]
        )
        self.seconds: dict[str, float] = {}
        self.failed: set[str] = set()
        self.users: dict[str, list[str]] = defaultdict(list)  # of fixtures, by name
        self.test = ""
        self.coverage.start()

    def pytest_collection_finish(self, session: Any) -> None:
        for item in session.items:
            for name in item.fixturenames:
                self.users[f"fixture {name}"].append(item.nodeid)
            self.seconds[item.nodeid] = CLUSTER_SECONDS if "cluster" in item.fixturenames else 0.0

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.test = nodeid
        self.coverage.switch_context(nodeid)

    def pytest_runtest_logfinish(self) -> None:
        self.coverage.switch_context("")

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Generator[None, Any, Any]:
        if fixturedef.scope != "function":
            self.coverage.switch_context(f"fixture {fixturedef.argname}")
        try:
            return (yield)
        finally:
            self.coverage.switch_context(self.test)

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.seconds[report.nodeid] += report.duration
        if not report.passed:
            self.failed.add(report.nodeid)

    def write(self, folder: Path, target: Path, digest: str) -> None:
        self.coverage.stop()
        data = self.coverage.get_data()
        lines = {
            str(Path(file).relative_to(folder)): {
                line: sorted({test for name in contexts if name for test in self.users.get(name, [name])})
                for line, contexts in data.contexts_by_lineno(file).items()
            }
            for file in data.measured_files()
        }
        content = {"digest": digest, "lines": lines, "seconds": self.seconds, "failed": sorted(self.failed)}
        target.write_text(json.dumps(content))


def record(folder: Path, test_file: str, target: Path, seconds: float) -> None:
    """Measure a test file, unless that was done with the same text."""
    digest = hashlib.sha256((folder / test_file).read_bytes()).hexdigest()
    if target.exists() and json.loads(target.read_text())["digest"] == digest:
        return

    def work() -> int:
        recorder = Recorder(folder)
        status = run_pytest([test_file], [recorder])
        recorder.write(folder, target, digest)
        return status

    start = time.monotonic()
    status = in_child(work, seconds, target.with_suffix(".log"))
    how = "did not end" if status is None else f"status {status}"
    print(f"measured {test_file}: {how}, {time.monotonic() - start:.0f} s", flush=True)
    if status is None:
        target.write_text(json.dumps({"digest": digest, "lines": {}, "seconds": {}, "failed": []}))


class Coverage(NamedTuple):
    """The passing tests that run each line of each file, and the seconds that each test takes."""

    tests: dict[tuple[str, int], set[str]]
    seconds: dict[str, float]
    breadth: Counter[str]  # lines that each test runs

    def nearest(self, change: Change, further_seconds: float) -> list[str]:
        """Tests that run the changed line: those that run few lines and take little time, and, in turn with
        them, those that run most of the changed file. Threads of a service run lines in every test beside it.

        MOST_TESTS of them, and then as many as take `further_seconds`.
        """
        tests = self.tests[change.file, change.line]
        short = [name for name in tests if self.seconds.get(name, 0.0) <= LONGEST] or list(tests)
        cost = {name: self.breadth[name] * (1.0 + self.seconds.get(name, 0.0)) for name in short}
        depth: Counter[str] = Counter()
        for (file, _), names in self.tests.items():
            if file == change.file:
                depth.update(names)
        narrow = sorted(short, key=lambda name: cost[name])
        deep = sorted(short, key=lambda name: (-depth[name], cost[name]))
        both = list(dict.fromkeys(name for pair in zip(narrow, deep, strict=True) for name in pair))
        spent = np.cumsum([self.seconds.get(name, 0.0) for name in both[MOST_TESTS:]])
        return both[: MOST_TESTS + np.searchsorted(spent, further_seconds)]

    def stages(self, tests: Sequence[str]) -> list[list[str]]:
        """The first tests, which together take little time, and the others."""
        spent, first = 0.0, 0
        for name in tests:
            spent += self.seconds.get(name, 0.0)
            if spent > FIRST_SECONDS:
                break
            first += 1
        return [stage for stage in (list(tests[:first]), list(tests[first:])) if stage]


def coverage_in(folder: Path) -> Coverage:
    tests: dict[tuple[str, int], set[str]] = defaultdict(set)
    seconds: dict[str, float] = {}
    breadth: Counter[str] = Counter()
    for kept in sorted(folder.glob("*.json")):
        content = json.loads(kept.read_text())
        failed = set(content["failed"])
        seconds |= content["seconds"]
        for file, lines in content["lines"].items():
            for line, names in lines.items():
                passing = [name for name in names if name not in failed]
                tests[file, int(line)].update(passing)
                breadth.update(passing)
    return Coverage(tests, seconds, breadth)


class Trials:
    """Tries changes in the copy, with what is measured, and remembers which tests pass without a change."""

    def __init__(self, folder: Path, keep: Path, further_seconds: float) -> None:
        self.folder, self.keep, self.further_seconds = folder, keep, further_seconds
        self.measured = coverage_in(keep / "lines")
        self._fails_unchanged: dict[str, bool] = {}

    def noticed(self, change: Change) -> str | None:
        """The test that fails after the change, or "does not end"; None if all pass."""
        tests = self.measured.nearest(change, self.further_seconds)
        while True:
            result = self._try(change, tests)
            if result not in tests or not self._fails(result):
                return result
            tests.remove(result)

    def _fails(self, test: str) -> bool:
        """Whether a test fails without any change, run by itself."""
        if test not in self._fails_unchanged:
            self._fails_unchanged[test] = self._run([test]) != 0
        return self._fails_unchanged[test]

    def _run(self, tests: Sequence[str]) -> int | None:
        seconds = PATIENCE + SLACK * sum(self.measured.seconds.get(name, 0.0) for name in tests)
        return in_child(lambda: run_pytest(["-x", *tests]), seconds, self.keep / "last.log")

    def _try(self, change: Change, tests: Sequence[str]) -> str | None:
        path = self.folder / change.file
        compiled = Path(cache_from_source(str(path)))
        original = path.read_bytes()
        tree = ast.parse(original)
        make = next(make for found, make in changes(change.file, tree) if found.number == change.number)
        make()
        ast.fix_missing_locations(tree)
        saved = self.keep / "original.json"
        saved.write_text(json.dumps([change.file, original.decode()]))
        try:
            path.write_text(ast.unparse(tree))
            compiled.unlink(missing_ok=True)  # it may have the same second and size
            for stage in self.measured.stages(tests):
                status = self._run(stage)
                if status != 0:
                    return "does not end" if status is None else self._first_failure(status)
        finally:
            path.write_bytes(original)
            compiled.unlink(missing_ok=True)
            saved.unlink()
        return None

    def _first_failure(self, status: int) -> str:
        output = (self.keep / "last.log").read_text(errors="replace")
        starts = ("FAILED ", "ERROR ")
        lines = [line.split(" ", 1)[1] for line in output.splitlines() if line.startswith(starts)]
        return lines[0].split(" - ")[0] if lines else f"status {status}"


def possible_changes(folder: Path, only: str) -> list[Change]:
    return [
        change
        for package in PACKAGES
        for path in sorted((folder / package).rglob("*.py"))
        if (file := str(path.relative_to(folder))) not in LOOKS and file.startswith(only)
        for change, _ in changes(file, ast.parse(path.read_bytes()))
    ]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=200, help="changes to try")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder that keeps what is measured, and the results")
    parser.add_argument("--tests", nargs="*", help="test files; by default those of service and worker")
    parser.add_argument("--only", default="", help="change files whose path begins so")
    parser.add_argument("--seconds", type=float, default=1200.0, help="for one test file to be measured")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin nothing after so long")
    parser.add_argument("--again", action="store_true", help="first try again what was not noticed")
    parser.add_argument(
        "--further", type=float, default=0.0, metavar="SECONDS", help="run other tests of the line, too"
    )
    parser.add_argument("--measure-only", action="store_true")
    options = parser.parse_args()
    deadline = time.monotonic() + 60.0 * options.minutes
    with tempfile.TemporaryDirectory() as temporary:
        keep = (options.keep or Path(temporary)).absolute()
        (keep / "lines").mkdir(parents=True, exist_ok=True)
        folder = copied(keep / "project")
        if (keep / "original.json").exists():  # the last call was ended in the middle of a change
            file, text = json.loads((keep / "original.json").read_text())
            (folder / file).write_text(text)
        preload(folder)
        files = options.tests or [
            str(path.relative_to(folder))
            for pattern in TEST_FILES
            for path in sorted((folder / "tests").glob(pattern))
            if str(path.relative_to(folder / "tests")) not in ELSEWHERE
        ]
        for file in files:
            if time.monotonic() < deadline:
                record(folder, file, keep / "lines" / f"{file.replace('/', '.')}.json", options.seconds)
        if not options.measure_only:
            _try_sample(Trials(folder, keep, options.further), options, deadline)


def _try_sample(trials: Trials, options: argparse.Namespace, deadline: float) -> None:
    possible = possible_changes(trials.folder, options.only)
    covered = [change for change in possible if trials.measured.tests.get((change.file, change.line))]
    print(f"{len(possible)} changes are possible, {len(covered)} of them on lines that a test runs")
    results = trials.keep / f"results-{options.seed}{options.only.replace('/', '.')}.jsonl"
    done: dict[Change, str | None] = {}
    for line in results.read_text().splitlines() if results.exists() else ():
        *fields, result = json.loads(line)
        done[Change(*fields)] = result
    # The sample stays the same when new tests run more lines.
    drawn = random.Random(options.seed).sample(covered, len(covered))
    chosen = [*done, *(change for change in drawn if change not in done)][: options.count]
    waiting = [change for change in chosen if change not in done or (options.again and done[change] is None)]
    with results.open("a") as file:
        for change in waiting:
            if time.monotonic() >= deadline:
                print(f"{sum(change not in done for change in chosen)} changes are left to try")
                break
            done[change] = trials.noticed(change)
            file.write(json.dumps([*change, done[change]]) + "\n")
            file.flush()
            if done[change] is None:
                print(f"not noticed: {change.file}:{change.line} {change.kind}: {change.text}", flush=True)
    _report({change: done[change] for change in chosen if change in done})


def _report(done: dict[Change, str | None]) -> None:
    rows = []
    for kind in [*sorted({change.kind for change in done}), *(["all"] if done else [])]:
        results = [result for change, result in done.items() if kind in ("all", change.kind)]
        seen = sum(result is not None for result in results)
        rows.append((kind, len(results), seen, f"{seen / len(results):.1%}"))
    print("\n" + table(("change", "tried", "noticed", "share"), rows))


if __name__ == "__main__":
    main()
