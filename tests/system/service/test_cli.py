"""The command `bounce` against a real service, in this process and as processes of its own."""

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import httpx2
import psutil
import pytest
import xarray
from click.testing import CliRunner, Result
from scripted import DEADLINE, TWO_LINES, Held, sweep, wait_for
from served import computing_at, service_at

from service import tokens
from service.cli.main import main
from service.client import BounceError, Client
from worker.executors.base import Executor

BOUNCE = str(Path(sys.executable).with_name("bounce"))
COMMANDS = [
    "adopt", "audit", "backup", "basins", "cancel", "curves", "delete", "diagram",
    "difference", "doctor", "export", "figure", "import", "list", "modes",
    "multistability", "open", "orbits", "plan", "rename", "restore", "resume", "run", "serve", "share",
    "status", "submit", "threshold", "thresholds", "tradeoff", "trajectory", "wait", "watch",
]  # fmt: skip

SPEC = {**TWO_LINES, "name": "two ω"}


def serving(folder: Path, executor: Executor, **options: object):
    return service_at(folder / "data", executor, shutdown_seconds=1.0, **options)


def bounce(*words: object, url: str | None = "http://127.0.0.1:9", **options: object) -> Result:
    """Run a command line in this process; nothing but SystemExit may come out of it."""
    result = CliRunner(env={"BOUNCE_URL": url}).invoke(main, [str(word) for word in words], **options)
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exc_info
    return result


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    with computing_at(tmp_path_factory.mktemp("cli"), shutdown_seconds=1.0) as url:
        yield url


@pytest.fixture(scope="module")
def spec(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("spec") / "sweep.json"
    path.write_text(json.dumps(SPEC))
    return path


@pytest.fixture(scope="module")
def job(url: str, spec: Path) -> str:
    """The id of a job that is done."""
    result = bounce("submit", spec, "--wait", url=url)
    assert result.exit_code == 0, result.stderr
    return result.stdout.strip()


# Help


def test_help_lists_every_command_in_one_line():
    text = bounce("--help").stdout
    listed = dict(re.findall(r"^  ([a-z]+)  +(.+)$", text.split("Sweeps:")[1], re.MULTILINE))
    assert sorted(listed) == COMMANDS
    assert not [line for line in listed.values() if line.endswith("...")]
    for name in COMMANDS:
        _, *words = re.findall(r"^    bounce (.*)$", bounce(name, "-h").stdout, re.MULTILINE)[0].split()
        command = main.commands[name]
        command.make_parser(click.Context(command)).parse_args(words)  # the example has its options
    assert re.search(r"\d+\.\d+", bounce("--version").stdout)


def test_a_terminal_without_greek_letters_gets_them_in_ascii():
    command = [sys.executable, "-m", "service.cli.entry", "threshold", "--help"]
    environment = os.environ | {"PYTHONIOENCODING": "cp1252"}
    done = subprocess.run(command, env=environment, capture_output=True, check=True)
    assert b"per \\u03a9." in done.stdout


# Submitting and following


def test_submit_prints_the_id_alone_so_that_it_can_be_piped(url: str, spec: Path, job: str):
    result = bounce("submit", spec, url=url)
    assert (result.stdout, result.stderr) == (f"{job}\n", "")  # the same sweep
    assert bounce("submit", "-", url=url, input=json.dumps(SPEC)).stdout.strip() == job
    broken = bounce("submit", "-", url=url, input='{"gamma": ')
    assert (broken.exit_code, broken.stdout) == (1, "")
    assert "not JSON" in broken.stderr


def test_status_for_people_and_for_programs(url: str, job: str):
    text = bounce("status", job, url=url).stdout
    assert re.search(r"^state +done$", text, re.MULTILINE)
    assert re.search(r"^progress +100% \(92 of 92 cells, \d+ of \d+ chunks?\)$", text, re.MULTILINE)
    assert bounce("rename", job, "two", url=url).exit_code == 0
    assert re.search("^name +two$", bounce("status", job, url=url).stdout, re.MULTILINE)
    bounce("rename", job, "two ω", url=url)
    view = json.loads(bounce("status", job, "--json", url=url).stdout)
    assert (view["id"], view["state"], view["name"]) == (job, "done", "two ω")
    heading, *rows = bounce("list", url=url).stdout.splitlines()
    assert heading.split() == ["ID", "STATE", "DONE", "CELLS", "NAME"]
    assert f"{job}  done       100%             92  two ω" in rows
    assert job in [view["id"] for view in json.loads(bounce("list", "--json", url=url).stdout)]
    assert json.loads(bounce("list", "--state", "failed", "--json", url=url).stdout) == []


def test_a_shared_file_becomes_a_job(url: str, job: str, tmp_path: Path):
    (tmp_path / "run.csv").write_text("gamma,flight_time\n1.2,4.5\n")
    shared = bounce("share", job, "-o", tmp_path / "a.html", "--data", tmp_path / "run.csv", url=url)
    assert shared.exit_code == 0
    assert (tmp_path / "a.html").read_text().endswith('gamma,flight_time\\n1.2,4.5\\n"}]</script>')
    with pytest.raises(BounceError, match=r"ends in \.html"):
        Client(url).job(job).share(tmp_path / "a.parquet")
    with computing_at(tmp_path / "other") as other:
        assert bounce("import", tmp_path / "a.html", url=other).stdout == f"{job}\n"
        assert bounce("modes", job, url=other).stdout == bounce("modes", job, url=url).stdout
        (tmp_path / "a.html").write_text("a letter")
        refused = bounce("import", tmp_path / "a.html", url=other)
    assert (refused.exit_code, refused.stderr) == (1, "Error: file: is not one that bounce share wrote\n")


# Diagrams


def test_a_diagram_is_written_as_its_name_says(url: str, job: str, tmp_path: Path):
    begins = {"a.png": b"\x89PNG", "a.SVG": b"<?xml", "a.csv": b"flight"}
    for name, begin in begins.items():
        result = bounce("diagram", job, "--omega", 0.5, "-o", tmp_path / name, url=url)
        assert result.exit_code == 0, result.stderr
        assert (tmp_path / name).read_bytes().startswith(begin)
    assert {path.name for path in tmp_path.iterdir()} == set(begins)
    line = ("--along", "omega", "--gamma", 1.5, "--format", "json")
    assert json.loads(bounce("diagram", job, *line, url=url).stdout)["coords"]["omega"]["data"] == [0.5, 0.7]


def test_measured_points_are_drawn_over_a_diagram(url: str, job: str, tmp_path: Path):
    data, path = tmp_path / "measured.csv", tmp_path / "measured.svg"
    data.write_text("gamma,flight_time_ms,frequency\n1.5,15.4,50\n2.0,18.2,50\n")
    drawn = bounce("diagram", job, "--omega", 0.5, "--data", data, "-o", path, url=url)
    assert (drawn.exit_code, path.read_bytes()[:5]) == (0, b"<?xml")
    data.write_text("gamma,time\n1.5,15.4\n")
    refused = bounce("diagram", job, "--omega", 0.5, "--data", data, "-o", path, url=url)
    assert refused.exit_code == 1
    assert "flight_time" in refused.stderr
    refused = bounce("diagram", job, "--omega", 0.5, "--data", data, "-o", tmp_path / "a.csv", url=url)
    assert (refused.exit_code, "png, svg, pdf" in refused.stderr) == (2, True)


def test_an_incomplete_diagram_is_drawn_with_a_warning(tmp_path: Path):
    with serving(tmp_path, Held()) as url, Client(url) as client:
        job = client.submit(sweep())
        result = bounce("diagram", job.id, "-o", tmp_path / "a.png", url=url)
    assert result.exit_code == 0
    assert "incomplete" in result.stderr


# A local service


def test_figure_uses_the_service_that_runs_on_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Figure 1, which needs no sweep."""
    monkeypatch.chdir(tmp_path)
    data, target = tmp_path / "data", tmp_path / "picture.png"
    with computing_at(data, token="auto") as url, tokens.recorder(data) as record:
        record(url)
        result = bounce("figure", 1, "-o", target, "--data", data)
    assert result.exit_code == 0, result.stderr
    assert target.read_bytes().startswith(b"\x89PNG")
    assert (result.stdout, f"{target}\n" in result.stderr) == ("", True)
    assert result.stderr.startswith(f"using the service at {url}, which runs on ")
    assert "starting a local service" not in result.stderr


def test_run_computes_a_sweep_without_a_service(tmp_path: Path):
    small = SPEC | {"gamma": [1.2, 1.3, 1.4], "settle": 20}
    file, whole, line = tmp_path / "sweep.json", tmp_path / "a.zarr", tmp_path / "a.json"
    file.write_text(json.dumps(small))

    assert bounce("run", file, "-o", whole, "--workers", 1).exit_code == 0
    with xarray.open_zarr(whole, chunks=None) as stored:
        assert stored.gamma.values.tolist() == [1.2, 1.3, 1.4]
    for every, cells in (((), [1.2, 1.3, 1.4]), (("--every", 2), [1.2, 1.4])):
        result = bounce("run", "-", "-o", line, "--omega", 0.5, *every, input=json.dumps(small))
        assert (result.exit_code, result.stdout) == (0, "")
        assert json.loads(line.read_text())["coords"]["gamma"]["data"] == cells


def test_a_hangup_that_is_ignored_ends_nothing():
    """As `nohup` asks for."""
    code = (
        "import os, signal, sys; from service.cli import entry, main;"
        "main.main = lambda: os.kill(os.getpid(), signal.SIGHUP);"
        "signal.signal(signal.SIGHUP, getattr(signal, sys.argv[1])); entry.main(); print('goes on')"
    )
    for handler, ended in (("SIG_IGN", (0, "goes on\n")), ("SIG_DFL", (128 + signal.SIGHUP, ""))):
        done = subprocess.run(
            [sys.executable, "-c", code, handler], capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stdout) == ended


@pytest.mark.parametrize(
    ("workers", "stores", "mark", "said"),
    [
        (1, [], "ok", "is ready"),
        (0, [], "!!", "is not ready: the Dask scheduler does not answer; jobs wait until it does"),
        (1, ["f" * 32], "!!", "is ready: stores that the ledger does not know: 1"),
    ],
)
def test_the_doctor_asks_the_service_on_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, workers: int, stores: list[str], mark: str, said: str
):
    """Without the proxy that other requests may need, whatever BOUNCE_URL says."""
    for store in stores:
        (tmp_path / "stores" / f"{store}.zarr").mkdir(parents=True)
    with service_at(tmp_path, Held(capacity=workers)) as url, tokens.recorder(tmp_path) as record:
        record(url)
        if stores:
            wait_for(lambda: bool(httpx2.get(f"{url}/readyz", timeout=DEADLINE).json().get("notices")))
        with monkeypatch.context() as patch:
            for name in ("NO_PROXY", "no_proxy"):
                patch.delenv(name, raising=False)
            patch.setenv("http_proxy", "http://127.0.0.1:9")
            answer = bounce("doctor", "--data", tmp_path)
    (line,) = [line for line in answer.output.splitlines() if line[4:].startswith("service")]
    assert line.startswith(f"{mark}  service           {url} {said}")
    assert answer.exit_code == (mark == "!!")


# Errors


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["list"], 1, "no service answers at"),
        (["list", "--url", "nonsense"], 1, "http://HOST:PORT"),
        (["status", "..%2f..%2fledger"], 1, "32 hex digits"),
        (["submit", "missing.json"], 2, "does not exist"),
        (["figure", "99"], 1, "unknown figure 99; choose one of: 1, 2, 3"),
        (["figure", "1", "--data", ".", "--url", "http://127.0.0.1:9"], 2, "give one"),
        (["diagram", "0" * 32, "-o", "diagram"], 2, "does not end in"),
        (["share", "0" * 32, "-o", "sweep.nc"], 2, "does not end in"),
        (["diagram", "0" * 32, "-o", "-"], 2, "- needs --format: json, "),
        (["tradeoff", "-o", "-"], 2, "must be a file"),
        (["tradeoff", "-o", "tradeoff.gif"], 2, "does not end in"),
        (["modes", "0" * 32, "-o", "/nowhere/modes.csv"], 2, "no folder /nowhere"),
        (["list", "--state", "asleep"], 2, "asleep"),
        (["list", "--from", "yesterday"], 2, "must be a day such as 2026-11-25, not 'yesterday'"),
        (["orbits", "--direction", "up"], 2, "give --omega and --xi or the ID of a job"),
        (["difference", "0" * 32, "1" * 32], 2, "ID --other ID"),
        (["submit", __file__, "--budget", "5s", "--key", "a"], 2, "give one"),
        (["submit", __file__, "--budget", "5s", "--estimate"], 2, "give one"),
        (["run", __file__, "-o", "a.nc", "--omega", "1"], 2, "--omega is of a picture or table"),
        (["figure", "all", "-o", "a.png"], 2, "must be a folder"),
        (["serve", "--port", "99999"], 1, "port"),
        (["serve", "--host", "nowhere.invalid", "--port", "0"], 1, "to listen on nowhere.invalid"),
    ],
)
def test_an_error_is_one_message_and_an_exit_code(words: list[str], code: int, message: str):
    result = bounce(*words)
    assert result.exit_code == code
    assert message in result.stderr
    assert result.stdout == ""
    assert not any(word in result.stderr for word in ("Traceback", "measured"))


def test_a_line_outside_the_grid_leaves_the_file_as_it_was(url: str, job: str, tmp_path: Path):
    path = tmp_path / "a.png"
    path.write_bytes(b"before")
    result = bounce("diagram", job, "--omega", 3, "-o", path, url=url)
    assert result.exit_code == 1
    assert "omega: must be within the sweep" in result.stderr
    assert path.read_bytes() == b"before"


# Processes


def test_a_wait_that_is_interrupted_leaves_the_job_alone(tmp_path: Path):
    with serving(tmp_path, Held()) as url, Client(url) as client:
        job = client.submit(sweep())
        process = subprocess.Popen(
            [BOUNCE, "wait", job.id, "--url", url], stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        process.stderr.readline()
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=DEADLINE)
        assert process.returncode == 130
        assert f"the job continues (cancel it with: bounce cancel {job.id})" in errors
        assert not job.refresh().finished


def test_a_reader_that_goes_away_is_no_error(url: str, job: str):
    listing = subprocess.Popen(
        [BOUNCE, "list", "--url", url], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    listing.stdout.close()
    errors = listing.stderr.read()
    listing.stderr.close()
    listing.wait(DEADLINE)
    assert "Traceback" not in errors


def test_help_that_cannot_be_written_is_one_sentence():
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run([BOUNCE, "--help"], check=False, stdout=full, stderr=subprocess.PIPE)
    assert (ended.returncode, ended.stderr) == (1, b"Error: No space left on device\n")


def test_a_library_that_cannot_be_loaded_is_one_sentence(tmp_path: Path):
    (tmp_path / "pandas.so").write_bytes(b"not a library")
    serve = [BOUNCE, "serve", "--port", "0", "--data", tmp_path / "data"]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    ended = subprocess.run(serve, check=False, capture_output=True, text=True, env=environment)
    assert (ended.returncode, ended.stderr.count("\n")) == (1, 1), ended.stderr
    assert ended.stderr.startswith("Error: a library cannot be loaded")


def test_too_little_address_space_is_one_sentence(spec: Path, tmp_path: Path):
    limited = ["sh", "-c", 'ulimit -v 800000 && exec "$0" "$@"', BOUNCE, "run", spec]
    ended = subprocess.run(
        [*limited, "-o", tmp_path / "a.csv"], check=False, capture_output=True, text=True,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},  # each reserves some
    )  # fmt: skip
    assert (ended.returncode, ended.stderr.count("\n")) == (1, 1), ended.stderr
    assert ended.stderr.startswith("Error: not enough memory")


def test_a_service_that_cannot_say_its_address_does_not_start(tmp_path: Path):
    serve = [BOUNCE, "serve", "--port", "0", "--workers", "1", "--data", tmp_path]
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(serve, check=False, stdout=full, stderr=subprocess.PIPE, text=True)
    assert "Traceback" not in ended.stderr
    assert (ended.returncode, ended.stderr.splitlines()[-1]) == (
        1, "Error: standard output: No space left on device",
    )  # fmt: skip


def test_a_budget_ends_while_its_kernel_compiles(spec: Path, tmp_path: Path):
    ended = subprocess.run(
        [BOUNCE, "run", spec, "--budget", "2s", "-o", tmp_path / "a.zarr"], check=False, capture_output=True,
        env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}, text=True,
    )  # fmt: skip
    assert re.search(r"was over before the .* contact was compiled; \d+s may work", ended.stderr)


def test_no_compilation_outlives_a_budget_that_is_killed(spec: Path, tmp_path: Path):
    cache = tmp_path / "cache"
    running = subprocess.Popen(
        [BOUNCE, "run", spec, "--budget", "5m", "-o", tmp_path / "a.zarr"], stderr=subprocess.DEVNULL,
        env=os.environ | {"NUMBA_CACHE_DIR": str(cache)},
    )  # fmt: skip
    wait_for(lambda: any(cache.rglob("*.lock")))
    [compiler] = psutil.Process(running.pid).children()
    running.kill()
    running.wait()
    compiler.wait(8.0)  # a compilation takes longer
