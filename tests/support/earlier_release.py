"""The data folder that release 0.1.0 wrote, with kernel version 1."""

import json
import zipfile
from pathlib import Path
from typing import Any

from paths import GOLDEN

_NAME = "data-folder-0.1.0"

#: Of its jobs `done` and `interrupted`: id, chunks, and the checksum that release computed of each chunk.
EXPECTED: dict[str, Any] = json.loads((GOLDEN / f"{_NAME}.json").read_text())


def unpacked(parent: Path) -> Path:
    """The data folder, in `parent`."""
    with zipfile.ZipFile(GOLDEN / f"{_NAME}.zip") as archive:
        archive.extractall(parent)
    return parent / "bounce-data"
