"""What tools say of the files of a deployment."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from extras import LINT, locked, program
from packaging.requirements import Requirement
from paths import ROOT

from kernel.params import KERNEL_VERSION


def tool(name: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [program(name, LINT), *arguments]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=300)


SCHEMAS = {
    "compose-spec": "docker-compose.yml",
    "github-workflows": ".github/workflows/*.yml",
    "citation-file-format": "CITATION.cff",
}


@pytest.mark.parametrize(("schema", "files"), SCHEMAS.items())
def test_files_are_what_their_schema_says(schema: str, files: str):
    found = [str(path) for path in ROOT.glob(files)]
    done = tool("check-jsonschema", "--builtin-schema", f"vendor.{schema}", *found)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_release_writes_its_version_everywhere_and_is_tagged(tmp_path: Path):
    """The files and a history of their own; the checks have passed."""

    def run(*words: str) -> str:
        person = {
            f"GIT_{role}_{key}": "nobody" for role in ("AUTHOR", "COMMITTER") for key in ("NAME", "EMAIL")
        }
        done = subprocess.run(
            words, cwd=tmp_path, env=os.environ | person, check=False, text=True, capture_output=True
        )
        return done.stdout + done.stderr

    versioned = ["pyproject.toml", "CITATION.cff", "Dockerfile"]
    hashes = "tests/golden/kernel_hash.json"
    for name in (*versioned, ".ci/release", "kernel/params.py", hashes):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    old = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    changelog = tmp_path / "CHANGELOG.md"
    before = f"## [{old}] - 2026-01-01\n\nTag `v{old}`, kernel version {KERNEL_VERSION}.\n"
    changelog.write_text(f"## [Unreleased]\n\n### Added\n\n- A change.\n\n{before}")
    for command in ("init -q", "add -A", "commit -qm before", f"tag v{old}"):
        run("git", *command.split())

    (tmp_path / hashes).write_text("{}")
    run("git", "commit", "-qam", "other numbers")
    assert "raise KERNEL_VERSION" in run(".ci/release", "99.0.0", "--checked")
    run("git", "reset", "-q", "--hard", f"v{old}")

    assert "tagged v99.0.0" in run(".ci/release", "99.0.0", "--checked")
    assert run("git", "describe") == "v99.0.0\n"
    for name in versioned:
        assert (tmp_path / name).read_text().count("99.0.0") == 1
    assert re.match(r"## \[Unreleased\]\n\n## \[99.0.0\] - .*\n\nTag `v99.0.0`", changelog.read_text())
    assert "no change under Unreleased" in run(".ci/release", "99.1.0", "--checked")


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
