"""Diagrams, mode maps and trajectories as JSON, diagrams as CSV."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, Final

from numpy.typing import NDArray
from pydantic import TypeAdapter

from kernel.branches.events import Branch
from kernel.numerics.elementary import TWO_PI
from service.results.trajectory import Motion, cycle_energy
from worker import schema

#: The array that tells which cells of an adaptive map were computed.
COMPUTED: Final = schema.COMPUTED.name

#: A value as JSON, ten times as fast as the standard library; NaN and infinities as null.
to_json: Final = TypeAdapter(Any).dump_json

#: Numbers converted at a time: other threads run in between.
NUMBERS: Final = 4096
#: Rows of a table converted at a time.
ROWS: Final = 1024

#: A document is put together once, from pieces: no copies of its lists are in memory beside it.
_Pieces = Iterable[bytes]


def trajectory_json(motion: Motion) -> bytes:
    """A sampled trajectory as a JSON document; null beyond where it could be followed."""
    path, spec = motion.trajectory, motion.spec
    balance = cycle_energy(motion)
    z2 = path.plate + path.gap
    return to_json(
        {
            "gamma": spec.gamma,
            "omega": spec.omega,
            "xi": spec.xi,
            "model": spec.model.model_dump(),
            "rest_length": motion.rest_length,
            "phase": path.phase.tolist(),
            "plate": path.plate.tolist(),
            "z1": (z2 + motion.rest_length + path.elongation).tolist(),
            "z2": z2.tolist(),
            "force": path.force.tolist(),
            "in_flight": path.in_flight.tolist(),
            "flights": {
                "takeoff": path.takeoff.tolist(),
                "takeoff_phase": (path.takeoff % TWO_PI).tolist(),
                "flight_time": path.flight_time.tolist(),
            },
            "energy": None if balance is None else {name: x[0] for name, x in balance._asdict().items()},
            "complete": path.complete,
            "cycle": None if motion.cycle is None else _cycle(motion.cycle),
        }
    )


def _cycle(cycle: Branch) -> dict[str, Any]:
    """A branch of one point."""
    return {
        "bounces": cycle.bounces,
        "periods": cycle.periods,
        "flight_time": float(cycle.flight_time[0]),
        "multipliers": [[float(mu.real), float(mu.imag)] for mu in cycle.multiplier[0]],
        "stable": bool(cycle.stable[0]),
        "admissible": int(cycle.admissible[0]),
    }


def _object(members: Mapping[str, _Pieces], complete: bool, every: int) -> bytes:
    """A JSON object; `every` is left out where it is 1."""
    last = {"complete": [to_json(complete)]} | ({"every": [to_json(every)]} if every > 1 else {})
    return b"".join(_joined(b"{", b"}", (_member(*member) for member in {**members, **last}.items())))


def _member(name: str, value: _Pieces) -> Iterator[bytes]:
    yield b'"%s":' % name.encode()
    yield from value


def _list(array: NDArray[Any]) -> Iterator[bytes]:
    """A JSON list, of lists where the array has rows."""
    step = max(1, NUMBERS // max(1, array[:1].size))
    parts = ([to_json(array[low : low + step].tolist())[1:-1]] for low in range(0, len(array), step))
    return _joined(b"[", b"]", parts)


def _joined(before: bytes, after: bytes, parts: Iterable[_Pieces]) -> Iterator[bytes]:
    """The parts, separated by commas, between two brackets."""
    yield before
    for number, part in enumerate(parts):
        if number:
            yield b","
        yield from part
    yield after
