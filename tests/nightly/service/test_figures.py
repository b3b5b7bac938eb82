"""The figures of the paper from start to end, and their captions against the numbers of docs/model.md.

Figures 1 and 2 are in tests/system. What each figure draws and says has to be what tests/golden/figures.json
holds; `python tests/nightly/service/test_figures.py` writes that file anew, after a look at the figures. Some
cells are chaotic: where another C library rounds otherwise, their dots lie elsewhere.
"""

import io
import json
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

if __name__ == "__main__":
    sys.path[:0] = [str(Path(__file__).parents[2] / "support"), str(Path(__file__).parents[3])]

    from worker.kernel_cache import use_cache

    use_cache()  # before kernels are declared below

from artists import difference
from drawn_figures import DRAWN, SMALL, SMALL_FIGURES, Pictures
from paths import ROOT
from PIL import Image
from served import service_at

from service.client import Client
from service.figures import catalogue
from service.figures.drawing import WIDTH
from service.pictures import DPI
from worker.executors.dask import Dask

#: The figures of this tier.
LATER = (3, 4, 5, 6, 7, 8, 9)


@pytest.fixture(scope="module")
def client(cluster: Dask, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    with service_at(tmp_path_factory.mktemp("figures"), cluster) as url, Client(url) as client:
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


@pytest.mark.parametrize("number", [4, 9])
def test_svg_holds_letters_as_text_and_dots_as_an_image(client: Client, pictures: Pictures, number: int):
    figure = SMALL_FIGURES[number]
    first, again = (x.encoded("svg") for x in catalogue.make([figure, figure], client, progress=False))
    content = first.decode()
    assert first == again
    assert "<svg" in content
    assert "<text" in content
    assert ("<image" in content) == (number == 4)


def write() -> None:
    """Write what each figure draws and says, as it is now."""
    with (
        tempfile.TemporaryDirectory() as folder,
        closing(Dask(workers=2)) as executor,
        service_at(Path(folder), executor) as url,
        Client(url) as client,
    ):
        pictures = Pictures(client)
        made = {number: pictures[number] for number in SMALL}
    figures = {n: {"caption": str(x.caption).splitlines(), "drawn": x.drawn} for n, x in made.items()}
    source = f"what the artists of each figure draw, read back by python {Path(__file__).relative_to(ROOT)}"
    DRAWN.write_text(json.dumps({"source": source, "figures": figures}, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    write()
