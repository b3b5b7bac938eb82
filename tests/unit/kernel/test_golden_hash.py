"""Stored bytes belong to KERNEL_VERSION: small lines of every model and protocol, hashed.

The cells are at rest or periodic with sticking, so that every cycle begins anew and an error in the last
digit of the C library does not grow. `stepped` gets its damping and steps as numbers, since the arrays
they come from may differ in the last digit from machine to machine.

To write the file anew, after raising KERNEL_VERSION: python tests/unit/kernel/test_golden_hash.py
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from tables import for_each

if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).parents[2] / "support"), str(Path(__file__).parents[3])]

from kernel_runs import digest
from paths import GOLDEN

from kernel.line import run_line
from kernel.models.ball import BallPlate
from kernel.models.rigid import RigidPlate
from kernel.models.soft import SoftPlate
from kernel.models.stepped import SteppedPlate
from kernel.params import KERNEL_VERSION, Line, Outcome

FILE = GOLDEN / "kernel_hash.json"

GAMMA = np.array([0.4, 1.3, 1.4, 1.5, 1.6])  # the first one at rest
OMEGA, XI = np.full_like(GAMMA, 0.5), np.full_like(GAMMA, 0.26)

E, D = np.full_like(GAMMA, 0.05), np.full_like(GAMMA, 1e-2)
ZETA, STEPS = np.full_like(GAMMA, 0.69), np.full(len(GAMMA), 4000)

PLATES: dict[str, Any] = {
    "rigid": RigidPlate(0.0 * E),
    "rigid, restitution": RigidPlate(2.0 * E),
    "soft, adhesive": SoftPlate(E, D, True),
    "soft, nonadhesive": SoftPlate(E, D, False),
    "stepped, adhesive": SteppedPlate(ZETA, D, STEPS, True, 0.5),
    "stepped, nonadhesive": SteppedPlate(ZETA, D, STEPS, False, 0.5),
    "stepped, euler": SteppedPlate(ZETA, D, STEPS, True, 0.0),
    "stepped, plain": SteppedPlate(ZETA, D, STEPS, True, 0.5, True),
    "ball": BallPlate(0.0 * E),
    "ball, restitution": BallPlate(2.0 * E),
}
PROTOCOLS = ("rest", "ramp")
CASES = [
    *(f"{plate}, {protocol}" for plate in PLATES for protocol in PROTOCOLS),
    *(
        f"{plate}, certified, {protocol}"
        for plate in PLATES
        if "stepped" not in plate
        for protocol in PROTOCOLS
    ),
]


def line_of(case: str) -> Line:
    plate, protocol = case.rsplit(", ", 1)
    certified = plate.endswith(", certified")
    return run_line(
        GAMMA, OMEGA, XI, plate=PLATES[plate.removesuffix(", certified")], carry=protocol == "ramp",
        settle=60, observe=20, keep=12, micro_flight=0.01, certify=certified,
    )  # fmt: skip


@for_each("case", CASES)
def test_the_bytes_are_those_of_this_kernel_version(case):
    line = line_of(case)
    assert line.outcome[0] == Outcome.AT_REST
    assert set(line.outcome[1:]) == {Outcome.PERIODIC}  # or the hash would depend on rounding
    golden = json.loads(FILE.read_text())
    assert golden["kernel_version"] == KERNEL_VERSION, (
        f"KERNEL_VERSION is {KERNEL_VERSION}, {FILE.name} was written by {golden['kernel_version']}: "
        f"run python {Path(__file__).relative_to(GOLDEN.parents[1])}"
    )
    assert digest(line) == golden["sha256"][case], (
        f"the stored bytes of '{case}' changed: raise kernel.params.KERNEL_VERSION, "
        f"then run python {Path(__file__).relative_to(GOLDEN.parents[1])}"
    )


def write() -> None:
    """Write the hashes of this kernel version."""
    hashes = {case: digest(line_of(case)) for case in CASES}
    FILE.write_text(json.dumps({"kernel_version": KERNEL_VERSION, "sha256": hashes}, indent=1) + "\n")


if __name__ == "__main__":
    write()
