"""The study of a sweep: every cell of a grid, from rest or along a ramp."""

from worker.sweep.specification import AXES, SweepSpec

__all__ = ["AXES", "SweepSpec"]
