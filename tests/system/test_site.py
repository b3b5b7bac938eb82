"""The site of docs/: it builds without a warning, holds every page, and loads nothing from elsewhere."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from extras import SYSTEM
from paths import ROOT

pytest.importorskip("mkdocs", reason=SYSTEM)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    done = subprocess.run(
        command, cwd=ROOT, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return folder


def test_every_document_is_a_page_that_the_navigation_leads_to(site: Path):
    documents = {path.with_suffix(".html").name for path in (ROOT / "docs").glob("*.md")}
    assert documents <= {path.name for path in site.glob("*.html")}
    home = (site / "index.html").read_text()
    assert documents <= set(re.findall(r'href="([a-z0-9-]+\.html)"', home))


def test_nothing_is_loaded_from_elsewhere(site: Path):
    loaded = re.compile(r"""<(?:script|link|img|iframe)[^>]+(?:src|href)=["']?(https?:)?//""")
    assert [path.name for path in site.glob("*.html") if loaded.search(path.read_text())] == []


def test_the_reference_documents_every_public_method(site: Path):
    from service.client import Client, Job

    page = (site / "reference.html").read_text()
    for kind in (Client, Job):
        for name, member in vars(kind).items():
            if callable(member) and not name.startswith("_") and member.__doc__:
                assert f'id="service.client.{kind.__name__}.{name}"' in page, name
