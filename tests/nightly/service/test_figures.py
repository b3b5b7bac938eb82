"""The figures of the paper from start to end, and their captions against the numbers of docs/model.md.

Figures 1 and 2 are in tests/system. What each figure draws and says has to be what tests/golden/figures.json
holds; `python tests/nightly/service/test_figures.py` writes that file anew, after a look at the figures. Some
cells are chaotic: where another C library rounds otherwise, their dots lie elsewhere.
"""

import io
import json
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).parents[2] / "support"), str(Path(__file__).parents[3])]

    from paths import CACHE

    from worker.kernel_cache import use_cache

    use_cache(CACHE)  # before kernels are declared below

from artists import difference
from drawn_figures import (
    DESCENDING,
    DRAWN,
    SMALL,
    SMALL_FIGURES,
    Pictures,
    agreeing,
    contradicting,
    diagram,
    leaving_open,
)
from paths import CACHE, ROOT
from PIL import Image

from kernel.params import Outcome
from kernel.restitution import restitution_of
from kernel.threshold import threshold
from service import presets
from service.client import Client
from service.figures import catalogue
from service.figures.drawing import WIDTH
from service.server import embedded
from service.settings import Settings
from service.views.style import DPI
from worker.executors.dask import Dask

#: The figures of this tier.
LATER = (3, 4, 5, 6, 7, 8, 9)


@pytest.fixture(scope="module")
def client(cluster: Dask, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    settings = Settings(data=tmp_path_factory.mktemp("figures"), port=0)
    with embedded.running(settings, cluster) as url, Client(url) as client:
        yield client


@pytest.fixture(scope="module")
def pictures(client: Client) -> Pictures:
    """Every figure, drawn from small grids."""
    return Pictures(client)


@pytest.mark.parametrize("number", LATER)
def test_a_figure_draws_and_says_what_it_did(pictures: Pictures, number: int):
    golden = json.loads(DRAWN.read_text())["figures"][str(number)]
    assert str(pictures[number].caption).splitlines() == golden["caption"]
    assert difference(pictures[number].drawn, golden["drawn"]) == ""


@pytest.mark.parametrize("number", LATER)
def test_picture_has_ink_a_caption_and_a_reasonable_size(pictures: Pictures, number: int):
    content, caption = pictures[number].content, pictures[number].caption
    assert content.startswith(b"\x89PNG")
    assert len(content) < 200_000
    image = Image.open(io.BytesIO(content))
    assert image.text["Description"] == str(caption)
    assert image.width == pytest.approx(WIDTH * DPI, abs=1)
    grey = np.asarray(image.convert("L"))
    assert 0.01 < np.mean(grey < 128) < 0.4
    assert np.all(grey[:, -2:] == 255)  # nothing is cut off on the right
    assert caption.number == number
    assert agreeing(caption)
    assert contradicting(caption) or leaving_open(caption)


@pytest.mark.parametrize("number", [4, 9])
def test_svg_holds_letters_as_text_and_dots_as_an_image(client: Client, pictures: Pictures, number: int):
    figure = SMALL_FIGURES[number]
    first, again = (x.encoded("svg") for x in catalogue.make([figure, figure], client, progress=False))
    content = first.decode()
    assert first == again
    assert "<svg" in content
    assert "<text" in content
    assert ("<image" in content) == (number == 4)


def test_fig_3_spring_and_ball_agree(pictures: Pictures):
    agrees, open_ = agreeing(pictures[3].caption), leaving_open(pictures[3].caption)
    same, periodic = map(int, re.findall(r"(\d+) of (\d+) periodic cells", agrees)[0])
    assert same == periodic > 50
    assert float(re.findall(r"([\d.]+) rad apart", agrees)[0]) < 0.05
    same, periodic = map(int, re.findall(r"(\d+) of (\d+) periodic cells", open_)[0])
    assert same < 0.5 * periodic  # on a contact softer than the spring


def test_fig_4_names_the_springs_own_restitution(pictures: Pictures):
    assert float(restitution_of(np.array([0.5]))[0]) == pytest.approx(0.1492, abs=5e-5)
    open_ = leaving_open(pictures[4].caption)
    assert "f(0.5) = 0.1492" in open_
    own, printed = map(float, re.findall(r"median ([\d.]+) rad instead of ([\d.]+)", open_)[0])
    assert own < printed < 0.05
    assert "forbidden zones: for Γ = 4.7 to 5.3" in agreeing(pictures[4].caption)


def test_fig_5_onsets_lie_on_eq_25_which_is_not_1(client: Client, pictures: Pictures):
    job = client.submit(SMALL_FIGURES[5].sweeps[0])
    for xi in presets.DAMPINGS:
        onset = job.threshold(xi=xi)
        np.testing.assert_allclose(onset.up, onset.analytic, rtol=0.01)
    caption = pictures[5].caption
    assert "at most 0." in agreeing(caption)
    assert "0.935 at Ω = 0.632" in contradicting(caption)
    assert "1.599 at Ω = 4" in contradicting(caption)


def test_fig_5_has_the_maxima_of_eq_25_and_not_its_values_at_the_root_of_two(pictures: Pictures):
    # docs/model.md, section 5: the maximum is 7.29511 at 1.43529 for ξ = 0.05; √(1 + 1/8ξ²) is 7.14 there.
    open_ = leaving_open(pictures[5].caption)
    assert "a maximum, 7.295 at Ω = 1.4353 (ξ = 0.05) and 2.48 at Ω = 1.7601 (ξ = 0.2)" in open_
    assert "7.14" not in str(pictures[5].caption)
    grid = np.linspace(1.0, 4.0, 30_001)
    for xi, gamma, omega in ((0.05, 7.295, 1.4353), (0.2, 2.48, 1.7601)):
        at = int(np.argmax(threshold(grid, xi)))
        assert threshold(grid[at], xi) == pytest.approx(gamma, abs=5e-3)
        assert grid[at] == pytest.approx(omega, abs=1e-4)


def test_fig_5_says_how_far_off_the_printed_equations_are(pictures: Pictures):
    contradicts = contradicting(pictures[5].caption)
    assert "Eq. 22 as printed" in contradicts
    # The denominator of Eq. 24 is below zero between its roots, about Ω = 1 and √2.
    assert re.search(r"off by π from Ω = 1\.0\d to 1\.(39|4)", contradicts)


def test_fig_6_has_models_minimum(pictures: Pictures):
    assert "0.1941 at Ω = 0.9928" in agreeing(pictures[6].caption)
    # The maximum is at 1.43529 (docs/model.md, section 5).
    assert "beyond Ω = 1.44" in leaving_open(pictures[6].caption)


def test_fig_9_names_the_maximum_outside_its_frame(pictures: Pictures):
    assert "120 plate periods" in pictures[9].caption.shows
    assert "7.3 at Ω = 1.435" in pictures[9].caption.shows  # 7.29511 at 1.43529 (docs/model.md, section 5)


def test_fig_7_is_quasi_periodic_around_four_and_not_chaotic_at_two(client: Client, pictures: Pictures):
    agrees, contradicts = agreeing(pictures[7].caption), contradicting(pictures[7].caption)
    assert "(a) is chaotic beyond Γ ≈ 2." in agrees
    near_four = (
        r"\(b\) is hardly chaotic around Γ = 4: (\d+) % of the cells within 0.25 are, and (\d+) % are quasi"
    )
    chaotic, tori = map(int, re.findall(near_four, contradicts)[0])
    assert chaotic < tori
    assert "(c) is not chaotic" in agrees
    assert "(b) is not chaotic" in contradicts
    assert "they repeat as (4, 4), (3, 4), (2, 2)" in contradicts
    *_, hardly_elastic, elastic = range(len(SMALL_FIGURES[7].sweeps))
    for sweep in range(2, hardly_elastic):
        assert np.mean(diagram(client, 7, sweep).outcome == Outcome.APERIODIC) < 0.2
    assert np.mean(diagram(client, 7, hardly_elastic).outcome == Outcome.APERIODIC) > 0.2
    assert np.mean(diagram(client, 7, elastic).outcome == Outcome.APERIODIC) > 0.5
    # docs/model.md, section 5: on an ideal plate (3, 4) at Γ = 2 and (1, 2) at Γ = 3 from rest; the former
    # occurs here too.
    cell = diagram(client, 7, sweep=2).sel(gamma=2.0, method="nearest")
    assert (int(cell.bounces), int(cell.periods)) == (3, 4)
    np.testing.assert_allclose(
        np.sort(np.unique(np.round(cell.flight_time.values, 6))),
        [1.841623253802, 4.885760696436, 5.084577776933],
        atol=0.02,
    )


def test_fig_8_is_chaotic_at_low_frequency_only_when_shaken_hard(pictures: Pictures):
    agrees, contradicts = agreeing(pictures[8].caption), contradicting(pictures[8].caption)
    assert "at Γ = 2 low Ω is chaotic" in agrees
    assert "at Γ = 3 low Ω is chaotic" in agrees
    assert "at Γ = 1 low Ω is not chaotic" in contradicts


def test_fig_9_descends_to_models_thresholds(client: Client, pictures: Pictures):
    loop = client.submit(SMALL_FIGURES[9].sweeps[0]).threshold(xi=0.05)
    for omega, gamma in DESCENDING.items():
        assert float(loop.down.sel(omega=omega)) == pytest.approx(gamma, abs=0.006)
    np.testing.assert_allclose(loop.up, loop.analytic, atol=0.006)
    assert "Ω = 0.62: down to Γ = 0.5" in agreeing(pictures[9].caption)


def write() -> None:
    """Write what each figure draws and says, as it is now."""
    with (
        tempfile.TemporaryDirectory() as folder,
        closing(Dask(workers=2, kernel_cache=CACHE)) as executor,
        embedded.running(Settings(data=Path(folder), port=0), executor) as url,
        Client(url) as client,
    ):
        pictures = Pictures(client)
        figures = {
            str(number): {
                "caption": str(pictures[number].caption).splitlines(),
                "drawn": pictures[number].drawn,
            }
            for number in SMALL
        }
    source = f"what the artists of each figure draw, read back by python {Path(__file__).relative_to(ROOT)}"
    DRAWN.write_text(json.dumps({"source": source, "figures": figures}, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    write()
