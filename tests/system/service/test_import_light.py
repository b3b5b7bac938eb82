"""What is imported often loads little: a fresh interpreter tells."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from paths import ROOT

from service.ledger.ledger import Ledger

SERVER = {"fastapi", "uvicorn", "starlette", "sqlite3", "pydantic_settings"}
COMPUTING = {"distributed", "dask", "zarr", "numba", "matplotlib"}
SLOW = {"xarray", "pandas", "numpy", "rich", "pydantic"}


def loaded_by(code: str) -> set[str]:
    """Top-level names of all modules that a fresh interpreter holds after running `code`."""
    report = "import sys, json; print(json.dumps(sorted({name.split('.')[0] for name in sys.modules})))"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\n{report}"], capture_output=True, text=True, check=True
    )
    return set(json.loads(done.stdout.splitlines()[-1]))


@pytest.mark.parametrize(
    ("code", "forbidden"),
    [
        ("import bouncing_spring", SERVER | COMPUTING | SLOW),
        ("import service.client.dataset", SERVER | COMPUTING),
        ("from service.client.specification import body; import worker.spec.parsing", SERVER | COMPUTING),
        ("import service.cli.main", SERVER | COMPUTING | SLOW | {"httpx2"}),
        ("import service.figures.catalogue", SERVER | COMPUTING | SLOW),
    ],
)
def test_importing_does_not_load(code: str, forbidden: set[str]):
    assert loaded_by(code) & forbidden == set()


def modules_in(folder: str) -> str:
    names = (path.relative_to(ROOT).with_suffix("") for path in (ROOT / folder).rglob("*.py"))
    return ", ".join(".".join(name.parts) for name in names if name.name != "__init__")


def test_jobs_load_neither_kernels_nor_zarr():
    """Workers load them: the import contract has no eye for imports within functions, this has."""
    assert loaded_by(f"import worker.studies, {modules_in('service/jobs')}") & COMPUTING == set()


def test_a_backup_loads_neither_server_nor_kernels(tmp_path: Path):
    Ledger(tmp_path / "ledger.sqlite").close()
    words = ["backup", "--data", str(tmp_path), str(tmp_path / "copy.sqlite")]
    code = (
        "from click.testing import CliRunner; from service.cli.main import main; "
        f"assert CliRunner().invoke(main, {words}).exit_code == 0"
    )
    assert loaded_by(code) & (COMPUTING | {"fastapi", "uvicorn"}) == set()


def test_showing_help_loads_no_library_but_clicks():
    code = (
        "from click.testing import CliRunner; from service.cli.main import main; "
        "CliRunner().invoke(main, ['--help'])"
    )
    assert loaded_by(code) & (SERVER | COMPUTING | SLOW | {"httpx2"}) == set()


def test_what_proves_is_loaded_by_proofs_only():
    answers = (
        "from worker.kernel_cache import use_cache; use_cache()\n"
        "from service.views.registry import SPRINGS\n"
        "for view in ('threshold', 'orbits'):\n"
        "    SPRINGS[view].compute(None, SPRINGS[view].query(omega=0.6, xi=0.05))\n"
        "import sys; assert not [name for name in sys.modules if name.startswith('kernel.proofs')]"
    )
    assert "flint" not in loaded_by(answers)


@pytest.mark.parametrize("name", ["service.py", "worker/__init__.py"])
def test_a_package_of_the_same_name_is_said_in_one_line(name: str, tmp_path: Path):
    file = tmp_path / name
    file.parent.mkdir(exist_ok=True)
    file.touch()
    done = subprocess.run(
        [sys.executable, "-c", "import bouncing_spring"],
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    said = done.stderr.splitlines()[-1]
    assert f"hides the package {name.partition('.')[0].partition('/')[0]} of bouncing-spring" in said


def test_a_folder_of_the_same_name_hides_nothing(tmp_path: Path):
    for name in ("service", "worker", "kernel"):
        (tmp_path / name).mkdir()
    subprocess.run([sys.executable, "-c", "import bouncing_spring"], cwd=tmp_path, check=True)
