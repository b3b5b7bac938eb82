"""The sweep specification: the contract between client, service and workers."""

from worker.spec.errors import SpecError
from worker.spec.sweep import AXES, LARGEST, SMALLEST, SweepSpec

__all__ = ["AXES", "LARGEST", "SMALLEST", "SpecError", "SweepSpec"]
