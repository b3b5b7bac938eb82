"""The architecture is a failing check: who may import whom, and what no file may say."""

import ast
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

import grimp
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from paths import ROOT

PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT = PYPROJECT["project"]
PACKAGES = tuple(PYPROJECT["tool"]["setuptools"]["packages"])
TOP_LEVEL = tuple(package for package in PACKAGES if "." not in package)
SOURCES = tuple(sorted(path for package in TOP_LEVEL for path in (ROOT / package).rglob("*.py")))
OURS = (*TOP_LEVEL, "tests", "benchmarks", ".ci")

#: Libraries that a room may import, itself or by way of other rooms of the project.
ALLOWED = {
    "kernel": {"numpy", "numba"},
    "kernel.params": {"numpy"},
    "worker": {"numpy", "numba", "pydantic", "zarr", "numcodecs", "obstore", "xarray", "dask", "distributed"},
    "worker.spec": {"numpy", "pydantic"},
    "worker.plan": {"numpy", "pydantic"},
    "service.client": {"httpx2", "numpy", "xarray", "rich", "pydantic", "zarr"},
}

#: What a specification is made of: light, so that clients can hold one.
SPECIFICATION = {
    "worker.spec",
    "worker.spec.parsing",
    "worker.spec.axes",
    "worker.spec.contact_models",
    "worker.spec.time_steps",
    "worker.spec.errors",
    "kernel.params",
    "kernel.restitution",
    "kernel.step_limits",
}

#: Of the project's own rooms, all that these may reach.
ROOMS = {
    "worker.spec": SPECIFICATION,
    "worker.plan": SPECIFICATION | {"worker.plan", "worker.schema"},
    "service.client": SPECIFICATION | {"service.client"},
}


@pytest.fixture(scope="module")
def imports() -> grimp.ImportGraph:
    return grimp.build_graph(*TOP_LEVEL, include_external_packages=True, cache_dir=None)


def within(module: str, room: str) -> bool:
    return module == room or module.startswith(f"{room}.")


def reached(graph: grimp.ImportGraph, room: str) -> set[str]:
    """Every module that importing `room` may load, the libraries by their top-level names."""
    inside = {module for module in graph.modules if within(module, room)}
    return inside.union(*(graph.find_upstream_modules(module) for module in inside))


def is_ours(module: str) -> bool:
    return module.split(".", maxsplit=1)[0] in TOP_LEVEL


def project_files() -> list[Path]:
    """Every text file of the project, generated and installed ones left out."""
    files = [path for path in ROOT.iterdir() if path.is_file() and path.name != ".git"]
    for folder in (*OURS, "docs"):
        files += [path for path in (ROOT / folder).rglob("*") if path.is_file()]
    generated = {"__pycache__", ".hypothesis"}
    binary = {".png", ".nbi", ".nbc", ".pyc", ".zip"}
    return [path for path in files if not generated & set(path.parts) and path.suffix not in binary]


def test_import_contracts_hold():
    command = [Path(sys.executable).with_name("lint-imports"), "--no-cache"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("room", ALLOWED)
def test_room_uses_only_its_libraries(imports: grimp.ImportGraph, room: str):
    libraries = {module for module in reached(imports, room) if not is_ours(module)}
    assert libraries - sys.stdlib_module_names <= ALLOWED[room]


@pytest.mark.parametrize("room", ROOMS)
def test_room_reaches_only_its_neighbours(imports: grimp.ImportGraph, room: str):
    rooms = {module for module in reached(imports, room) if is_ours(module) and module not in PACKAGES}
    assert {module for module in rooms if not any(within(module, one) for one in ROOMS[room])} == set()


def libraries_imported(*folders: str) -> set[str]:
    """Top-level names of what the files of these folders import, less Python's and the project's own."""
    files = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    nodes = [node for path in files for node in ast.walk(ast.parse(path.read_text()))]
    named = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    named |= {node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)}
    neighbours = {path.stem for path in files} | {*OURS}
    return {name.split(".", maxsplit=1)[0] for name in named} - sys.stdlib_module_names - neighbours


@pytest.mark.parametrize(
    ("folders", "extras"),
    [(TOP_LEVEL, ["s3"]), (["tests"], ["test"]), (["benchmarks"], ["bench", "test"])],
    ids=["program", "tests", "benchmarks"],
)
def test_whatever_is_imported_is_asked_for(folders: Sequence[str], extras: Sequence[str]):
    wanted = [
        *PROJECT["dependencies"],
        *(one for name in extras for one in PROJECT["optional-dependencies"][name]),
    ]
    asked_for = {canonicalize_name(Requirement(one).name) for one in wanted}
    other_name = {"yaml": "pyyaml", "sksundae": "scikit-sundae", "PIL": "pillow"}
    imported = {canonicalize_name(other_name.get(name, name)) for name in libraries_imported(*folders)}
    assert imported - asked_for == set()


def test_packages_are_the_three_of_the_design():
    assert TOP_LEVEL == ("kernel", "worker", "service")
    found = {".".join(path.relative_to(ROOT).parent.parts) for path in SOURCES if path.name == "__init__.py"}
    assert found == set(PACKAGES)


def test_only_the_client_package_has_code_in_its_init():
    with_code = [path for path in SOURCES if path.name == "__init__.py" and path.read_text().strip()]
    assert with_code == [ROOT / "service" / "client" / "__init__.py"]


@pytest.mark.parametrize("path", [pytest.param(path, id=str(path.relative_to(ROOT))) for path in SOURCES])
def test_module_is_short_and_says_what_it_is(path: Path):
    text = path.read_text()
    assert len(text.splitlines()) <= 300
    assert not text.strip() or ast.get_docstring(ast.parse(text))


def test_tests_are_flat():
    assert not list((ROOT / "tests").rglob("__init__.py"))


def test_client_exports_what_it_promises():
    import service.client

    assert {"Client", "Job"} <= set(service.client.__all__)
    for name in service.client.__all__:
        assert getattr(service.client, name).__module__.startswith("service.client"), name


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
