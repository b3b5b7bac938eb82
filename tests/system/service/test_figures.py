"""Figures 1 and 2 and the notebooks from start to end; the other figures are in tests/nightly."""

import io
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from artists import difference
from click.testing import CliRunner
from drawn_figures import (
    DRAWN,
    SMALL_FIGURES,
    Pictures,
    agreeing,
    contradicting,
    diagram,
    leaving_open,
)
from paths import ROOT
from PIL import Image
from scripted import DEADLINE

from kernel.params import Outcome
from service import presets
from service.cli.main import main
from service.client import Client
from service.figures import canvas, catalogue
from service.server import embedded
from service.settings import Settings
from worker.executors.dask import Dask

#: The figures of this tier.
EARLY = (1, 2)


@pytest.fixture(scope="module")
def client(cluster: Dask, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    settings = Settings(data=tmp_path_factory.mktemp("figures"), port=0)
    with embedded.running(settings, cluster) as url, Client(url) as client:
        yield client


@pytest.fixture(scope="module")
def pictures(client: Client) -> Pictures:
    """Every figure, drawn from small grids."""
    return Pictures(client)


@pytest.mark.parametrize("number", EARLY)
def test_a_figure_draws_and_says_what_it_did(pictures: Pictures, number: int):
    golden = json.loads(DRAWN.read_text())["figures"][str(number)]
    assert str(pictures[number].caption).splitlines() == golden["caption"]
    assert difference(pictures[number].drawn, golden["drawn"]) == ""


@pytest.mark.parametrize("number", EARLY)
def test_axes_have_minor_ticks(pictures: Pictures, number: int):
    """But for those of the schematics, which are not shown, and of the four motions."""
    found = pictures[number].minor_ticks
    assert found == {1: [False] * 2, 2: [True] + [False] * 4}[number]


def test_the_sweeps_of_all_figures_are_submitted_before_one_is_drawn(client: Client):
    later = {"name": "submitted early", "gamma": [1.0], "omega": 0.5, "xi": 0.26}
    selected = [SMALL_FIGURES[1], SMALL_FIGURES[6]._replace(sweeps=(later,))]
    next(catalogue.make(selected, client, "svg", progress=False))
    assert [job.name for job in client.jobs(search="submitted early")] == ["submitted early"]


@pytest.mark.parametrize("number", EARLY)
def test_picture_has_ink_a_caption_and_a_reasonable_size(pictures: Pictures, number: int):
    content, caption = pictures[number].content, pictures[number].caption
    assert content.startswith(b"\x89PNG")
    assert len(content) < 150_000
    image = Image.open(io.BytesIO(content))
    assert image.text["Description"] == str(caption)
    assert image.width == pytest.approx(canvas.WIDTH * canvas.DPI, abs=1)
    grey = np.asarray(image.convert("L"))
    assert 0.01 < np.mean(grey < 128) < 0.4
    assert np.all(grey[:, -2:] == 255)  # nothing is cut off on the right
    assert caption.number == number
    assert agreeing(caption)
    assert contradicting(caption) or leaving_open(caption)


def test_fig_2_has_the_papers_modes_from_rest(client: Client, pictures: Pictures):
    of_figure_2 = diagram(client, 2)
    modes = {
        gamma: (int(cell.bounces), int(cell.periods))
        for gamma in (1.5, 2.3, 3.6)
        for cell in [of_figure_2.sel(gamma=gamma, method="nearest")]
    }
    assert modes == {1.5: (1, 1), 2.3: (2, 2), 3.6: (1, 2)}
    assert int(of_figure_2.outcome.sel(gamma=5.0, method="nearest")) == Outcome.APERIODIC
    # No small hops after a landing: what is short is the tail of a branch that ends at zero.
    assert np.mean(of_figure_2.flight_time.values < 0.1) < 1e-2
    expected = "(1, 1) at Γ = 1.5; (2, 2) at Γ = 2.3; (1, 2) at Γ = 3.6; aperiodic at Γ = 5.0"
    assert agreeing(pictures[2].caption).startswith(expected)


def test_fig_2_on_the_ramp_is_not_in_the_mode_it_has_from_rest(client: Client, pictures: Pictures):
    cell = diagram(client, 2, sweep=1).sel(gamma=3.6, method="nearest")
    assert (int(cell.bounces), int(cell.periods)) != (1, 2)
    assert "at Γ = 3.6, when Γ is ramped up" in contradicting(pictures[2].caption)


def test_motion_takes_off_as_long_as_the_diagram_says(client: Client, pictures: Pictures):
    cell = {"gamma": 1.5, "omega": 0.5, "xi": 0.26, "model": presets.SOFT}
    motion = client.trajectory({**cell, "settle": 200, "periods": 4, "samples": 50})
    assert motion.sizes["phase"] == 201
    np.testing.assert_allclose(
        motion.flight_time, 4.855013427295, atol=3e-3
    )  # docs/model.md, section 5, on an ideal plate
    np.testing.assert_allclose(motion.plate, np.cos(motion.phase), atol=1e-12)
    assert float(((motion.z2 - motion.plate) * motion.in_flight).min()) >= -1e-9


def test_all_figures_go_into_a_folder_with_their_captions(
    client: Client, pictures: Pictures, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(catalogue, "FIGURES", {n: SMALL_FIGURES[n] for n in (1, 6)})
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(main, ["figure", "all", "-o", "new/folder", "--url", client.url])
    assert done.exit_code == 0, done.stderr
    assert sorted(path.name for path in Path("new/folder").iterdir()) == ["figure-1.png", "figure-6.png"]
    assert Path("new/folder/figure-6.png").read_bytes() == pictures[6].content
    assert str(pictures[6].caption) in done.stderr
    assert done.stdout == ""


def test_the_first_command_of_the_readme_draws_figure_2(tmp_path: Path, cluster: Dask):
    bounce = str(Path(sys.executable).with_name("bounce"))
    first, second = (
        subprocess.run(
            [bounce, "figure", "2", "-o", name],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=DEADLINE,
            check=False,
        )
        for name in ("figure-2.png", "again.svg")
    )
    assert first.returncode == 0, first.stderr
    assert re.search(r"figure 2: done, 100% \(1,001 of 1,001 cells\)", first.stderr)
    assert "\nAgrees: (1, 1) at Γ = 1.5" in first.stderr
    assert first.stdout == ""
    picture = matplotlib.image.imread(tmp_path / "figure-2.png")
    assert picture.shape[0] > 500
    assert 0.02 < np.mean(picture[..., :3].mean(axis=2) < 0.5) < 0.5  # ink, and not too much of it

    # The second run finds the jobs done: it reports no running job.
    assert second.returncode == 0, second.stderr
    assert "running" not in second.stderr
    assert b"<svg" in (tmp_path / "again.svg").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["again.svg", "bounce-data", "figure-2.png"]


NOTEBOOKS = sorted((ROOT / "examples").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs_from_submission_to_a_figure(
    client: Client, path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    from matplotlib import pyplot as plt

    monkeypatch.setenv("BOUNCE_URL", client.url)
    plt.switch_backend("agg")
    names: dict[str, Any] = {}
    cells = [cell for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == "code"]
    for number, cell in enumerate(cells, start=1):
        exec(compile("".join(cell["source"]), f"{path.name}, cell {number}", "exec"), names)
    drawn = plt.get_fignums()
    plt.close("all")
    printed = [line for cell in cells for output in cell["outputs"] for line in output.get("text", [])]
    assert len(drawn) >= 2
    assert capsys.readouterr().out == "".join(printed)  # what the notebook shows is what it does
