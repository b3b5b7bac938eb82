"""Specifications as JSON: of any study, and some of several chunks of some tenths of a second."""

from typing import Any, Final

_RANGE: Final = ("start", "stop", "num")


def spec_of(
    gamma: Any, omega: Any, xi: Any, ramp: str = "", window: tuple[int, ...] = (), **fields: Any
) -> dict[str, Any]:
    """A study on the rigid plate.

    Axes are numbers, lists, or (start, stop, num). `ramp`: along gamma up, down or both. `window`: settle,
    observe, keep.
    """
    axes = {"gamma": gamma, "omega": omega, "xi": xi}
    ranges = {name: dict(zip(_RANGE, x, strict=True)) for name, x in axes.items() if isinstance(x, tuple)}
    protocol = {"protocol": {"kind": "ramp", "axis": "gamma", "direction": ramp}} if ramp else {}
    times = dict(zip(("settle", "observe", "keep"), window, strict=False))
    return axes | ranges | {"model": {"kind": "rigid"}} | protocol | times | fields


BASINS: Final = spec_of(
    (1.0, 4.0, 12), [0.5, 0.6], 0.26, protocol={"kind": "basin", "rows": 32, "columns": 48}, exponents=1
)
MULTISTABILITY: Final = spec_of((3.0, 4.0, 12), (0.4, 0.6, 25), 0.26, protocol={"kind": "multistability"})
ADAPTIVE: Final = spec_of((0.4, 4.4, 260), (0.4, 1.0, 260), 0.26, window=(600, 60, 8), refine={"by": "mode"})
STUDIES: Final = {"basins": BASINS, "multistability": MULTISTABILITY, "adaptive": ADAPTIVE}
