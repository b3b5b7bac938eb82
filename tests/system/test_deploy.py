"""What tools say of the files of a deployment."""

import re
import subprocess
import sys

from extras import LINT, program
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from paths import ROOT

LOCK = (ROOT / "requirements.lock").read_text()


def tool(name: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [program(name, LINT), *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)


def locked() -> dict[str, list[Requirement]]:
    """The pins of the lock file by library; a library can have several, for different Pythons."""
    pins: dict[str, list[Requirement]] = {}
    for line in re.findall(r"^([a-z0-9][^\\\n]*==[^\\\n]*)", LOCK, re.MULTILINE):
        pin = Requirement(line)
        pins.setdefault(canonicalize_name(pin.name), []).append(pin)
    return pins


def test_compose_file_is_valid():
    done = tool("check-jsonschema", "--builtin-schema", "vendor.compose-spec", "docker-compose.yml")
    assert done.returncode == 0, done.stdout + done.stderr


def test_workflows_are_valid():
    files = sorted(str(path) for path in (ROOT / ".github/workflows").glob("*.yml"))
    done = tool("check-jsonschema", "--builtin-schema", "vendor.github-workflows", *files)
    assert done.returncode == 0, done.stdout + done.stderr


def test_dockerfile_passes_hadolint():
    done = tool("hadolint", "Dockerfile")
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


def test_constraints_of_the_check_are_the_lock():
    """`.ci/run` installs what is shipped; `--check` finds what it did not."""
    printed = subprocess.run(
        [sys.executable, ".ci/locked.py"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
    lines = [Requirement(line) for line in printed.splitlines()]
    assert sorted(map(str, lines)) == sorted(str(pin) for pins in locked().values() for pin in pins)
    assert "--hash" not in printed
