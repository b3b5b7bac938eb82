"""The difference of two sweeps, beside their own maps and thresholds."""

from pathlib import Path

import numpy as np
import pytest
from served import computing
from studies import BASINS, spec_of
from tables import for_each

from service.client import BadRequest, Client, NotFound
from service.views.difference import _away, _sentence


def test_cells_are_compared_with_the_nearest_ones_within_the_other_sweep(tmp_path: Path):
    own = spec_of((0.6, 3.0, 25), [0.45, 0.5, 0.6, 0.9], [0.1, 0.26], window=(60, 20))
    other = spec_of((0.63, 2.63, 12), [0.5, 0.62, 0.7], 0.26, window=(60, 20))
    line = spec_of((0.6, 3.0, 25), 0.5, 0.26, window=(60, 20), exponents=1)
    with computing(tmp_path) as http:
        client = Client("http://localhost", http=http)
        first, second, third = (client.submit(spec).wait(progress=False) for spec in (own, other, line))
        found = first.difference(second.id, xi=0.26)
        maps = [job.modes(xi=0.26, direction="rest") for job in (first, second)]
        ends = [job.threshold(xi=0.26, predict="none").up.values for job in (first, second)]
        alone = third.difference(first.id)
        same = third.difference(third.id)
        more = client.submit(line | {"xi": 0.3}).wait(progress=False)
        damped = more.difference(third.id)
        with pytest.raises(BadRequest, match="xi: must be within the other sweep, which is from"):
            more.difference(first.id)
        thinned = first.difference(second.id, xi=0.26, every=3)
        apart = client.submit(own | {"gamma": 4.0, "xi": 0.26}).wait(progress=False).difference(second.id)
        drawn = first.result_file("difference", "svg", other=second.id, xi=0.26).decode()
        with pytest.raises(NotFound):
            first.difference("0" * 32)
        basin = client.submit(BASINS)
        with pytest.raises(BadRequest, match="other: must be a sweep; the protocol of this job is basin"):
            first.difference(basin.id)
    near = maps[1].sel(gamma=maps[0].gamma, omega=maps[0].omega, method="nearest")
    omega, gamma = (
        (maps[0][axis].values >= maps[1][axis].values[0]) & (maps[0][axis].values <= maps[1][axis].values[-1])
        for axis in ("omega", "gamma")
    )
    known = np.logical_and.outer(omega, gamma)
    names = ("outcome", "bounces", "periods")
    equal = np.logical_and.reduce([maps[0][name].values == near[name].values for name in names])
    assert 0 < equal[known].mean() < 1
    np.testing.assert_array_equal(found.differs, np.where(known, ~equal, 2))
    for name in names:
        np.testing.assert_array_equal(found[f"other_{name}"], near[name])
    moved = abs(ends[0][1] - ends[1][0])
    np.testing.assert_allclose(found.up_moved, [np.nan, moved, np.nan, np.nan])
    cells = "the cells" if known.all() else f"the cells that both have ({known.sum()} of {known.size})"
    share = f"At ξ = 0.26, {100 * equal[known].mean():.4g} % of {cells} have the same mode"
    most = f"no threshold in both moves by more than {moved:.2g} at the 1 of 4 frequencies that both have"
    assert found.attrs["sentence"] == f"{share}; {most}."
    assert all(f"{part}<" in drawn for part in (f"{share};", f"{most}."))
    assert "rest, where modes differ" in drawn
    np.testing.assert_array_equal(thinned.differs, found.differs[::3, ::3])
    np.testing.assert_array_equal(thinned.up_moved, found.up_moved[::3])
    assert apart.attrs["sentence"] == "No cell of this sweep is within the axes of the other."
    assert (alone.differs == 0).all()
    assert "other_label" not in alone
    assert damped.attrs["sentence"].startswith("At ξ = 0.3 against 0.26, ")
    assert same.attrs["sentence"] == "100 % of the cells have the same mode; no threshold in both moves."


def test_the_rounding_of_a_grid_is_no_move():
    assert _away(np.array([0.1 + 0.2, 0.5]), np.array([0.3, 0.75])).tolist() == [0.0, 0.25]


@for_each(("moved", "bound"), [(0.0134, "0.014"), (1.213 - 1.2, "0.013"), (0.0991, "0.1"), (123.0, "130")])
def test_the_sentence_does_not_say_too_much(moved: float, bound: str):
    """Of 20,001 cells one differs; a threshold moves by `moved`, and one is found in one sweep alone."""
    same = np.arange(20_001) > 0
    found = _sentence(same, np.ones_like(same), {"up_moved": np.array([moved, np.nan])}, np.ones(2, bool))
    share = "99.99 % of the cells have the same mode"
    assert found == f"{share}; no threshold in both moves by more than {bound}."
    found = _sentence(same, same, {"up_moved": np.array([np.nan])}, np.array([False]))
    assert found.endswith("; no frequency is in both.")
