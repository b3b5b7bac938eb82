"""What the README says can be typed in as it stands."""

import json
import re
import shlex
import tomllib
from collections.abc import Iterator
from pathlib import Path

import click
import httpx2
import pytest
from paths import ROOT
from scripted import DEADLINE

README = (ROOT / "README.md").read_text()
ADDRESS = "http://127.0.0.1:8000"

SET_UP = """\
python3 -m venv .venv && .venv/bin/pip install -e . && .venv/bin/bounce figure 2 -o figure-2.png
python3 -m venv .venv && .venv/bin/pip install -e ".[test]" && .venv/bin/pytest
"""


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, re.MULTILINE | re.DOTALL)


def commands(program: str) -> list[list[str]]:
    """The shell lines that call a program, as lists of words; a quoted word may go over several lines."""
    found = []
    for block in blocks("sh"):
        for line in re.findall(r"(?:'[^']*'|[^'\n])+", block):
            if line.startswith(f"{program} "):
                found.append(shlex.split(line))
    assert found, f"the README shows no {program}"
    return found


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    from service.server import embedded

    settings = embedded.settings(host="127.0.0.1", port=0, data=tmp_path_factory.mktemp("data"))
    with embedded.running(settings) as address:
        yield address


def test_set_up_is_these_two_lines():
    assert f"```sh\n{SET_UP}```" in README


def test_ci_sets_up_and_tests_as_the_readme_says():
    assert SET_UP.splitlines()[1] in (ROOT / ".ci" / "run").read_text().splitlines()


def rooms() -> set[str]:
    """The modules and folders that the table of rooms names."""
    rows = re.findall(r"^\| `(kernel|worker|service)/(.*?) \|", README, re.MULTILINE)
    return {f"{folder}/{name}" for folder, names in rows for name in re.findall(r"[\w.]+/?", names)}


def test_links_lead_somewhere():
    links = [link for link in re.findall(r"\]\(([^)]+)\)", README) if "://" not in link]
    assert [link for link in links if not (ROOT / link).exists()] == []


def test_table_of_rooms_names_every_module():
    found = {
        path.relative_to(ROOT)
        for package in ("kernel", "worker", "service")
        for path in (ROOT / package).rglob("*.py")
        if path.name != "__init__.py"
    }
    assert rooms() == {str(path) if len(path.parts) == 2 else f"{path.parent}/" for path in found}


def parse(command: click.Command, words: list[str], parent: click.Context | None = None) -> None:
    """Read a command line as click would, down to the last option, without running it."""
    context = command.make_context(words[0], words[1:], parent=parent, resilient_parsing=False)
    if isinstance(command, click.Group):
        name, below, rest = command.resolve_command(context, [*context._protected_args, *context.args])
        assert name
        assert below
        parse(below, [name, *rest], context)


def test_every_bounce_command_is_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from service.cli.main import main

    monkeypatch.chdir(tmp_path)
    (tmp_path / "sweep.toml").write_text(blocks("toml")[0])
    for words in commands("bounce"):
        parse(main, words)


def test_every_dask_command_is_one():
    from distributed.cli import dask_scheduler, dask_worker

    for _, name, *words in commands("dask"):
        parse({"scheduler": dask_scheduler.main, "worker": dask_worker.main}[name], [name, *words])


def test_tables_of_fields_and_models_are_those_of_the_specification():
    from worker.spec import SweepSpec
    from worker.spec.contact_models import CONTACT_MODELS

    section = re.search(r"^### What a sweep says\n\n(.*?)\n\n(.*?)\n\n", README, re.MULTILINE | re.DOTALL)
    assert section
    fields, models = (
        " ".join(row.split(" | ")[0] for row in table.splitlines()) for table in section.groups()
    )
    assert sorted(re.findall(r"`(\w+)`", fields)) == sorted(SweepSpec.model_fields)
    assert re.findall(r"`(\w+)`", models) == list(CONTACT_MODELS)


def test_sweep_in_a_file_is_valid():
    from worker.spec import SweepSpec

    (text,) = blocks("toml")
    assert SweepSpec.model_validate(tomllib.loads(text)).shape == (1, 1, 3, 201)


def test_rest_example_runs(service: str):
    from service.client import Client
    from worker.spec import SweepSpec

    hand_in, *look = commands("curl")
    sweep = json.loads(hand_in[hand_in.index("-d") + 1])
    SweepSpec.model_validate(sweep)

    (url,) = (word for word in hand_in if word.startswith(ADDRESS))
    answer = httpx2.post(url.replace(ADDRESS, service), json=sweep, timeout=DEADLINE)
    assert answer.status_code == 202, answer.text
    job = answer.json()["id"]
    with Client(service) as client:
        client.job(job).wait(progress=False, timeout=DEADLINE)

    types = []
    for words in look:
        (url,) = (word for word in words if word.startswith(ADDRESS))
        answer = httpx2.get(url.replace(ADDRESS, service).replace("/ID", f"/{job}"), timeout=DEADLINE)
        assert answer.status_code == 200, answer.text
        types.append(answer.headers["content-type"])
    assert types == ["application/json", "image/png"]


def test_python_example_runs(service: str, capsys: pytest.CaptureFixture[str]):
    (code,) = blocks("python")
    assert ADDRESS in code
    names: dict = {}
    exec(compile(code.replace(ADDRESS, service), "README.md", "exec"), names)

    assert "flight_time" in capsys.readouterr().out
    # MODEL: at omega = 0.6 bouncing begins at 0.782 on the way up and ends at 0.554 on the way down.
    threshold = names["threshold"]
    assert float(threshold["analytic"].squeeze()) == pytest.approx(0.782, abs=1e-3)
    assert float(threshold["up"].squeeze()) == pytest.approx(0.782, abs=0.011)
    assert float(threshold["down"].squeeze()) == pytest.approx(0.554, abs=0.03)
    assert names["store"].sizes["gamma"] == 81
