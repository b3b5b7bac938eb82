"""Whether the tests notice: random changes to `service/` and `worker/`, each tried on the tests that run it.

    python -m benchmarks.mutation --count 200 --seed 1

A change is one of: another comparison, a condition negated, another sign or operator, `return None`, a call
left out, another constant. It is made in a copy of the project, and up to 40 of the tests that run the
changed line are run, those first that run the fewest lines. A change is noticed if one of them fails or does
not end.

Which tests run which line is measured first, test file by test file, and kept in the folder `--keep`. Tests
whose work is done in other processes (a cluster, a browser, the documents) do not take part; `--tests` names
others. Only lines that some test runs are changed; how many others there are is printed. What only somebody
who looks at a picture or reads a text can judge is not changed: colours, sizes, fonts, texts, the log.
"""

import argparse
import ast
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
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.tables import table

ROOT = Path(__file__).parents[1]
PACKAGES = ("service", "worker")
#: Tests of one change at most.
MOST_TESTS = 40
#: Times what its tests took unchanged, and seconds beside, after which a change counts as noticed: it hangs.
SLACK, PATIENCE = 10.0, 90.0

#: Test files that do their work in other processes, or that compare source texts.
ELSEWHERE = (
    "service/test_cluster.py", "service/test_documents.py", "service/test_figures.py", "service/test_fuzz.py",
    "service/test_import_light.py", "service/test_tokens.py", "service/test_tradeoff.py",
    "worker/test_executors.py", "worker/test_kernel_cache.py", "worker/test_s3.py",
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
        return node.arg in LOOK_KEYWORDS
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
    """A copy of what git tracks or would track, without the kernel: its compiled code belongs to its path."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=ROOT, capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
    for name in filter(None, listed.split("\0")):
        if not name.startswith("kernel/") and (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    if (ROOT / ".numba-cache").is_dir():
        shutil.copytree(ROOT / ".numba-cache", folder / ".numba-cache")
    return folder


def preload(folder: Path) -> None:
    """Import the libraries here, once for all runs of tests; each run imports what a change may touch."""
    os.chdir(folder)
    sys.path[:0] = [str(folder), str(folder / "tests" / "support")]
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
    import pytest

    common = ["-q", "-n", "0", "-p", "no:cacheprovider", "--no-header", "--tb=short"]
    preloaded = ["-W", "ignore:Module already imported"]  # plugins among the libraries
    return int(pytest.main([*common, *preloaded, *arguments], plugins=list(plugins)))


class Recorder:
    """A pytest plugin: which lines each test runs, how long it takes, and whether it passes."""

    def __init__(self, folder: Path) -> None:
        import coverage

        self.coverage = coverage.Coverage(
            data_file=None, config_file=False, source=[str(folder / name) for name in PACKAGES]
        )
        self.seconds: dict[str, float] = {}
        self.failed: set[str] = set()
        self.coverage.start()

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.coverage.switch_context(nodeid)

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        self.coverage.switch_context("")

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration
        if not report.passed:
            self.failed.add(report.nodeid)

    def write(self, folder: Path, target: Path) -> None:
        self.coverage.stop()
        data = self.coverage.get_data()
        lines = {
            str(Path(file).relative_to(folder)): {
                line: [test for test in tests if test]
                for line, tests in data.contexts_by_lineno(file).items()
            }
            for file in data.measured_files()
        }
        target.write_text(
            json.dumps({"lines": lines, "seconds": self.seconds, "failed": sorted(self.failed)})
        )


def record(folder: Path, test_file: str, target: Path, seconds: float) -> None:
    """Measure a test file, unless that was done before."""

    def work() -> int:
        recorder = Recorder(folder)
        status = run_pytest([test_file, "-m", "not long"], [recorder])
        recorder.write(folder, target)
        return status

    if not target.exists():
        status = in_child(work, seconds, target.with_suffix(".log"))
        print(f"measured {test_file}: {'did not end' if status is None else f'status {status}'}", flush=True)


class Coverage(NamedTuple):
    """The passing tests that run each line of each file, and the seconds that each test takes."""

    tests: dict[tuple[str, int], list[str]]
    seconds: dict[str, float]
    breadth: Counter[str]  # lines that each test runs


def coverage_in(folder: Path) -> Coverage:
    tests: dict[tuple[str, int], list[str]] = defaultdict(list)
    seconds: dict[str, float] = {}
    breadth: Counter[str] = Counter()
    for kept in sorted(folder.glob("*.json")):
        content = json.loads(kept.read_text())
        failed = set(content["failed"])
        seconds |= content["seconds"]
        for file, lines in content["lines"].items():
            for line, names in lines.items():
                passing = [name for name in names if name not in failed]
                tests[file, int(line)] += passing
                breadth.update(passing)
    return Coverage(tests, seconds, breadth)


def noticed(folder: Path, change: Change, tests: Sequence[str], seconds: float, log: Path) -> str | None:
    """The test that fails after the change, or "does not end"; None if all pass."""
    path = folder / change.file
    original = path.read_bytes()
    tree = ast.parse(original)
    make = next(make for found, make in changes(change.file, tree) if found.number == change.number)
    make()
    ast.fix_missing_locations(tree)
    path.write_text(ast.unparse(tree))
    try:
        status = in_child(lambda: run_pytest(["-x", *tests]), seconds, log)
    finally:
        path.write_bytes(original)
    if status is None:
        return "does not end"
    if status == 0:
        return None
    output = log.read_text(errors="replace")
    names = [line.split()[1] for line in output.splitlines() if line.startswith(("FAILED ", "ERROR "))]
    return names[0] if names else f"status {status}"


def sources() -> list[str]:
    return [str(path.relative_to(ROOT)) for name in PACKAGES for path in sorted((ROOT / name).rglob("*.py"))]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--count", type=int, default=200, help="changes to try")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder that keeps what is measured, and the results")
    parser.add_argument(
        "--tests", nargs="*", help="test files; all of tests/service and tests/worker but some"
    )
    parser.add_argument("--only", default="", help="change files whose path begins so")
    parser.add_argument("--seconds", type=float, default=1200.0, help="for one test file to be measured")
    parser.add_argument("--measure-only", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        keep = (options.keep or Path(temporary) / "keep").absolute()
        (keep / "lines").mkdir(parents=True, exist_ok=True)
        folder = copied(Path(temporary) / "copy")
        preload(folder)
        files = options.tests or [
            str(path.relative_to(ROOT))
            for path in sorted([*ROOT.glob("tests/service/test_*.py"), *ROOT.glob("tests/worker/test_*.py")])
            if str(path.relative_to(ROOT / "tests")) not in ELSEWHERE
        ]
        for file in files:
            record(folder, file, keep / "lines" / f"{file.replace('/', '.')}.json", options.seconds)
        if not options.measure_only:
            _try(folder, keep, coverage_in(keep / "lines"), options)


def _try(folder: Path, keep: Path, measured: Coverage, options: argparse.Namespace) -> None:
    possible = [
        change
        for file in sources()
        if file not in LOOKS and file.startswith(options.only)
        for change, _ in changes(file, ast.parse((ROOT / file).read_bytes()))
    ]
    covered = [change for change in possible if measured.tests.get((change.file, change.line))]
    print(
        f"{len(possible)} changes are possible, {len(covered)} of them on lines that a test runs", flush=True
    )
    chosen = random.Random(options.seed).sample(covered, min(options.count, len(covered)))
    results = keep / f"results-{options.seed}{options.only.replace('/', '.')}.jsonl"
    done = {}
    for line in results.read_text().splitlines() if results.exists() else ():
        *change, result = json.loads(line)
        done[Change(*change)] = result
    with results.open("a") as file:
        for i, change in enumerate(chosen, 1):
            if change not in done:
                tests = sorted(
                    set(measured.tests[change.file, change.line]), key=lambda name: measured.breadth[name]
                )
                tests = tests[:MOST_TESTS]
                seconds = PATIENCE + SLACK * sum(measured.seconds.get(name, 0.0) for name in tests)
                done[change] = noticed(folder, change, tests, seconds, keep / "last.log")
                file.write(json.dumps([*change, done[change]]) + "\n")
                file.flush()
            if done[change] is None:
                print(
                    f"{i}: not noticed: {change.file}:{change.line} {change.kind}: {change.text}", flush=True
                )
    _report({change: done[change] for change in chosen})


def _report(done: dict[Change, str | None]) -> None:
    rows = []
    for kind in [*sorted({change.kind for change in done}), *(["all"] if done else [])]:
        results = [result for change, result in done.items() if kind in ("all", change.kind)]
        seen = sum(result is not None for result in results)
        rows.append((kind, len(results), seen, f"{seen / len(results):.1%}"))
    print("\n" + table(("change", "tried", "noticed", "share"), rows))


if __name__ == "__main__":
    main()
