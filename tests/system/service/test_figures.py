"""Figures 1 and 2 and the notebooks from start to end; the other figures are in tests/nightly."""

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
from drawn_figures import DRAWN, SMALL_FIGURES, Pictures
from paths import ROOT
from scripted import DEADLINE
from served import service_at

from service.cli.main import main
from service.client import Client
from service.figures import catalogue
from worker.executors.dask import Dask

#: The figures of this tier.
EARLY = (1, 2)


@pytest.fixture(scope="module")
def client(cluster: Dask, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    with service_at(tmp_path_factory.mktemp("figures"), cluster) as url, Client(url) as client:
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
