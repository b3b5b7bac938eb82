"""What other programs say of the packages: import contracts, git, a traced sweep; what all files import."""

import ast
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest
from extras import LINT, program
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from paths import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
TOP_LEVEL = ("kernel", "worker", "service")
OURS = (*TOP_LEVEL, "bouncing_spring", "tests", "benchmarks", ".ci")


def project_files() -> list[Path]:
    """Every text file of the project: what git tracks or would track, not what else lies in the folder."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    try:
        listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"needs git and a clone, which tells the project's files from others: {error}")
    files = [ROOT / name for name in listed.split("\0") if name]
    binary = {".png", ".zip"}
    return [path for path in files if path.is_file() and path.suffix not in binary]


def test_import_contracts_hold():
    command = [program("lint-imports", LINT), "--no-cache"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_tests_are_no_packages():
    """A package named `tests/kernel` would hide the project's own `kernel`."""
    assert [
        path for path in project_files() if path.name == "__init__.py" and path.is_relative_to(ROOT / "tests")
    ] == []


def test_the_way_of_a_sweep_is_the_one_described():
    """docs/architecture.md lists every file between submission and diagram, as a traced sweep enters them."""
    text = (ROOT / "docs" / "architecture.md").read_text()
    rows = re.findall(r"^\d+\. (?:\*\*\w+\*\* )?(\*?)`([^`]+)`", text, re.MULTILINE)
    listed, returns = {path for _, path in rows}, sum(bool(star) for star, _ in rows)
    assert len(listed) == len(rows) - returns <= 60
    assert returns <= 10

    beside = re.search(r"^Beside the way.*$", text, re.MULTILINE)
    assert beside
    others = tuple(re.findall(r"`([^`]+)`", beside[0]))
    script = str(ROOT / "tests" / "support" / "trace_sweep.py")
    done = subprocess.run(
        [sys.executable, "-W", "ignore", script], cwd=ROOT, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    entered = set(done.stdout.split())
    in_a_cluster, here = {"worker/executors/dask.py", "worker/watchdog.py"}, {"worker/executors/inline.py"}
    assert listed - entered == in_a_cluster
    assert {path for path in entered - listed - here if not path.startswith(others)} == set()


def test_no_file_names_a_package_registry_or_a_folder_of_somebodys_machine():
    # In pieces, so that this file does not name them either.
    hosts = ["py" + "pi.org", "python" + "hosted.org", "ana" + "conda.org"]
    options = ["--index" + "-url", "--extra-index" + "-url", "--find" + "-links"]
    folders = ["/wo" + "rk/", "/ro" + "ot/", "/ho" + "me/", "/Us" + "ers/", "/op" + "t/"]
    named = [
        f"{path.relative_to(ROOT)}: {word}"
        for path in project_files()
        for word in (*hosts, *options, *folders)
        if word in path.read_text()
    ]
    assert named == []


def statements(node: ast.AST) -> Iterator[ast.AST]:
    """All statements within, without looking into expressions."""
    for block in ("body", "handlers", "orelse", "finalbody", "cases"):
        for child in getattr(node, block, ()):
            yield child
            yield from statements(child)


def libraries_imported(*folders: str) -> set[str]:
    """Top-level names of what the files of these folders import, less Python's and the project's own."""
    files = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    scripts = (path.stem for path in (ROOT / "docs").rglob("*.py"))  # which tests import
    nodes = [node for path in files for node in statements(ast.parse(path.read_text()))]
    named = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    named |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
    neighbours = {path.stem for path in files} | {*OURS, *scripts}
    return {name.split(".", maxsplit=1)[0] for name in named} - sys.stdlib_module_names - neighbours


@pytest.mark.parametrize(
    ("folders", "extras"),
    [
        (TOP_LEVEL, ["s3", "notebook", "parquet", "proofs"]),
        (["tests", "docs"], ["test", "system", "lint"]),
        (["benchmarks"], ["bench", "test", "system"]),
    ],
    ids=["program", "tests", "benchmarks"],
)
def test_whatever_is_imported_is_asked_for(folders: Sequence[str], extras: Sequence[str]):
    wanted = [
        *PROJECT["dependencies"],
        *(one for name in extras for one in PROJECT["optional-dependencies"][name]),
    ]
    asked_for = {canonicalize_name(Requirement(one).name) for one in wanted}
    other_name = {"yaml": "pyyaml", "PIL": "pillow", "flint": "python-flint"}
    imported = {canonicalize_name(other_name.get(name, name)) for name in libraries_imported(*folders)}
    assert imported - asked_for == set()
