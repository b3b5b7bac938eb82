"""The paper's figures, start to end."""

import re
import subprocess
import sys
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest

from kernel.params import Outcome
from service import embedded, figures
from service.client import Client
from service.settings import Settings
from worker.executors import Dask
from worker.spec import SweepSpec


def test_every_figure_is_listed_by_its_number_with_valid_sweeps():
    for number, figure in figures.FIGURES.items():
        assert figure.number == number
        assert figure.title
        assert all(SweepSpec.parse(dict(sweep)).name == f"figure {number}" for sweep in figure.sweeps)


def test_an_unknown_figure_names_those_there_are():
    with pytest.raises(figures.UnknownFigure, match=r"no figure 10 here; there are: 2"):
        figures.figure(10)


def test_figure_2_has_the_papers_modes(cluster: Dask, tmp_path: Path):
    settings = Settings(data=tmp_path, port=0)
    with embedded.running(settings, cluster) as url, Client(url) as client:
        picture = figures.figure(2).make(client, progress=False)
        (job,) = client.jobs()
        diagram = job.diagram()
    assert picture.startswith(b"\x89PNG")
    modes = {
        gamma: (int(cell.bounces), int(cell.periods))
        for gamma in (1.5, 2.3, 3.6)
        for cell in [diagram.sel(gamma=gamma, method="nearest")]
    }
    assert modes == {1.5: (1, 1), 2.3: (2, 2), 3.6: (1, 2)}
    assert int(diagram.outcome.sel(gamma=5.0, method="nearest")) == Outcome.APERIODIC
    # No small hops after a landing: what is short is the tail of a branch that ends at zero.
    assert np.mean(diagram.flight_time.values < 0.1) < 1e-3


@pytest.mark.timeout(240)
def test_the_first_command_of_the_readme_draws_figure_2(tmp_path: Path, cluster: Dask):
    bounce = str(Path(sys.executable).with_name("bounce"))
    first, second = (
        subprocess.run(
            [bounce, "figure", "2", "-o", name],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=200,
            check=False,
        )
        for name in ("figure-2.png", "again.svg")
    )
    assert first.returncode == 0, first.stderr
    assert re.search(r"figure 2: done, 100% \(1,001 of 1,001 cells\)", first.stderr)
    assert first.stdout == ""
    picture = matplotlib.image.imread(tmp_path / "figure-2.png")
    assert picture.shape[0] > 500
    assert 0.02 < np.mean(picture[..., :3].mean(axis=2) < 0.5) < 0.5  # ink, and not too much of it

    # The second run finds the job done: not one line says that anything runs.
    assert second.returncode == 0, second.stderr
    assert "running" not in second.stderr
    assert b"<svg" in (tmp_path / "again.svg").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["again.svg", "bounce-data", "figure-2.png"]
