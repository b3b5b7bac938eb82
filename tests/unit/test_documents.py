"""The documents: what they list is what the code has, and what they name is there."""

import importlib
import inspect
import json
import re
import subprocess
import tomllib
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest
from documents import DOCUMENTS, blocks, text
from paths import GOLDEN, ROOT
from tables import for_each

SET_UP = """\
python3 -m venv .venv && .venv/bin/pip install -e . && .venv/bin/bounce figure 2 -o figure-2.png
python3 -m venv .venv && .venv/bin/pip install -e ".[test]" && .venv/bin/pytest
"""

#: Why a block may be left out of the run, and the commands that it may then consist of.
NOT_RUN = {
    "the set-up itself": r"python3 -m venv \.venv && \.venv/bin/pip install ",
    "needs Docker": r"export BOUNCE_TOKEN=|docker compose ",
    "needs machines with a shared folder": r"(TLS|PAGES)=|export BOUNCE_SCHEDULER_|"
    r"dask (scheduler|worker) --scheduler-file /shared/|"
    r"(BOUNCE_\w+=\S+ )*bounce serve --(scheduler tls://scheduler\.example\.org|scheduler-file /shared/)",
    "needs Kubernetes": r"kubectl ",
    "needs a batch queue or a gateway": r"BOUNCE_STORES=\S+ bounce serve --cluster ",
    "takes minutes": r"bounce figure all\b|python docs/figures/|bounce tradeoff |"
    r"python -m benchmarks\.",
    "goes on until it is stopped": r"dask worker |export GATEWAY_PASSWORD=|dask-gateway-server |"
    r"bounce serve --cluster (elastic|local_gateway):cluster",
    "the service must be stopped": r"bounce (restore|adopt) ",
}

#: So that a good reason does not become a habit.
MOST_NOT_RUN = 18

#: Of all documents together.
MOST_WORDS = 28_000


#: Written beside the code, and read like the documents.
PAGES = (*DOCUMENTS, "CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")

ALL_BLOCKS = tuple(block for name in DOCUMENTS for block in blocks(name))


def table(document: str, heading: str, nth: int = 0) -> list[list[str]]:
    """The rows of the nth table after a heading, cell by cell, without the table's own heading."""
    section = text(document).split(f"\n{heading}\n", 1)[1]
    section = re.split(rf"\n#{{1,{heading.count('#')}}} ", section, maxsplit=1)[0]
    tables = re.findall(r"(?:^\|.*\|$\n?)+", section, re.MULTILINE)
    rows = tables[nth].strip().splitlines()[2:]
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", row)[1:-1]] for row in rows]


def code(cell: str) -> list[str]:
    """The words in a cell that are set as code."""
    return re.findall(r"`([^`]+)`", cell)


def test_blocks_are_left_out_for_a_known_reason_only():
    left_out = [block for block in ALL_BLOCKS if block.not_run is not None]
    for block in left_out:
        assert block.not_run in NOT_RUN, block.location
        for command in block.code.replace("\\\n", " ").splitlines():
            assert re.match(NOT_RUN[block.not_run], command), f"{block.location}: {command}"
    assert len(left_out) <= MOST_NOT_RUN
    assert {block.not_run for block in left_out} == set(NOT_RUN)


def test_documents_are_short_enough_to_be_read():
    pages = (*DOCUMENTS, "CHANGELOG.md", "CONTRIBUTING.md")
    assert sum(len(text(page).split()) for page in pages) <= MOST_WORDS


# What the README promises.


def test_set_up_is_these_two_lines():
    """Each in a block of its own."""
    here = text("README.md")
    assert all(f"```sh\n{line}```" in here for line in SET_UP.splitlines(keepends=True))


def test_ci_sets_up_and_tests_as_the_readme_says():
    assert SET_UP.splitlines()[1] in (ROOT / ".ci" / "run").read_text().splitlines()


# Links and names.


def anchors(page: str) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    content = re.sub(r"^```.*?^```$", "", text(page), flags=re.MULTILINE | re.DOTALL)
    headings = re.findall(r"^#+ (.*)$", content, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@for_each("page", PAGES)
def test_links_lead_somewhere(page: str):
    for link in re.findall(r"\]\(([^)\s]+)\)", text(page)):
        if "://" in link:
            continue
        path, _, anchor = unquote(link).partition("#")
        target = (ROOT / page).parent / path if path else ROOT / page
        assert target.exists(), link
        if anchor:
            assert anchor in anchors(str(target.resolve().relative_to(ROOT))), link


@for_each("page", [page for page in PAGES if page != "CHANGELOG.md"])
def test_named_modules_and_tests_exist(page: str):
    content = text(page)
    for name in re.findall(r"-m benchmarks\.(\w+)", content):
        assert (ROOT / "benchmarks" / f"{name}.py").exists(), name
    folders, endings = "tests|kernel|worker|service|examples|docs", "py|md|ipynb|png|svg"
    for path in re.findall(rf"\b(?:{folders})/[\w/.-]*\w\.(?:{endings})\b", content):
        assert (ROOT / path).exists(), path


def test_every_benchmark_is_in_the_index():
    index = (ROOT / "benchmarks" / "README.md").read_text()
    programs = [path for path in (ROOT / "benchmarks").glob("*.py") if "def main" in path.read_text()]
    assert set(re.findall(r"-m benchmarks\.(\w+)", index)) == {path.stem for path in programs}
    for path in programs:
        try:
            importlib.import_module(f"benchmarks.{path.stem}")
        except ModuleNotFoundError as error:
            if (ROOT / str(error.name).partition(".")[0]).exists():  # a rival may be missing
                raise


def test_every_document_is_linked_from_the_readme():
    linked = set(re.findall(r"\]\(([^)#\s]+\.(?:md|cff))\)", text("README.md")))
    assert {name for name in PAGES if name != "README.md"} | {"CITATION.cff"} <= linked


# Tables that repeat what the code declares.


def test_fields_and_defaults_are_those_of_the_specification():
    from worker.sweep import SweepSpec

    rows = table("docs/specification.md", "## Fields")
    assert sorted(code(row[0])[0] for row in rows if len(code(row[0])) == 1) == sorted(SweepSpec.model_fields)
    spec = SweepSpec(gamma=1, omega=1, xi=0)
    for name, _, default, _ in rows:
        (field,) = code(name)
        if field in ("gamma", "omega", "xi"):
            assert default == "required"
        elif field in ("protocol", "model"):
            assert getattr(spec, field).kind == json.loads(*code(default))["kind"]
        else:
            assert getattr(spec, field) == json.loads(default.strip("`"))


def test_contact_models_and_their_defaults_are_those_of_the_code():
    from worker.spec.contact_models import CONTACT_MODELS

    rows = {code(row[0])[0]: row[2] for row in table("docs/specification.md", "### Contact models")}
    assert list(rows) == list(CONTACT_MODELS)
    for kind, model in CONTACT_MODELS.items():
        shown = rows[kind].replace("as `soft`", rows["soft"])
        assert set(code(shown)) == set(model.fields.model_fields) - {"kind"}
        defaults = model.fields.model_validate({"kind": kind})
        for field, default in re.findall(r"`(\w+)`:? ([\w.\"-]+)", shown):
            if default != "or":
                assert getattr(defaults, field) == json.loads(default), f"{kind}.{field}"


def test_stored_variables_are_those_of_a_store(tmp_path: Path):
    from served import RAMP, computing, finished, get

    with computing(tmp_path) as client:
        metadata = get(client, f"{finished(client, RAMP | {'settle': 'auto'})}/zarr/zarr.json")
    arrays = metadata["consolidated_metadata"]["metadata"]
    stored = {
        (name, ", ".join(array["dimension_names"]), array["data_type"])
        for name, array in arrays.items()
        if name not in ("direction", "xi", "omega", "gamma")
    }
    rows = table("docs/specification.md", "## Stored variables")
    assert {(code(row[0])[0], row[1], row[2]) for row in rows} == stored


def test_outcomes_and_states_are_those_of_the_code():
    from kernel.params import Outcome
    from service.ledger.model import JobState

    rows = table("docs/model.md", "## 4. Protocols")
    assert [(int(row[0]), row[1]) for row in rows] == [(int(o), o.name.lower()) for o in Outcome]
    for page in ("docs/http-api.md", "docs/glossary.md"):
        assert all(f"`{state}`" in text(page) for state in JobState), page


def test_every_setting_is_listed_with_its_default_and_description():
    from service.settings import Settings

    rows = re.findall(r"^\| `(BOUNCE_\w+)` \| (.*?) ?\| (.*) \|$", text("docs/deployment.md"), re.MULTILINE)
    assert [row[0] for row in rows] == [f"BOUNCE_{name.upper()}" for name in Settings.model_fields]
    for (_, shown, meaning), (name, field) in zip(rows, Settings.model_fields.items(), strict=True):
        assert f"{meaning}." == field.description, name
        default = shown.replace(",", "")
        if field.default in (None, frozenset()):
            assert default == "", name
        elif isinstance(field.default, bool):
            assert default == str(field.default).lower(), name
        elif isinstance(field.default, int | float):
            assert float(default) == field.default, name
        else:
            assert default == str(field.default), name


@pytest.fixture(scope="module")
def api() -> dict[str, Any]:
    """The OpenAPI document."""
    from service.api.app import create_app
    from service.settings import Settings
    from worker.executors.inline import Inline

    with closing(Inline()) as executor:
        return create_app(Settings(), executor).openapi()


def test_every_call_is_listed_with_its_parameters(api: dict[str, Any]):
    rows = {code(row[0])[0]: row[1] for row in table("docs/http-api.md", "## Calls")}
    assert set(rows) == {
        f"{method.upper()} {path}" for path, methods in api["paths"].items() for method in methods
    }
    for call, answer in rows.items():
        if answer.startswith("for the page: "):
            continue
        method, path = call.split()
        parameters = api["paths"][path][method.lower()].get("parameters", [])
        for parameter in parameters:
            if parameter["in"] == "query":
                assert re.search(rf"`\??{parameter['name']}\b", answer), f"{call} {parameter['name']}"


def test_the_fields_of_a_job_are_listed(api: dict[str, Any]):
    schemas = api["components"]["schemas"]
    rows = table("docs/http-api.md", "## Jobs")
    listed = [name for row in rows for name in code(row[0])]
    assert sorted(listed) == sorted(schemas["JobView"]["properties"])
    progress = schemas["JobView"]["properties"]["progress"]["$ref"].rpartition("/")[2]
    (meaning,) = (row[1] for row in rows if row[0] == "`progress`")
    assert code(meaning) == list(schemas[progress]["properties"])


def test_every_status_is_explained():
    from service import errors
    from service.api.problems import FOREIGN

    explained = {int(row[0]) for row in table("docs/http-api.md", "## Errors")}
    own = {
        error.status
        for error in vars(errors).values()
        if isinstance(error, type) and hasattr(error, "status")
    }
    assert own | set(FOREIGN.values()) | {401, 403, 404, 405, 408, 410, 412, 415, 416, 421} == explained


def test_every_command_is_named():
    """`bounce --help` lists them; the documents say what for."""
    from service.cli.main import main

    documents = " ".join(map(text, DOCUMENTS))
    assert not [name for name in main.commands if f"bounce {name}" not in documents]


def test_names_of_the_client_are_those_it_exports():
    import service.client

    content = text("docs/python-client.md")
    exported = {name: getattr(service.client, name) for name in service.client.__all__}
    errors = {name for name, value in exported.items() if issubclass(value, service.client.BounceError)}
    listed = {name for row in table("docs/python-client.md", "## Errors") for name in code(row[0])}
    assert listed == errors - {"BounceError"}
    for owner, methods in re.findall(r"^\| `(client|job)\.(.*?)` \|", content, re.MULTILINE):
        kind = {"client": service.client.Client, "job": service.client.Job}[owner]
        for method in re.findall(rf"(?:^|`{owner}\.)(\w+)\(", methods):
            assert callable(getattr(kind, method)), method


def test_signatures_of_the_client_are_those_of_the_code():
    from service.client import Client, Job

    owners = {"client": Client, "job": Job}
    for row in table("docs/python-client.md", "## Jobs") + table("docs/python-client.md", "## Results"):
        for owner, method, shown in re.findall(r"`(client|job)\.(\w+)\(([^)]*)\)`", row[0]):
            known = inspect.signature(getattr(owners[owner], method)).parameters
            named = {part.split("=")[0].strip() for part in shown.split(",")} - {"", "*", "…"}
            assert named <= set(known), f"{owner}.{method}"


def test_numbers_of_the_model_are_the_golden_ones():
    facts = json.loads((GOLDEN / "facts.json").read_text())
    content = text("docs/model.md")
    for cycle in facts["cycles"]:
        assert all(f"{flight:.12f}" in content for flight in cycle["flights"]), cycle
        if cycle["flights"]:
            assert "({}, {})".format(*cycle["mode"]) in content
    for extremum in ("least", "most"):
        assert all(f"{value:.5f}" in content for value in facts["threshold"]["extrema"][extremum])
    assert all(f"{gamma} at Ω = {omega:g}" in content
               for omega, gamma in facts["threshold"]["not_one_at_xi_one"])  # fmt: skip


RELEASES = re.findall(
    r"^## \[([\d.]+)\] - [\d-]+\n\n(?:Commit|Tag) `(\S+)`, kernel version (\d+)\.$",
    text("CHANGELOG.md"),
    re.MULTILINE,
)


def test_every_file_has_the_version_of_the_last_release():
    """`.ci/release` writes it."""
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert re.search(rf"^version: {re.escape(version)}$", text("CITATION.cff"), re.MULTILINE)
    assert f'image.version="{version}"' in text("Dockerfile")
    headings = re.findall(r"^## \[([^\]]+)\]", text("CHANGELOG.md"), re.MULTILINE)
    assert headings == ["Unreleased", *(release for release, _, _ in RELEASES)]
    assert headings[1] == version


@pytest.mark.parametrize(("version", "commit", "kernel"), RELEASES)
def test_the_commit_of_a_release_has_its_version(version: str, commit: str, kernel: str):
    def content(name: str) -> str:
        git = subprocess.run(
            ["git", "show", f"{commit}:{name}"], cwd=ROOT, capture_output=True, text=True, check=False
        )
        if git.returncode:
            pytest.skip("the commit is not in this clone")
        return git.stdout

    assert tomllib.loads(content("pyproject.toml"))["project"]["version"] == version
    assert f'KERNEL_VERSION: Final = "{kernel}"' in content("kernel/params.py")


# Promises

#: A command in a table: a run of tests, perhaps with variables before it and an expression, or a benchmark.
COMMAND = re.compile(r"`(?:\w+=\S+ )*(?:pytest ([^`]*)|python -m benchmarks\.(\w+)[^`]*)`")


@pytest.mark.parametrize("heading", ["## What survives what", "## Who gets in"])
def test_every_promise_names_a_test_or_a_benchmark_that_can_be_run(heading: str):
    rows = table("docs/reliability.md", heading)
    assert len(rows) > 10
    for row in rows:
        assert len(row) == 3, row
        assert all(row), row
        assert row[-1].startswith("the same") or runnable(row[-1]), row


def runnable(cell: str) -> bool:
    """Whether the command is a benchmark that exists, or its expression names tests of its files."""
    command = COMMAND.search(cell)
    if command is None:
        return False
    options, benchmark = command.groups()
    if benchmark:
        return (ROOT / "benchmarks" / f"{benchmark}.py").is_file()
    files = [ROOT / name for name in re.findall(r"tests/\S+\.py", options)]
    names = "".join(name for file in files for name in re.findall(r"def (test_\w+)", file.read_text()))
    words = re.search(r'-k (?:"([^"]+)"|(\S+))', options)
    return bool(files) and (words is None or all(w in names for w in (words[1] or words[2]).split(" or ")))
