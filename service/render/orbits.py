"""Closed-form cycles as JSON: branches, events, curves. Null stands for a number there is not."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from kernel.branches.energy import Energy, word_energy
from kernel.branches.events import Events
from service.results.orbits import EventCurves, Orbits, WordOrbits

#: NaN and infinities become null.
to_json: Final = TypeAdapter(Any).dump_json

#: Fields of a branch with a number per point.
_PER_POINT: Final = (
    "gamma", "flight_time", "takeoff_phase", "elongation", "elongation_velocity", "impact_velocity",
    "stable", "admissible",
)  # fmt: skip

#: Fields of a branch of a word with a number per point and flight.
_PER_FLIGHT: Final = ("flight_time", "takeoff_phase", "impact_velocity")


def orbits_json(orbits: Orbits, energies: bool) -> bytes:
    """Branches and events of one spring; with `energies` of every point as well."""
    branches = []
    for branch, energy in zip(orbits.branches, orbits.energy, strict=True):
        members: dict[str, Any] = {"bounces": branch.bounces, "periods": branch.periods}
        members |= {name: getattr(branch, name).tolist() for name in _PER_POINT}
        members["multipliers"] = _multipliers(branch.multiplier)
        if energies:
            members["energy"] = _lists(energy)
        branches.append(members)
    return to_json(
        {
            "omega": orbits.omega,
            "xi": orbits.xi,
            "gamma_max": orbits.gamma_max,
            "branches": branches,
            "events": _events(orbits.events),
        }
    )


def words_json(orbits: WordOrbits, energies: bool) -> bytes:
    """Branches of words with a list of flights per point, their events, and the cells left out."""
    branches = [
        {
            "word": branch.word,
            "bounces": len(branch.word),
            "periods": branch.periods,
            "gamma": branch.gamma.tolist(),
            **{name: getattr(branch, name).tolist() for name in _PER_FLIGHT},
            "stable": branch.stable.tolist(),
            "admissible": branch.admissible.tolist(),
            "multipliers": _multipliers(branch.multiplier),
            **({"energy": _lists(word_energy(branch))} if energies else {}),
        }
        for branch in orbits.found.branches
    ]
    return to_json(
        {
            "omega": orbits.omega,
            "xi": orbits.xi,
            "direction": orbits.direction,
            "gamma_max": orbits.gamma_max,
            "branches": branches,
            "events": [
                {"branch": i, **event}
                for i, events in enumerate(orbits.found.events)
                for event in _events(events)
            ],
            "skipped": [skipped._asdict() for skipped in orbits.found.skipped],
            "complete": orbits.complete,
        }
    )


def curves_json(curves: EventCurves) -> bytes:
    """Curves over omega or xi, and the points at which they meet or turn."""
    other = "xi" if curves.parameter == "omega" else "omega"
    return to_json(
        {
            other: curves.fixed,
            "along": curves.parameter,
            "curves": [
                {
                    "kind": str(curve.kind),
                    "bounces": curve.bounces,
                    "periods": curve.periods,
                    **{
                        name: getattr(curve, name).tolist()
                        for name in (curves.parameter, "gamma", "flight_time", "admissible")
                    },
                }
                for curve in curves.curves
            ],
            "points": _events(curves.points),
        }
    )


def _events(events: Events) -> list[dict[str, Any]]:
    """An object per event."""
    columns = {
        name: getattr(events, name).tolist()
        for name in ("kind", "gamma", "omega", "xi", "bounces", "periods", "flight_time", "admissible")
    }
    columns["multipliers"] = _multipliers(events.multiplier)
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _multipliers(multiplier: NDArray[np.complex128]) -> list[Any]:
    """Of every cycle, both multipliers as [real part, imaginary part]."""
    parts: list[Any] = np.stack([multiplier.real, multiplier.imag], axis=-1).tolist()
    return parts


def _lists(energy: Energy) -> dict[str, list[float]]:
    """The balances of the cycles of a branch."""
    return {name: values.tolist() for name, values in energy._asdict().items()}
