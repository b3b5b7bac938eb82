"""Description of the machine and of the package versions of a measurement."""

import importlib.metadata
import os
import platform
from pathlib import Path


def describe(*packages: str) -> str:
    """One line: processor, cores, and versions of Python, numpy, numba and `packages`."""
    model = platform.processor()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [
            line.split(":", 1)[1].strip()
            for line in info.read_text().splitlines()
            if line.startswith("model name")
        ]
        model = models[0] if models else model
    versions = []
    for package in ("numpy", "numba", *packages):
        versions.append(f"{package} {importlib.metadata.version(package)}")
    return f"{model}, {os.cpu_count()} cores; Python {platform.python_version()}, {', '.join(versions)}"
