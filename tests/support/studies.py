"""Studies other than plain sweeps, each of several chunks of some tenths of a second."""

from typing import Any, Final

_RIGID: Final = {"xi": 0.26, "model": {"kind": "rigid"}}

BASINS: Final[dict[str, Any]] = _RIGID | {
    "protocol": {"kind": "basin", "rows": 32, "columns": 48},
    "gamma": {"start": 1.0, "stop": 4.0, "num": 12},
    "omega": [0.5, 0.6],
    "exponents": 1,
}
MULTISTABILITY: Final[dict[str, Any]] = _RIGID | {
    "protocol": {"kind": "multistability"},
    "gamma": {"start": 3.0, "stop": 4.0, "num": 12},
    "omega": {"start": 0.4, "stop": 0.6, "num": 32},
}
ADAPTIVE: Final[dict[str, Any]] = _RIGID | {
    "gamma": {"start": 0.4, "stop": 4.4, "num": 260},
    "omega": {"start": 0.4, "stop": 1.0, "num": 260},
    "settle": 600,
    "observe": 60,
    "keep": 8,
    "refine": {"by": "mode"},
}
STUDIES: Final = {"basins": BASINS, "multistability": MULTISTABILITY, "adaptive": ADAPTIVE}
