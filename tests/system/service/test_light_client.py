"""A client alone, of the libraries in requirements-client.txt: everything that asks a service works.

A fresh interpreter refuses to import what is installed beside them, as if it were not there.
"""

import json
import subprocess
import sys
import tomllib
from importlib import metadata
from pathlib import Path

from extras import WITHOUT
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from paths import ROOT
from scripted import DEADLINE
from served import computing_at

LISTED = [
    Requirement(line)
    for line in (ROOT / "requirements-client.txt").read_text().splitlines()
    if not line.startswith("#")
]

ASKS = """
address, folder = sys.argv[1:]
from click.testing import CliRunner
from service.cli.main import main
from bouncing_spring import Client, Ramp, Range, Rigid, SweepSpec

with Client(address) as client:
    spec = SweepSpec(gamma=Range(start=0.6, stop=1.6, num=11), omega=[0.5], xi=0.26, settle=20, observe=10,
                     model=Rigid(kind="rigid"), protocol=Ramp(kind="ramp", axis="gamma", direction="both"))
    job = client.submit(spec).wait(progress=False)
    assert job.diagram(direction="up").flight_time.size
    assert job.modes(direction="down").bounces.size
    assert job.threshold(progress=False).up.size
    assert job.trajectory(gamma=1.5, direction="up").z1.size
    assert job.open().load().sel(direction="up").outcome.all()
    job.export(f"{folder}/sweep.nc")
    job.export(f"{folder}/sweep.parquet", layout="flights")
    assert client.threshold(omega=0.6, xi=0.05).down > 0
    assert [one.id for one in client.jobs()] == [job.id]
diagram = ["diagram", job.id, "-o", f"{folder}/a.csv"]
for command in (["list"], ["status", job.id], ["threshold", job.id], diagram):
    done = CliRunner().invoke(main, [*command, "--url", address])
    assert done.exit_code == 0, (command, done.output, done.exception)
spec, data = f"{folder}/spec.json", ["--data", f"{folder}/data"]
open(spec, "w").write(json.dumps(job.spec))
for command in (
    ["serve"], ["run", spec, "-o", f"{folder}/b.zarr"], ["run", spec, "-o", f"{folder}/b.csv"],
    ["figure", "2", "-o", f"{folder}/2.png", "--url", address], ["tradeoff"], ["doctor", *data],
    ["backup", f"{folder}/c", *data], ["restore", f"{folder}/c", *data], ["adopt", "--all", *data],
):
    done = CliRunner().invoke(main, command)
    assert (done.exit_code, done.output.count("\\n")) == (1, 1), (command, done.output, done.exception)
    assert "is not installed with the client alone: pip install -e ." in done.output, command
try:
    from bouncing_spring import run
except ImportError as error:
    assert "run needs " in str(error) and "pip install -e ." in str(error)
else:
    raise AssertionError("run is there")
print("asked")
"""


def closure(requirements: list[Requirement]) -> set[str]:
    """The names of the listed distributions and of all that they require."""
    names: set[str] = set()
    waiting = [
        (canonicalize_name(requirement.name), frozenset(requirement.extras)) for requirement in requirements
    ]
    while waiting:
        name, extras = waiting.pop()
        if name in names:
            continue
        names.add(name)
        for required in map(Requirement, metadata.requires(name) or []):
            wanted = [{"extra": extra} for extra in extras] or [{"extra": ""}]
            if required.marker is None or any(map(required.marker.evaluate, wanted)):
                waiting.append((canonicalize_name(required.name), frozenset(required.extras)))
    return names


def test_the_list_has_the_projects_bounds():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    bounds = {canonicalize_name(one.name): one.specifier for one in map(Requirement, project["dependencies"])}
    assert {canonicalize_name(one.name): one.specifier for one in LISTED}.items() <= bounds.items()


def test_a_client_asks_with_these_libraries_alone(tmp_path: Path):
    allowed = closure(LISTED) | {"bouncing-spring"}
    refused = [
        module
        for module, owners in metadata.packages_distributions().items()
        if not {canonicalize_name(owner) for owner in owners} & allowed
    ]
    assert {"numba", "distributed", "fastapi", "matplotlib", "pyarrow", "h5py"} <= set(refused)
    with computing_at(tmp_path / "data") as address:
        done = subprocess.run(
            [sys.executable, "-c", WITHOUT + ASKS, address, str(tmp_path)],
            input=json.dumps(refused), capture_output=True, text=True, check=False, timeout=10 * DEADLINE,
        )  # fmt: skip
    assert (done.stdout, done.returncode) == ("asked\n", 0), done.stderr
    assert {path.suffix for path in tmp_path.iterdir()} >= {".nc", ".parquet", ".csv"}
