"""Claims of captions on data made for them: what agrees, what contradicts, and the bounds between."""

from collections.abc import Sequence

import numpy as np
import xarray

from kernel.params import Outcome
from service.figures.flights import compare


def modes(*pairs: tuple[int, int], times: Sequence[Sequence[float]], periodic: bool = True) -> xarray.Dataset:
    """A bifurcation diagram; of its variables those that a claim is about."""
    outcome = Outcome.PERIODIC if periodic else Outcome.APERIODIC
    bounces, periods = np.transpose(pairs)
    cells = {"outcome": np.full(len(pairs), outcome), "bounces": bounces, "periods": periods}
    variables = {name: ("gamma", each) for name, each in cells.items()}
    return xarray.Dataset(variables | {"flight_time": (("gamma", "flight"), np.array(times))})


def test_cycles_are_compared_cell_by_cell_where_both_are_periodic():
    times = [[9.0, 1.0, 2.0], [3.0, np.nan, np.nan], [1.0, 1.0, np.nan], [4.0, 4.0, np.nan]]
    others = [[7.0, 2.0, 1.5], [3.25, np.nan, np.nan], [1.0, 1.0, np.nan], [4.0, 4.0, np.nan]]
    first = modes((2, 2), (1, 1), (2, 1), (1, 1), times=times)
    second = modes((2, 2), (1, 1), (2, 2), (2, 1), times=others)
    compared = compare(first, second)
    assert (compared.periodic, compared.same) == (4, 2)
    assert compared.deviations.tolist() == [0.5, 0.25]  # in the order of the times within a cycle, too
    assert str(compared) == "2 of 4 periodic cells are in the same mode"
    aperiodic = modes((2, 2), (1, 1), (2, 1), (1, 1), times=times, periodic=False)
    assert compare(first, aperiodic)[:2] == compare(aperiodic, first)[:2] == (0, 0)
