"""`bounce tradeoff`: the table of costs and errors, the advice, and the picture."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from paths import GOLDEN

from service.cli.main import main
from service.cli.tradeoff import REFERENCES
from service.render.work_precision import SIZE, compose
from service.views.style import DPI
from worker.analysis import work_precision
from worker.analysis.work_precision import Measurement, Setup

#: As once measured: tests/system/worker/test_work_precision.py measures.
ROWS = [
    Measurement.model_validate(row) for row in json.loads((GOLDEN / "tradeoff_rows.json").read_text())["rows"]
]


@pytest.fixture
def bounce(monkeypatch: pytest.MonkeyPatch):
    """The command, without the minute that it measures."""
    rows = {Setup(**row.model_dump(include=set(Setup.model_fields))).model_dump_json(): row for row in ROWS}
    monkeypatch.setattr(work_precision, "measure", lambda setup: rows[setup.model_dump_json()])

    def run(*arguments: str) -> Result:
        return CliRunner().invoke(main, ["tradeoff", *arguments])

    return run


def test_the_table_the_advice_and_the_picture(bounce, tmp_path: Path):
    pictures = [tmp_path / name for name in ("tradeoff.png", "again.png")]
    for picture in pictures:
        done = bounce("-o", str(picture))
        assert done.exit_code == 0, done.output
    assert done.stderr.startswith("measuring")  # it takes minutes
    lines = done.stdout.splitlines()
    assert lines[0] == f"Errors relative to the {REFERENCES['adhesive']}"
    assert lines[2].split()[:3] == ["soft,", "d", "="]
    assert lines[2].split()[-3:] == ["exact", "exact", "100%"]
    assert len(lines) == len(ROWS) + 3 * 3 + 3 + 2  # headings and gaps, the legend, the advice
    assert lines[-1].startswith("Take rigid for a hard plate (")
    assert lines[-1].endswith("and auto to choose the model on the cells of your own sweep.")
    assert "nan" not in lines[-1]
    first, second = (picture.read_bytes() for picture in pictures)
    assert first.startswith(b"\x89PNG")
    assert first == second


def test_the_measurements_as_json(bounce):
    printed = json.loads(bounce("--json").stdout)
    assert [Measurement.model_validate(row) for row in printed["rows"]] == ROWS
    assert printed["cells"] == 80
    assert set(printed["references"]) == {"adhesive", "nonadhesive", "plate"}


def test_a_picture_of_another_kind_is_refused_before_anything_is_measured(bounce):
    done = bounce("-o", "tradeoff.gif")
    assert done.exit_code == 2
    assert "does not end in .png, .svg" in done.stderr
    assert "measuring" not in done.stderr


def test_no_label_of_the_picture_covers_another_or_a_marker():
    figure = Figure(figsize=SIZE, dpi=DPI, layout="constrained")
    compose(figure, ROWS)
    renderer = FigureCanvasAgg(figure).get_renderer()
    written = 0
    for axes in figure.axes:
        boxes = [Text.get_window_extent(text, renderer) for text in axes.texts if text.get_text()]
        points = [line.get_xydata()[0] for line in axes.lines if line.get_marker() != "None"]
        markers = [Bbox.from_bounds(x - 8, y - 8, 16, 16) for x, y in axes.transData.transform(points)]
        legend = axes.get_legend()
        others = [*markers, *([legend.get_window_extent(renderer)] if legend else [])]
        written += len(boxes)
        for i, box in enumerate(boxes):
            assert not any(box.overlaps(other) for other in (*boxes[:i], *others))
    labelled = sum(row.error != 0.0 and (row.scheme or row.model) in ("verlet", "euler", "ball")
                   for row in ROWS if row.error is not None and row.cost is not None)  # fmt: skip
    # the ends of two lines of depths, two references, and the hint of each panel
    assert written == labelled + 4 + 2 + 3
