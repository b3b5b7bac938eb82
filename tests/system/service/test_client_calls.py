"""Every call of client and command line against the real service."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas
import pytest
from click.testing import CliRunner, Result
from json_results import from_json
from scripted import Held, sweep, wait_for
from served import computing_at, service_at
from studies import spec_of

from service.cli.main import main
from service.client import BounceError, Client, Conflict, Job, NotFound

TOKEN = "a-token-of-thirty-two-characters"

PLANE = spec_of((0.6, 1.6, 11), [0.5, 0.7], 0.26, name="a plane", ramp="both", window=(40, 20, 8))


class Running(NamedTuple):
    """A service that requires a token, a client that has it, and a job that is done."""

    address: str
    client: Client
    job: Job


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    folder = tmp_path_factory.mktemp("data")
    with computing_at(folder, token=TOKEN) as address, Client(address, TOKEN) as client:
        yield Running(address, client, client.submit(PLANE).wait(progress=False))


@pytest.fixture(scope="module")
def idle(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    """A service that runs one job at a time, and runs one that never ends: all others stay queued."""
    with (
        service_at(tmp_path_factory.mktemp("data"), Held(), active_jobs=1) as address,
        Client(address) as client,
    ):
        job = client.submit(sweep("never ends"))
        wait_for(lambda: job.refresh().state == "running")
        yield Running(address, client, job)


def bounce(running: Running, *words: str, token: str | None = TOKEN) -> Result:
    environment = {"BOUNCE_URL": running.address, "BOUNCE_TOKEN": token}
    return CliRunner().invoke(main, words, env=environment)


def output_of(running: Running, *words: str) -> str:
    done = bounce(running, *words)
    assert done.exit_code == 0, done.output
    return done.stdout


def test_an_estimate_submits_nothing(idle: Running, tmp_path: Path):
    before = len(list(idle.client.jobs()))
    estimate = idle.client.estimate(PLANE)
    assert estimate.cells == 44
    file = tmp_path / "sweep.json"
    file.write_text(json.dumps(PLANE))
    assert "44 cells" in output_of(idle, "submit", str(file), "--estimate")
    assert len(list(idle.client.jobs())) == before


def test_a_budget_and_an_effort_on_the_command_line(tmp_path: Path):
    file = tmp_path / "sweep.json"
    windows = {"settle", "observe"}
    file.write_text(json.dumps({name: x for name, x in PLANE.items() if name not in windows} | {"xi": 0.3}))
    with computing_at(tmp_path, token=TOKEN) as address, Client(address, TOKEN) as client:
        own = Running(address, client, client.submit(PLANE))
        done = output_of(own, "submit", str(file), "--budget", "120s", "--effort", "draft")
        job = client.job(done.strip())
    assert (job.state, job.spec["until"], job.spec["observe"]) == ("done", 260, 30)
    assert "effort" not in job.spec


def test_a_key_on_the_command_line(idle: Running, tmp_path: Path):
    file = tmp_path / "sweep.json"
    for xi in (0.31, 0.32):
        file.write_text(json.dumps({**PLANE, "xi": xi}))
        done = bounce(idle, "submit", str(file), "--key", "mine")
    assert done.exit_code == 1
    assert "Idempotency-Key" in done.stderr


def test_the_first_digits_of_an_id_select_its_job(running: Running, idle: Running):
    assert running.client.job(running.job.id[:4]).id == running.job.id
    assert running.job.id in output_of(running, "status", running.job.id[:6])
    with pytest.raises(NotFound, match="an id is 32 hex digits"):
        running.client.job(running.job.id[:3])
    other = "0000" if not running.job.id.startswith("0000") else "1111"
    with pytest.raises(NotFound, match=f"no job has an id that begins with {other}"):
        running.client.job(other)


def completions(running: Running, words: str) -> list[str]:
    """What the shell is told of `words`, of which the last is incomplete."""
    environment = {
        "BOUNCE_URL": running.address, "BOUNCE_TOKEN": TOKEN, "_BOUNCE_COMPLETE": "bash_complete",
        "COMP_WORDS": words, "COMP_CWORD": str(len(words.split(" ")) - 1),
    }  # fmt: skip
    done = CliRunner().invoke(main, [], env=environment, prog_name="bounce")
    return done.stdout.split()


def test_the_shell_completes_commands_options_and_ids(running: Running):
    assert completions(running, "bounce thr") == ["plain,threshold", "plain,thresholds"]
    assert completions(running, "bounce status --u") == ["plain,--url"]
    assert completions(running, f"bounce status {running.job.id[:4]}") == [f"plain,{running.job.id}"]
    assert completions(running, "bounce status ") == [f"plain,{running.job.id}"]
    assert completions(running, "bounce orbits zz") == []
    assert completions(running._replace(address="http://127.0.0.1:9"), "bounce status ") == []


def test_watch_without_a_terminal_is_one_table(idle: Running):
    lines = output_of(idle, "watch").splitlines()
    assert any(line.startswith(idle.job.id) and "running" in line for line in lines)


def test_resume_and_delete(idle: Running):
    job = idle.client.submit(sweep("to and fro", xi=0.5))
    assert job.cancel().state == "cancelled"
    resumed = bounce(idle, "resume", job.id)
    assert (resumed.stdout, "queued" in resumed.stderr) == ("", True)
    with pytest.raises(Conflict, match="cancel it first"):
        job.delete()
    cancelled = bounce(idle, "cancel", job.id)
    assert cancelled.stdout == ""
    assert cancelled.stderr.startswith(f"{job.id[:8]} to and fro: cancelled, ")
    assert bounce(idle, "delete", job.id).exit_code == 0
    with pytest.raises(NotFound):
        job.refresh()
    assert "no job has the id" in bounce(idle, "delete", job.id).stderr


def test_an_export_that_is_refused_leaves_no_file(running: Running, tmp_path: Path):
    with pytest.raises(BounceError, match=r"ends in \.nc or \.parquet"):
        running.job.export(tmp_path / "sweep.xls")
    for target in ("sweep.xls", "nowhere/sweep.nc"):  # before the service is asked
        assert bounce(running, "export", running.job.id, "-o", str(tmp_path / target)).exit_code == 2
    assert bounce(running, "export", "0" * 32, "-o", str(tmp_path / "sweep.nc")).exit_code == 1
    assert list(tmp_path.iterdir()) == []


def test_trajectory(running: Running, tmp_path: Path):
    cell = {"gamma": 2.3, "omega": 0.5, "xi": 0.26, "model": {"kind": "rigid"}, "samples": 20}
    dataset = running.client.trajectory(cell)

    words = ["--gamma", "2.3", "--omega", "0.5", "--xi", "0.26", "--model", "rigid"]
    output_of(running, "trajectory", *words, "--samples", "20", "-o", str(tmp_path / "cell.csv"))
    table = pandas.read_csv(tmp_path / "cell.csv")
    np.testing.assert_allclose(table[["phase", "z2"]], np.transpose([dataset.phase, dataset.z2]))
    start = {"kind": "drop", "height": 0.5, "phase": 1.0}
    text = output_of(
        running, "trajectory", *words, "--drop", "0.5", "1", "--samples", "20", "--format", "json", "-o", "-"
    )
    assert from_json(text.encode()).identical(running.client.trajectory({**cell, "start": start}))


def test_pinned_jobs_are_listed_apart(idle: Running):
    job = idle.client.submit(sweep("pinned", xi=0.6))
    assert len(output_of(idle, "list", "--pinned").splitlines()) == 1
    job.pin()
    _, *rows = output_of(idle, "list", "--pinned").splitlines()
    assert [row.split()[0] for row in rows] == [job.id]
    assert len(output_of(idle, "list").splitlines()) > 2
    assert len(output_of(idle, "list", "--limit", "1").splitlines()) == 2


def test_values_that_an_option_cannot_have_are_wrong_options(idle: Running, tmp_path: Path):
    (file := tmp_path / "sweep.json").write_text("{}")
    (folder := tmp_path / "a.csv").mkdir()
    wrong = (
        ("modes", idle.job.id, "-o", str(folder)), ("list", "--limit", "0"),
        ("submit", str(file), "--effort", "abc"),
        ("wait", "a" * 16, "--timeout", "nan"),
    )  # fmt: skip
    for words in wrong:
        assert bounce(idle, *words).exit_code == 2


def test_orbits_are_printed_and_written(running: Running, tmp_path: Path):
    words = ("orbits", "--omega", "0.6", "--xi", "0.05", "--modes", "1-1")
    folds = [line for line in output_of(running, *words).splitlines() if " fold " in line]
    assert "0.5532445" in folds[-1]
    assert bounce(running, *words, "-o", str(tmp_path / "a.csv")).exit_code == 0
    found = running.client.orbits(0.6, 0.05, "1-1")
    frame = pandas.read_csv(tmp_path / "a.csv")
    assert len(frame) == int(found.points.sum())
    assert frame.gamma[0] == float(found.gamma[0, 0])
    assert "must have one bounce" in bounce(running, *words[:-1], "2-2").stderr


def test_orbits_of_a_job_are_printed_and_written(running: Running, tmp_path: Path):
    asked = ("orbits", running.job.id, "--omega", "0.5", "--direction", "up")
    found = running.job.orbits(0.5, direction="up", progress=False)
    lines = output_of(running, *asked).splitlines()
    assert len(lines) == 8 + sum(found.sizes[each] for each in ("branch", "event", "skipped"))
    assert bounce(running, *asked, "-o", str(tmp_path / "cycles.csv")).exit_code == 0
    frame = pandas.read_csv(tmp_path / "cycles.csv")
    assert len(frame) == int(found.flight_time.count()) > 0
    assert {"flight", "gamma"} <= set(frame.columns)
