"""The versions of requirements.lock, as constraints for pip: without hashes.

With `--check` it compares them with what is installed, and fails if a library has another version.
"""

import re
import sys
import tomllib
from importlib import metadata
from pathlib import Path

LOCK = Path(__file__).parents[1] / "requirements.lock"


def pins() -> list[str]:
    """`name==version`, some with a marker."""
    lines = re.findall(r"^([a-z0-9][^\\\n]*==[^\\\n]*?)\s*\\?$", LOCK.read_text(), re.MULTILINE)
    return [line.strip() for line in lines]


def differences() -> list[str]:
    """What is installed in another version than the lock's."""
    from packaging.requirements import Requirement  # noqa: PLC0415 - printing needs no library

    found = []
    project = tomllib.loads(LOCK.with_name("pyproject.toml").read_text())
    build = {Requirement(text).name for text in project["dependency-groups"]["build"]}  # not imported
    for pin in map(Requirement, pins()):
        if pin.name in build:
            continue
        if pin.marker is not None and not pin.marker.evaluate():
            continue
        try:
            installed = metadata.version(pin.name)
        except metadata.PackageNotFoundError:
            continue  # of an extra that is not installed
        if not pin.specifier.contains(installed, prereleases=True):
            found.append(f"{pin.name} {installed} is installed, requirements.lock has {pin.specifier}")
    return found


if __name__ == "__main__":
    if sys.argv[1:] == ["--check"]:
        sys.exit("\n".join(differences()) or None)
    sys.stdout.write("\n".join([*pins(), ""]))
