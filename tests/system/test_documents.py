"""The documents run: what they print can be typed in as it stands."""

import json
import re
import subprocess
import tomllib
from pathlib import Path

import pytest
import yaml
from documents import DOCUMENTS, LONG, Block, Failed, Session, blocks, run_in_order, runnable, text

from worker.kernel_cache import use_cache

#: What must not be hidden in a block of plain text.
LOOKS_RUNNABLE = re.compile(
    r"^(bounce|curl|python3?|pip|pytest|dask|docker|export|from|import) ", re.MULTILINE
)

ALL_BLOCKS = tuple(block for name in DOCUMENTS for block in blocks(name))


@pytest.fixture(scope="module")
def compiled_kernels() -> None:
    """Compile the kernels first: otherwise the time to compile counts as time to start the service."""
    use_cache()


@pytest.mark.usefixtures("compiled_kernels")
def test_blocks_of_the_readme_run_in_order(tmp_path: Path):
    with Session(tmp_path) as session:
        run_in_order(session, "README.md")
        assert session.file("diagram.svg").read_text().startswith("<?xml")
        assert session.file("sweep.nc").read_bytes()[1:4] == b"HDF"
        assert session.file("diagram.png").read_bytes().startswith(b"\x89PNG")
        # Eq. 25 for the three frequencies at xi = 0.26 (docs/model.md, section 5), found to the tolerance.
        rows = re.findall(r"^ *([\d.]+) +([\d.]+) +([\d.]+) +\S+", session.output(), re.M)
        assert [float(omega) for omega, _, _ in rows] == [0.4, 0.5, 0.6]
        for _, analytic, up in rows:
            assert float(up) == pytest.approx(float(analytic), abs=2e-3)


@pytest.mark.usefixtures("compiled_kernels")
@pytest.mark.parametrize("document", [name for name in runnable() if name not in ("README.md", *LONG)])
def test_blocks_run_in_order(document: str, tmp_path: Path):
    with Session(tmp_path) as session:
        run_in_order(session, document)


def test_a_block_that_fails_is_noticed(tmp_path: Path):
    bad = {
        "sh": ["true\nfalse\ntrue\n", "cat missing | wc -l\n", "exit 0\n"],
        "python": ["import nowhere\n"],
        "output": ["another text\n"],
    }
    for language, codes in bad.items():
        for number, content in enumerate(codes):
            folder = tmp_path / f"{language}-{number}"
            folder.mkdir()
            with Session(folder) as session:
                session.run(Block("made up", 1, "sh", "NAME=one; echo $NAME\n", ""))
                session.run(Block("made up", 3, "text", "one\n", "output"))
                comment = "output" if language == "output" else ""
                with pytest.raises(Failed):
                    session.run(Block("made up", 5, language, content, comment))


@pytest.mark.parametrize("block", ALL_BLOCKS, ids=lambda block: block.location)
def test_block_is_well_formed(block: Block):
    if block.language == "sh":
        done = subprocess.run(["bash", "-n"], input=block.code, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
    elif block.language == "python":
        compile(block.code, block.location, "exec")
    elif block.language == "toml":
        tomllib.loads(block.code)
    elif block.language == "json":
        json.loads(block.code)
    else:
        assert block.language in ("text", "mermaid")
        assert block.comment == "output" or not LOOKS_RUNNABLE.search(block.code)
    if block.comment:
        assert re.match(r"file: [\w.]+$|output$|not run: ", block.comment)


def test_the_paper_is_cited():
    (paper,) = yaml.safe_load(text("CITATION.cff"))["references"]
    assert paper["doi"] == "10.1016/j.physd.2014.01.006"
