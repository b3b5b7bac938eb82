"""The figures of the paper from start to end, and their captions against the numbers of docs/model.md.

What each figure draws and says has to be what tests/golden/figures.json holds;
`python tests/service/test_figures.py` writes that file anew, after a look at the figures. Some cells are
chaotic: where another C library rounds otherwise, their dots lie elsewhere.
"""

import io
import json
import re
import subprocess
import sys
import tempfile
from collections import UserDict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.image
import numpy as np
import pytest

if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).parents[1] / "support"), str(Path(__file__).parents[2])]

    from paths import CACHE

    from worker.kernel_cache import warm

    warm(CACHE)  # before kernels are declared below

from artists import difference, read_back
from click.testing import CliRunner
from matplotlib.ticker import AutoMinorLocator
from paths import CACHE, GOLDEN, ROOT
from PIL import Image
from scripted import DEADLINE

from kernel.branches.thresholds import thresholds
from kernel.params import Outcome
from kernel.restitution import restitution_of
from kernel.threshold import threshold
from service import presets
from service.cli.main import main
from service.client import Client
from service.figures import ball, canvas, catalogue, hysteresis
from service.figures.caption import Caption, Verdict, compared, left_open
from service.figures.catalogue import Figure
from service.server import embedded
from service.settings import Settings
from worker.executors.dask import Dask
from worker.spec import SweepSpec

#: docs/model.md, section 5: the last Γ that bounces on the way down, by Ω.
DESCENDING = {0.56: 0.743, 0.6: 0.554, 0.62: 0.508, 0.66: 0.6, 0.7: 0.671}

#: What makes each figure small enough for a test, its cells still the paper's.
SMALL: Mapping[int, Mapping[str, Any]] = {
    1: {},
    2: {"gamma": {"start": 1.0, "stop": 6.0, "num": 101}},
    3: {"gamma": {"start": 1.0, "stop": 7.0, "num": 61}},
    4: {"gamma": {"start": 1.0, "stop": 7.0, "num": 121}},
    5: {"omega": [0.4, 0.63, 1.0, 1.2, 2.0]},
    6: {},
    7: {"gamma": {"start": 0.05, "stop": 6.0, "num": 120}},
    8: {"omega": {"start": 0.05, "stop": 2.0, "num": 79}},
    9: {"omega": [0.42, 0.44, 0.46, *DESCENDING], "gamma": {"start": 0.1, "stop": 1.6, "num": 376}},
}
#: The fold of (1,1) at Ω = 0.6, ξ = 0.05: docs/hysteresis.md.
FOLD_060 = 0.5532446
#: What each figure draws from these cells.
DRAWN = GOLDEN / "figures.json"
#: Frequencies of ramps that start on a cycle.
SEEDED = (0.33, 0.44, 0.6, 0.62, 0.7)
NEAR_TWO = {"gamma": {**presets.GAMMA_NEAR_TWO, "num": 9}}


def small(figure: Figure) -> Figure:
    """The figure with fewer cells."""
    changed = SMALL[figure.number]
    return replace(
        figure,
        sweeps=tuple(
            {**sweep, **(NEAR_TWO if sweep["gamma"] == presets.GAMMA_NEAR_TWO else changed)}
            for sweep in figure.sweeps
        ),
    )


SMALL_FIGURES = {number: small(figure) for number, figure in catalogue.FIGURES.items()}


@pytest.fixture(scope="module")
def client(cluster: Dask, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    settings = Settings(data=tmp_path_factory.mktemp("figures"), port=0)
    with embedded.running(settings, cluster) as url, Client(url) as client:
        yield client


@dataclass(frozen=True)
class Made:
    """A picture, and what its artists draw."""

    content: bytes
    caption: Caption
    drawn: list[str]
    minor_ticks: list[bool]  # whether each of its axes has them


class Pictures(UserDict[int | str, Made]):
    """Figures by number or name, each made when it is first asked for."""

    def __init__(self, client: Client) -> None:
        super().__init__()
        self._client = client

    def __missing__(self, number: int | str) -> Made:
        figure = SMALL_FIGURES[number] if isinstance(number, int) else small_explanation(number)
        with pytest.MonkeyPatch.context() as patch:
            drawings: list[canvas.Drawing] = []
            encoded = canvas.Drawing.encoded
            patch.setattr(
                canvas.Drawing, "encoded", lambda self, *args: drawings.append(self) or encoded(self, *args)
            )
            (picture,) = catalogue.make([figure], self._client, "png", progress=False)
        (drawing,) = drawings
        with mpl.rc_context(canvas.STYLE):
            minor = [
                all(
                    isinstance(axis.get_minor_locator(), AutoMinorLocator)
                    for axis in (axes.xaxis, axes.yaxis)
                )
                for axes in drawing.figure.axes
            ]
            self[number] = Made(picture.content, picture.caption, read_back(drawing.figure), minor)
        return self[number]


@pytest.fixture(scope="module")
def pictures(client: Client) -> Pictures:
    """Every figure, drawn from small grids."""
    return Pictures(client)


def diagram(client: Client, number: int, sweep: int = 0, **line: Any):
    """What the figure was drawn from."""
    return client.submit(SMALL_FIGURES[number].sweeps[sweep]).diagram(**line)


def agreeing(caption: Caption) -> str:
    return caption.claims_that(Verdict.AGREES)


def contradicting(caption: Caption) -> str:
    return caption.claims_that(Verdict.CONTRADICTS)


def leaving_open(caption: Caption) -> str:
    return caption.claims_that(Verdict.LEFT_OPEN)


def test_every_figure_is_listed_by_its_number_with_valid_sweeps():
    assert list(catalogue.FIGURES) == list(range(1, 10))
    for number, figure in catalogue.FIGURES.items():
        assert figure.number == number
        assert figure.title
        names = [SweepSpec.parse(dict(sweep)).name for sweep in figure.sweeps]
        assert all(re.match(rf"figure {number}(,|$)", name) for name in names)
        assert len(set(names)) == len(names)


def test_the_parameters_are_the_papers():
    spring, ball, _ = (SweepSpec.parse(dict(sweep)) for sweep in catalogue.FIGURES[3].sweeps)
    assert spring.xi / spring.omega == pytest.approx(650)
    assert (spring.xi, ball.model.kind, ball.model.restitution) == (10, "ball", 0)
    spring, ball, _ = (SweepSpec.parse(dict(sweep)) for sweep in catalogue.FIGURES[4].sweeps)
    assert spring.xi / spring.omega == pytest.approx(650)
    assert (spring.xi, ball.model.kind, ball.model.restitution) == (0.5, "ball", 0.15)
    assert SweepSpec.parse(dict(catalogue.FIGURES[5].sweeps[0])).xi == (0.01, 0.05, 0.2, 1.0)
    assert SweepSpec.parse(dict(catalogue.FIGURES[7].sweeps[0])).omega == (0.67, 1.0, 1.24)
    assert SweepSpec.parse(dict(catalogue.FIGURES[8].sweeps[0])).gamma == (1.0, 2.0, 3.0)
    near_two = [SweepSpec.parse(dict(sweep)) for sweep in catalogue.FIGURES[7].sweeps[1:]]
    assert {sweep.omega for sweep in near_two} == {1.0}
    loop = SweepSpec.parse(dict(catalogue.FIGURES[9].sweeps[0]))
    assert (loop.xi, loop.protocol.direction, loop.settle + loop.observe) == (0.05, "both", 120)


@pytest.mark.parametrize("which", ["10", "0", "-1", "one", "ALL", ""])
def test_an_unknown_figure_names_those_there_are(which: str):
    with pytest.raises(
        catalogue.UnknownFigure, match=r"choose one of: 1, 2, 3, 4, 5, 6, 7, 8, 9, hysteresis, branches"
    ):
        catalogue.figures(which)


@pytest.mark.parametrize("number", [*SMALL, *catalogue.EXPLANATIONS])
def test_a_figure_draws_and_says_what_it_did(pictures: Pictures, number: int | str):
    golden = json.loads(DRAWN.read_text())["figures"][str(number)]
    assert str(pictures[number].caption).splitlines() == golden["caption"]
    assert difference(pictures[number].drawn, golden["drawn"]) == ""


@pytest.mark.parametrize("number", [*SMALL, *catalogue.EXPLANATIONS])
def test_axes_have_minor_ticks(pictures: Pictures, number: int | str):
    """But for those of the schematics, which are not shown, and of the four motions."""
    found = pictures[number].minor_ticks
    assert found == {1: [False] * 2, 2: [True] + [False] * 4}.get(number, [True] * max(len(found), 1))


def test_the_sweeps_of_all_figures_are_submitted_before_one_is_drawn(client: Client):
    later = {"name": "submitted early", "gamma": [1.0], "omega": 0.5, "xi": 0.26}
    selected = [SMALL_FIGURES[1], replace(SMALL_FIGURES[6], sweeps=(later,))]
    next(catalogue.make(selected, client, "svg", progress=False))
    assert [job.name for job in client.jobs(search="submitted early")] == ["submitted early"]


@pytest.mark.parametrize("number", SMALL)
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


@pytest.mark.parametrize("number", [4, 9])
def test_svg_holds_letters_as_lines_and_dots_as_an_image(client: Client, pictures: Pictures, number: int):
    content = SMALL_FIGURES[number].make(client, "svg", progress=False).content.decode()
    assert content == SMALL_FIGURES[number].make(client, "svg", progress=False).content.decode()
    assert "<svg" in content
    assert "<text" not in content  # needs no font where it is shown
    assert ("<image" in content) == (number == 4)


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


def test_fig_3_spring_and_ball_agree(pictures: Pictures):
    agrees, open_ = agreeing(pictures[3].caption), leaving_open(pictures[3].caption)
    same, periodic = map(int, re.findall(r"(\d+) of (\d+) periodic cells", agrees)[0])
    assert same == periodic > 50
    assert float(re.findall(r"([\d.]+) rad apart", agrees)[0]) < 0.05
    same, periodic = map(int, re.findall(r"(\d+) of (\d+) periodic cells", open_)[0])
    assert same < 0.5 * periodic  # on a contact softer than the spring


@pytest.mark.parametrize(("deviation", "small"), [(0.049, True), (ball.VISIBLE, False)])
def test_a_difference_that_can_be_seen_is_not_small(deviation: float, small: bool):
    comparison = ball.Comparison(10, 10, np.full(10, deviation))
    for claim in (ball._small_differences(comparison), ball._indistinguishable(comparison)):
        assert claim.verdict == (Verdict.AGREES if small else Verdict.CONTRADICTS)


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


def small_explanation(name: str) -> Figure:
    """A figure of docs/hysteresis.md, from fewer sweeps and cells."""
    figure = catalogue.explanation(name)
    if name == "hysteresis":
        loop, *seeded = figure.sweeps
        few = [sweep for sweep in seeded if sweep["omega"] in SEEDED]
        return replace(figure, sweeps=({**loop, **SMALL[9]}, *few))
    if name == "branches":
        (branches,) = figure.sweeps
        return replace(figure, sweeps=({**branches, "gamma": {"start": 0.45, "stop": 1.1, "num": 66}},))
    return figure


def computed(caption: Caption) -> str:
    return caption.claims_that(Verdict.COMPUTED)


@pytest.mark.parametrize("name", catalogue.EXPLANATIONS)
def test_explanations_have_ink_and_captions(pictures: Pictures, name: str):
    picture = pictures[name]
    image = Image.open(io.BytesIO(picture.content))
    assert image.text["Description"] == str(picture.caption)
    assert str(picture.caption).startswith(f"{name.capitalize()}. ")
    assert 0.01 < np.mean(np.asarray(image.convert("L")) < 128) < 0.4
    assert np.all(np.asarray(image.convert("L"))[:, -2:] == 255)  # nothing is cut off on the right


def test_ramps_that_start_on_a_cycle_pass_its_fold():
    """docs/hysteresis.md: steps of 1e-5, the fold between two of them, 6 cells below it."""
    (sweep,) = presets.seeded(0.6, presets.XI)
    spec = SweepSpec.parse(sweep)
    gamma = spec.axis_values("gamma")
    fold = FOLD_060
    assert np.diff(gamma) == pytest.approx(1e-5)
    assert (np.count_nonzero(gamma < fold), np.count_nonzero(gamma > fold)) == (6, 25)
    assert np.abs(gamma - fold).min() == pytest.approx(5e-6, abs=1e-8)
    assert spec.directions == ("down",)
    assert (spec.settle, spec.observe, spec.settle_until, spec.keep) == (300, 100, 8000, 1)
    assert sweep["protocol"]["start"] == {"bounces": 1, "periods": 1}
    assert not presets.seeded(0.9, presets.XI)  # bouncing does not end at a fold of one flight


def test_branches_are_drawn_over_loops_at_each_frequency():
    branches = next(each for each in presets.EXPLANATIONS if each.name == "branches")
    (sweep,) = branches.sweeps()
    spec = SweepSpec.parse(sweep)
    assert spec.axis_values("omega").tolist() == [0.46, 0.6, 0.82]
    gamma = spec.axis_values("gamma")
    assert (gamma[0], gamma[-1]) == (0.45, 1.5)
    assert np.diff(gamma) == pytest.approx(0.003)
    assert spec.directions == ("up", "down")
    assert (spec.settle, spec.observe, spec.keep) == (300, 60, 24)


def test_ramps_from_the_cycle_end_at_the_predicted_folds(pictures: Pictures):
    text = computed(pictures["hysteresis"].caption)
    assert text.startswith(
        f"{len(SEEDED)} of {len(SEEDED)} ramps from the cycle end within 2·10⁻⁵ of the fold"
    )
    same, known = map(int, re.findall(r"at (\d+) of (\d+) frequencies", text)[0])
    assert same == known == len(DESCENDING) + 2  # 0.46 is unresolved


def test_simulated_cycles_lie_on_the_branches(pictures: Pictures):
    text = computed(pictures["branches"].caption)
    found = thresholds(0.6, 0.05)
    begins = f"begins at Γ_th = {found.gamma_th:.6f}, leaps at {found.jump:.6f} and ends at {found.down:.6f}"
    assert begins in text
    counts = [int(n) for n in re.findall(r"(\d+) at Ω", text.split("in cells")[1])]
    assert min(counts) > 10
    assert float(f"1e-{'⁰¹²³⁴⁵⁶'.index(text.split('10⁻')[1][0])}") <= 1e-3


def test_curves_and_energy_name_their_points(pictures: Pictures):
    text = computed(pictures["curves"].caption)
    assert "cusps at Ω = 0.28383, 0.41681, 0.80087" in text
    assert "Bogdanov–Takens points at Ω = 0.34552, 0.35267, 0.44840, 0.46723" in text
    assert "the minima end at ξ = 0.10631, 0.08716, 0.07032, 0.05825" in text
    text = computed(pictures["energy"].caption)
    assert text == (
        "the impact takes least, 24 %, at Ω = 0.620 next to Ω_11; "
        "the impact takes least, 40 %, at Ω = 0.435 next to Ω_21."
    )


@pytest.mark.parametrize(
    ("values", "indices"),
    [
        ([3, 1, 2, 0, 3], [1, 3]),
        ([3, 1, 1.01, 0, 3], [3]),  # too shallow on one side
        ([1, 2, 3], []),
        ([3, 1, 1, 2], [2]),
        ([3, 1, 2, np.nan], [1]),  # the grid does not hold the last threshold
    ],
)
def test_minima_have_a_minimal_depth(values: Sequence[float], indices: list[int]):
    assert hysteresis.minima(np.array(values, float), 0.5) == indices


def test_caption_sorts_claims():
    claims = (
        compared(True, "one"),
        compared(np.bool_(False), "two"),
        left_open("three"),
        compared(True, "four"),
    )
    sorted_ = ["Fig. 5. A line.", "Agrees: one; four.", "Contradicts: two.", "Left open by the paper: three."]
    assert str(Caption(5, "A line.", claims)) == "\n".join(sorted_)
    assert str(Caption(5, "A line.", ())) == "Fig. 5. A line."


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
            for number in (*SMALL, *catalogue.EXPLANATIONS)
        }
    source = f"what the artists of each figure draw, read back by python {Path(__file__).relative_to(ROOT)}"
    DRAWN.write_text(json.dumps({"source": source, "figures": figures}, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    write()
