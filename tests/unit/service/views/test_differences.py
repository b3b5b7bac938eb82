"""The difference of two sweeps, beside their own maps and thresholds."""

from collections.abc import Iterator

import numpy as np
import pytest
from served import computing
from studies import BASINS, spec_of
from tables import for_each

from service.client import BadRequest, Client, Job, NotFound
from service.views.difference import _away, _sentence

OWN = spec_of((0.6, 3.0, 25), [0.45, 0.5, 0.6, 0.9], [0.1, 0.26], window=(60, 20))
OTHER = spec_of((0.63, 2.63, 12), [0.5, 0.62, 0.7], 0.26, window=(60, 20))
LINE = spec_of((0.6, 3.0, 25), 0.5, 0.26, window=(60, 20), exponents=1)


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    with computing(tmp_path_factory.mktemp("data")) as http:
        yield Client("http://localhost", http=http)


@pytest.fixture(scope="module")
def jobs(client: Client) -> list[Job]:
    """Jobs of OWN, OTHER and LINE."""
    return [client.submit(spec).wait(progress=False) for spec in (OWN, OTHER, LINE)]


def test_cells_are_compared_with_the_nearest_ones_within_the_other_sweep(jobs: list[Job]):
    own, other = (job.modes(xi=0.26, direction="rest") for job in jobs[:2])
    near = other.sel(gamma=own.gamma, omega=own.omega, method="nearest")
    ends = {axis: other[axis].values[[0, -1]] for axis in ("omega", "gamma")}
    within = [(own[axis].values >= low) & (own[axis].values <= high) for axis, (low, high) in ends.items()]
    known = np.logical_and.outer(*within)
    names = ("outcome", "bounces", "periods")
    equal = np.logical_and.reduce([own[name].values == near[name].values for name in names])
    assert 0 < equal[known].mean() < 1
    found = jobs[0].difference(jobs[1].id, xi=0.26)
    np.testing.assert_array_equal(found.differs, np.where(known, ~equal, 2))
    for name in names:
        np.testing.assert_array_equal(found[f"other_{name}"], near[name])
    up, other_up = (job.threshold(xi=0.26, predict="none").up.values for job in jobs[:2])
    moved = abs(up[1] - other_up[0])
    np.testing.assert_allclose(found.up_moved, [np.nan, moved, np.nan, np.nan])
    cells = f"the cells that both have ({known.sum()} of {known.size})"
    share = f"At ξ = 0.26, {100 * equal[known].mean():.4g} % of {cells} have the same mode"
    most = f"no threshold in both moves by more than {moved:.2g} at the 1 of 4 frequencies that both have"
    assert found.attrs["sentence"] == f"{share}; {most}."
    drawn = jobs[0].result_file("difference", "svg", other=jobs[1].id, xi=0.26).decode()
    assert all(f"{part}<" in drawn for part in (f"{share};", f"{most}."))
    assert "rest, where modes differ" in drawn
    thinned = jobs[0].difference(jobs[1].id, xi=0.26, every=3)
    np.testing.assert_array_equal(thinned.differs, found.differs[::3, ::3])
    np.testing.assert_array_equal(thinned.up_moved, found.up_moved[::3])


def test_sweeps_of_other_dampings_and_places_are_compared(client: Client, jobs: list[Job]):
    own, other, line = jobs
    assert (line.difference(own.id).differs == 0).all()
    assert "other_label" not in line.difference(own.id)
    same = "100 % of the cells have the same mode; no threshold in both moves."
    assert line.difference(line.id).attrs["sentence"] == same
    apart = client.submit(OWN | {"gamma": 4.0, "xi": 0.26}).wait(progress=False).difference(other.id)
    assert apart.attrs["sentence"] == "No cell of this sweep is within the axes of the other."
    damped = client.submit(LINE | {"xi": 0.3}).wait(progress=False)
    assert damped.difference(line.id).attrs["sentence"].startswith("At ξ = 0.3 against 0.26, ")
    with pytest.raises(BadRequest, match="xi: must be within the other sweep, which is from"):
        damped.difference(own.id)


def test_a_sweep_is_compared_with_another_sweep_alone(client: Client, jobs: list[Job]):
    with pytest.raises(NotFound):
        jobs[0].difference("0" * 32)
    basin = client.submit(BASINS)
    with pytest.raises(BadRequest, match="other: must be a sweep; the protocol of this job is basin"):
        jobs[0].difference(basin.id)


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
