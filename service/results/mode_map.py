"""Mode maps: outcome and mode of the cells of an (Ω, Γ) plane at one ξ and direction."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from kernel.params import Outcome
from service.results.selection import Sweep, check_points, nearest_index, read, resolve_direction, thinning
from worker import schema

#: The stored arrays that tell a cell's mode.
MODE_ARRAYS: Final = (schema.OUTCOME.name, "bounces", "periods")


@dataclass(frozen=True)
class Plane:
    """Stored arrays over (omega, gamma) at one xi and direction."""

    xi: float
    direction: str
    omega: NDArray[np.float64]
    gamma: NDArray[np.float64]
    arrays: Mapping[str, NDArray[Any]]  # each (n_omega, n_gamma)
    every: int = 1  # the cells are every n-th of both axes

    @property
    def complete(self) -> bool:
        """Whether every cell is computed."""
        return bool(np.all(self.arrays["outcome"] != Outcome.MISSING))


def modes(sweep: Sweep, xi: float | None, direction: str | None, max_points: int, every: int = 1) -> Plane:
    """The mode map at the grid's xi nearest to `xi`, every n-th cell of both axes.

    Raises InvalidRequest as `selection.nearest_index`, TooLarge for more than `max_points` cells.
    """
    lengths = [len(sweep.spec.axis_values(axis)) for axis in ("omega", "gamma")]
    omegas, gammas = (-(-n // every) for n in lengths)
    what = f"{omegas:,} values of omega × {gammas:,} of gamma"
    check_points(omegas * gammas, max_points, what, thinning(lengths, 1, max_points))
    part = slice(None, None, every)
    cells = plane(sweep, xi, resolve_direction(sweep.spec, direction), MODE_ARRAYS, part, part)
    return replace(cells, every=every)


def modes_between(
    sweep: Sweep,
    xi: float | None,
    direction: str | None,
    gamma: tuple[float | None, float | None],
    omega: tuple[float | None, float | None],
    max_points: int,
) -> Plane:
    """The mode map between two values of gamma and of omega; None is the end of the axis.

    Thinned to at most `max_points` cells. Raises InvalidRequest as `selection.nearest_index`.
    """
    columns = _between(sweep.spec.axis_values("gamma"), *gamma)
    rows = _between(sweep.spec.axis_values("omega"), *omega)
    every = thinning((len(rows), len(columns)), 1, max_points) or 1
    part = (slice(rows.start, rows.stop, every), slice(columns.start, columns.stop, every))
    cells = plane(sweep, xi, resolve_direction(sweep.spec, direction), MODE_ARRAYS, *part)
    return replace(cells, every=every)


def plane(
    sweep: Sweep,
    xi: float | None,
    direction: str,
    names: tuple[str, ...],
    omega: slice = slice(None),
    gamma: slice = slice(None),
) -> Plane:
    """The named arrays over a part of (omega, gamma) at the grid's xi nearest to `xi`.

    Raises InvalidRequest as `selection.nearest_index`.
    """
    spec = sweep.spec
    point = nearest_index(spec, "xi", xi)
    arrays = read(sweep, names, direction, {"xi": point.index, "omega": omega, "gamma": gamma})
    omegas, gammas = spec.axis_values("omega")[omega], spec.axis_values("gamma")[gamma]
    return Plane(point.value, direction, omegas, gammas, arrays)


def _between(values: NDArray[np.float64], low: float | None, high: float | None) -> range:
    """Indices of the values between two; of the one nearest to their middle if there are none."""
    first, last = float(values[0]) if low is None else low, float(values[-1]) if high is None else high
    start = int(np.searchsorted(values, first, side="left"))
    stop = int(np.searchsorted(values, last, side="right"))
    nearest = int(np.argmin(np.abs(values - 0.5 * (first + last))))
    return range(start, stop) if start < stop else range(nearest, nearest + 1)
