"""The architecture is a failing check: who may import whom, and what no file may say."""

import ast
import sys
import tomllib
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from extras import LINT
from paths import ROOT
from tables import for_each

if TYPE_CHECKING:
    import grimp

PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
TOP_LEVEL = ("kernel", "worker", "service")
SOURCES = tuple(sorted(path for package in TOP_LEVEL for path in (ROOT / package).rglob("*.py")))
#: Packages that hold nothing themselves.
PARENTS = {"kernel", "worker", "service"}

#: Libraries that a package may import, itself or by way of other modules of the project.
ALLOWED = {
    "kernel": {"numpy", "numba", "flint"},
    "kernel.params": {"numpy"},
    "worker": {"numpy", "numba", "pydantic", "zarr", "numcodecs", "obstore", "xarray", "dask", "distributed"},
    "worker.spec": {"numpy", "pydantic"},
    "worker.study": {"numpy", "pydantic"},
    "service.client": {
        "httpx2", "numpy", "xarray", "pandas", "matplotlib", "rich", "pydantic", "zarr", "obstore",
        "IPython",
    },
}  # fmt: skip

#: What a specification is made of: light, so that clients can hold one.
SPECIFICATION = {
    "worker.spec", "kernel.params", "kernel.portable_math", "kernel.restitution", "kernel.step_limits",
    "kernel.cycles", "kernel.stopping",
}  # fmt: skip

#: Of the project's own modules, all that these may reach.
REACHABLE = {
    "worker.spec": SPECIFICATION,
    "worker.study": SPECIFICATION | {"worker.study"},
    "service.client": SPECIFICATION
    | {
        "kernel.labels", "kernel.threshold", "service.client", "service.formats", "service.pictures",
        "service.budget", "service.result_methods", "service.tokens", "worker.files", "worker.sweep",
    },
}  # fmt: skip

#: Packages whose face is their __init__; all others are empty.
FACES = {"worker/store", "worker/study", "worker/sweep", "service/client"}

#: Modules of one folder at most, __init__ apart.
MOST_MODULES = 20


@pytest.fixture(scope="module")
def imports() -> "grimp.ImportGraph":
    """Which module imports which."""
    builder = pytest.importorskip("grimp", reason=LINT)
    return builder.build_graph(*TOP_LEVEL, include_external_packages=True, cache_dir=None)


def within(module: str, package: str) -> bool:
    return module == package or module.startswith(f"{package}.")


def reached(graph: "grimp.ImportGraph", package: str) -> set[str]:
    """Every module that importing `package` may load, the libraries by their top-level names."""
    inside = {module for module in graph.modules if within(module, package)}
    return inside.union(*(graph.find_upstream_modules(module) for module in inside))


def is_ours(module: str) -> bool:
    return module.split(".", maxsplit=1)[0] in TOP_LEVEL


@for_each("package", ALLOWED)
def test_package_uses_only_its_libraries(imports: "grimp.ImportGraph", package: str):
    libraries = {module for module in reached(imports, package) if not is_ours(module)}
    assert libraries - sys.stdlib_module_names <= ALLOWED[package]


@pytest.mark.parametrize("package", REACHABLE)
def test_package_reaches_only_its_neighbours(imports: "grimp.ImportGraph", package: str):
    modules = {module for module in reached(imports, package) if is_ours(module)} - PARENTS
    allowed = REACHABLE[package]
    assert {module for module in modules if not any(within(module, name) for name in allowed)} == set()


def test_packages_are_the_three_of_the_design_and_their_face():
    built = {
        package.split(".")[0] for package in PYPROJECT["tool"]["setuptools"]["packages"]["find"]["include"]
    }
    assert built == {*TOP_LEVEL, "bouncing_spring"}
    without_init = {path.parent for path in SOURCES} - {
        path.parent for path in SOURCES if path.name == "__init__.py"
    }
    assert without_init == set()


def test_only_faces_have_code_in_their_init():
    with_code = [path for path in SOURCES if path.name == "__init__.py" and path.read_text().strip()]
    assert {str(path.parent.relative_to(ROOT)) for path in with_code} == FACES


@for_each("path", [pytest.param(path, id=str(path.relative_to(ROOT))) for path in SOURCES])
def test_module_says_what_it_is(path: Path):
    text = path.read_text()
    assert not text.strip() or ast.get_docstring(ast.parse(text))


def test_no_folder_is_crowded():
    folders = Counter(path.parent for path in SOURCES if path.name != "__init__.py")
    folders.update(path.parent for path in (ROOT / "service" / "static").rglob("*.js"))
    assert {str(folder): n for folder, n in folders.items() if n > MOST_MODULES} == {}
