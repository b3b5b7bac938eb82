"""The command `bounce` against a real service, in this process and as processes of its own."""

import errno
import json
import os
import pty
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import psutil
import pytest
import xarray
from click.testing import CliRunner, Result
from scripted import DEADLINE, TWO_LINES, Held, Scripted, sweep, wait_for

from service import address, local
from service.cli import local_service, options
from service.cli.main import main
from service.cli.output import threshold_table
from service.client import Client, Job
from service.client.client import DEFAULT_URL
from service.figures import catalogue
from service.jobs.ledger import Ledger
from service.server import embedded
from service.settings import Settings
from service.software import software
from worker.analysis.thresholds import Status
from worker.executors.base import Executor
from worker.executors.dask import Dask
from worker.executors.inline import Inline

BOUNCE = str(Path(sys.executable).with_name("bounce"))
COMMANDS = [
    "adopt", "backup", "basins", "cancel", "completion", "curves", "delete", "diagram", "doctor", "export",
    "figure", "follow", "list", "metrics", "modes", "multistability", "open", "orbits", "restore", "resume",
    "run", "serve", "status", "submit", "threshold", "tradeoff", "trajectory", "wait", "watch",
]  # fmt: skip

SPEC = {**TWO_LINES, "name": "two ω"}


def serving(folder: Path, executor: Executor, **options: object):
    settings = Settings(data=folder / "data", port=0, heartbeat_seconds=0.2, shutdown_seconds=1.0, **options)
    return embedded.running(settings, executor)


def bounce(*words: object, url: str = "http://127.0.0.1:9", **options: object) -> Result:
    """Run a command line in this process; nothing but SystemExit may come out of it."""
    result = CliRunner(env={"BOUNCE_URL": url}).invoke(main, [str(word) for word in words], **options)
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exc_info
    return result


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    executor = Inline()
    with serving(tmp_path_factory.mktemp("cli"), executor) as url:
        yield url
    executor.close()


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
    listed = dict(re.findall(r"^  ([a-z]+)  +(.+)$", text.split("Commands:")[1], re.MULTILINE))
    assert sorted(listed) == COMMANDS
    assert not [line for line in listed.values() if line.endswith("...")]


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command: str):
    result = bounce(command, "-h")
    assert result.exit_code == 0
    assert "Usage:" in result.stdout


def test_the_version_is_printed():
    assert re.search(r"\d+\.\d+", bounce("--version").stdout)


# Submitting and following


def test_submit_prints_the_id_alone_so_that_it_can_be_piped(url: str, spec: Path, job: str):
    result = bounce("submit", spec, url=url)
    assert re.fullmatch(r"[0-9a-f]{32}\n", result.stdout)
    assert result.stdout.strip() == job  # the same sweep
    assert result.stderr == ""


def test_submit_reads_standard_input(url: str, job: str):
    assert bounce("submit", "-", url=url, input=json.dumps(SPEC)).stdout.strip() == job
    broken = bounce("submit", "-", url=url, input='{"gamma": ')
    assert (broken.exit_code, broken.stdout) == (1, "")
    assert "not JSON" in broken.stderr


def test_waiting_writes_plain_lines_where_there_is_no_terminal(url: str, tmp_path: Path):
    path = tmp_path / "sweep.json"
    path.write_text(json.dumps(SPEC | {"settle": 21, "name": "plain"}))
    result = bounce("submit", path, "--wait", url=url)
    assert result.exit_code == 0
    *lines, note = result.stderr.splitlines()
    assert re.fullmatch(
        r"\d+ of 92 cells were still settling: give them more time with settle_until .*", note
    )
    assert lines[-1] == f"{result.stdout[:8]} plain: done, 100% (92 of 92 cells)"
    assert all(re.match(r"[0-9a-f]{8} plain: (queued|running|done), \d+% ", line) for line in lines)
    assert "\x1b" not in result.stderr


def test_wait_on_a_job_that_is_done_returns(url: str, job: str):
    result = bounce("wait", job, url=url)
    assert (result.exit_code, result.stdout) == (0, "")


def test_status_for_people_and_for_programs(url: str, job: str):
    text = bounce("status", job, url=url).stdout
    assert re.search(r"^state +done$", text, re.MULTILINE)
    assert re.search(r"^progress +100% \(92 of 92 cells, \d+ of \d+ chunks\)$", text, re.MULTILINE)
    view = json.loads(bounce("status", job, "--json", url=url).stdout)
    assert (view["id"], view["state"], view["name"]) == (job, "done", "two ω")


def test_list_for_people_and_for_programs(url: str, job: str):
    heading, *rows = bounce("list", url=url).stdout.splitlines()
    assert heading.split() == ["ID", "STATE", "DONE", "CELLS", "NAME"]
    assert f"{job}  done       100%             92  two ω" in rows
    assert job in [view["id"] for view in json.loads(bounce("list", "--json", url=url).stdout)]
    assert bounce("list", "--state", "failed", url=url).stdout.splitlines() == [heading]
    assert json.loads(bounce("list", "--state", "failed", "--json", url=url).stdout) == []


def test_cancel_and_what_follows(tmp_path: Path):
    held = Held()
    with serving(tmp_path, held) as url, Client(url) as client:
        job = client.submit(sweep("long"))
        wait_for(held.held)
        result = bounce("cancel", job.id, url=url)
        assert (result.exit_code, result.stdout) == (0, "")
        assert re.search("long: running, .*, cancel requested$", result.stderr.strip())
        wait_for(held.told_to_stop)
        held.let_go_until(lambda: job.refresh().finished)
        result = bounce("wait", job.id, url=url)
        assert result.exit_code == 1
        assert "was cancelled" in result.stderr


def test_a_failed_job_ends_the_wait_with_its_reason(tmp_path: Path):
    executor = Scripted({0: [ValueError("the roof fell in")] * 99})
    with serving(tmp_path, executor, failed_chunks=1) as url, Client(url) as client:
        result = bounce("wait", client.submit(sweep()).id, url=url)
    executor.close()
    assert result.exit_code == 1
    assert "the roof fell in" in result.stderr


def test_a_wait_has_a_timeout(tmp_path: Path):
    with serving(tmp_path, Held()) as url, Client(url) as client:
        result = bounce("wait", client.submit(sweep()).id, "--timeout", "0.2", url=url)
    assert result.exit_code == 1
    assert "the job continues" in result.stderr


def interrupted(*_: object, **__: object) -> None:
    """As Ctrl-C ends it."""
    raise KeyboardInterrupt


def test_a_wait_that_is_interrupted_says_that_the_job_continues(
    url: str, job: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(Job, "wait", interrupted)
    result = bounce("wait", job, url=url)
    assert (result.exit_code, result.stdout) == (130, "")
    assert result.stderr == f"stopped waiting; the job continues (cancel it with: bounce cancel {job})\n"


# Thresholds


RAMPED = {**TWO_LINES, "omega": 0.5, "protocol": {"kind": "ramp", "axis": "gamma", "direction": "both"}}


@pytest.mark.parametrize(
    ("gamma", "row", "notes"),
    [
        ([2.0, 2.5], ["≤ 2.0", "≤ 2.0"], ["≤ 2.0: bounces already at the lowest Γ, 2.0: start lower"]),
        (
            [0.1, 0.2],
            ["> 0.2", "never"],
            [
                "> 0.2: at rest up to the highest Γ, 0.2: end higher",
                "never: no cell of the ramp down bounces, so no bouncing ends: start it higher",
            ],
        ),
    ],
)
@pytest.mark.parametrize("tolerance", [(), ("--tolerance", "1e-5")])
def test_a_threshold_outside_the_grid_is_printed_as_a_bound(
    url: str, gamma: list[float], row: list[str], notes: list[str], tolerance: tuple[str, ...]
):
    with Client(url) as client:
        job = client.submit({**RAMPED, "gamma": gamma, "settle": 300, "observe": 60}).wait(progress=False)
        eq_25 = float(client.threshold(0.5, 0.26).threshold)
    result = bounce("threshold", job.id, *tolerance, url=url)
    _, heading, line, *rest = result.stdout.splitlines()
    assert heading.split() == ["OMEGA", "EQ.", "25", "UP", "DOWN", "PREDICTED"]
    omega, analytic, *bounds, predicted = re.split(r" {2,}", line.strip())
    assert (float(omega), bounds, rest[:-1]) == (0.5, row, notes)
    assert float(predicted) == pytest.approx(eq_25, abs=1e-6)  # no hysteresis here
    predicted_of = "PREDICTED: the lowest that bounces by the closed form, rigid, restitution 0"
    assert rest[-1] == f"{predicted_of}: the contact of the sweep"
    assert float(analytic) == pytest.approx(eq_25, abs=1e-6)


#: What thresholds say of the closed form, in variables over omega and in an attribute.
PREDICTION = {"predicted_down": np.nan, "cause": "unresolved", "difference": ""}
PREDICTED = {"prediction": "rigid"}


def test_a_sweep_from_rest_has_no_threshold_on_the_way_down(url: str, job: str):
    _, _, *lines, note, predicted = bounce("threshold", job, url=url).stdout.splitlines()
    assert [line.split()[3] for line in lines] == ["-", "-"]
    assert note == "-: the sweep is not ramped down"
    assert predicted.startswith("PREDICTED: ")


def test_a_threshold_that_could_not_be_refined_is_bounded_by_the_grid():
    def dataset(up: float, **attributes: object) -> xarray.Dataset:
        status = "not refined" if np.isnan(up) else "found"
        columns = {
            "analytic": np.inf,
            "up": up,
            "down": np.nan,
            "up_status": status,
            "down_status": "not ramped",
            **PREDICTION,
        }
        variables = {name: ("omega", [value]) for name, value in columns.items()}
        return xarray.Dataset(
            variables, {"omega": [0.5], "xi": 0.26}, {"complete": 1, **PREDICTED, **attributes}
        )

    text = threshold_table(dataset(np.nan, tolerance=1e-3), dataset(2.5), TWO_LINES | {"omega": 0.5})
    _, _, line, *notes = text.splitlines()
    assert re.split(r" {2,}", line.strip()) == ["0.500000", "inf", "≤ 2.5*", "-", "unresolved"]
    assert notes == [
        "≤ 2.5*: not refined; the lowest Γ of the grid that bounces",
        "-: the sweep is not ramped down",
        "PREDICTED: the lowest that bounces by the closed form, rigid",
    ]


@pytest.mark.parametrize("status", list(Status))
@pytest.mark.parametrize("direction", ["up", "down"])
def test_every_status_of_a_threshold_is_explained(status: Status, direction: str):
    if status is Status.FOUND:
        return
    variables = {name: ("omega", [np.nan]) for name in ("analytic", "up", "down")}
    statuses = {name: ("omega", ["not ramped"]) for name in ("up_status", "down_status")}
    statuses[f"{direction}_status"] = ("omega", [str(status)])
    variables |= {name: ("omega", [value]) for name, value in PREDICTION.items()}
    attributes = {"complete": 1, **PREDICTED}
    dataset = xarray.Dataset(variables | statuses, {"omega": [0.5], "xi": 0.26}, attributes)
    notes = threshold_table(dataset, dataset, TWO_LINES).splitlines()[3:]
    assert len(notes) == 3
    assert all(": " in note for note in notes)


def test_a_threshold_that_is_not_computed_yet_is_not_a_bound(tmp_path: Path):
    with serving(tmp_path, Held()) as url, Client(url) as client:
        _, _, line, *notes = bounce("threshold", client.submit(sweep()).id, url=url).stdout.splitlines()
    assert line.split()[2] == "?"
    assert "?: the cell that decides is not computed yet" in notes
    assert notes[-1] == "the job is not done: thresholds may be missing"


# Diagrams


@pytest.mark.parametrize(
    ("name", "begin"), [("a.png", b"\x89PNG"), ("a.SVG", b"<?xml"), ("a.csv", b"direction,")]
)
def test_a_diagram_is_written_as_its_name_says(url: str, job: str, tmp_path: Path, name: str, begin: bytes):
    result = bounce("diagram", job, "--omega", 0.5, "-o", tmp_path / name, url=url)
    assert result.exit_code == 0, result.stderr
    assert (tmp_path / name).read_bytes().startswith(begin)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_diagram_goes_to_standard_output(url: str, job: str):
    result = bounce(
        "diagram", job, "--along", "omega", "--gamma", 1.5, "--format", "json", "-o", "-", url=url
    )
    assert json.loads(result.stdout)["values"] == [0.5, 0.7]


def test_an_incomplete_diagram_is_drawn_with_a_warning(tmp_path: Path):
    with serving(tmp_path, Held()) as url, Client(url) as client:
        job = client.submit(sweep())
        result = bounce("diagram", job.id, "-o", tmp_path / "a.png", url=url)
    assert result.exit_code == 0
    assert "incomplete" in result.stderr


# A local service


def test_the_commands_use_the_clients_default_address():
    assert options.DEFAULT_URL == DEFAULT_URL


def figure_1(*words: object, **environment: str | None) -> Result:
    """Figure 1, which needs no sweep."""
    environment = {"BOUNCE_URL": None, **environment}
    result = CliRunner(env=environment).invoke(main, ["figure", "1", *map(str, words)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exc_info
    return result


def is_picture(file: Path) -> bool:
    return file.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("how", ["variable", "option", "data folder", "named folder"])
def test_figure_uses_a_running_service(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str):
    monkeypatch.chdir(tmp_path)
    settings = Settings(data=tmp_path / "data", port=0, heartbeat_seconds=0.2, token="auto")
    target = tmp_path / "picture.png"
    with (
        closing(Inline()) as executor,
        embedded.running(settings, executor) as url,
        address.recorder(settings.data) as record,
    ):
        record(url)
        token = json.loads((settings.data / "token.json").read_text())["token"]
        if how == "variable":
            result = figure_1("-o", target, BOUNCE_URL=url, BOUNCE_TOKEN=token)
        elif how == "option":
            result = figure_1("-o", target, "--url", url, "--token", token)
        elif how == "data folder":
            result = figure_1("-o", target, BOUNCE_DATA=str(settings.data))
        else:
            result = figure_1("-o", target, "--data", settings.data, BOUNCE_URL="http://127.0.0.1:9")
    assert result.exit_code == 0, result.stderr
    assert is_picture(target)
    assert (result.stdout, f"{target}\n" in result.stderr) == ("", True)
    if "folder" in how:
        assert result.stderr.startswith(f"using the service at {url}, which runs on ")
    assert "starting a local service" not in result.stderr


def test_all_figures_are_made_in_a_folder_that_is_there_already(
    tmp_path: Path, url: str, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(catalogue, "FIGURES", {1: catalogue.FIGURES[1]})
    result = CliRunner().invoke(main, ["figure", "all", "-o", str(tmp_path), "--url", url])
    assert result.exit_code == 0, result.stderr
    assert is_picture(tmp_path / "figure-1.png")


def test_signals_end_a_command_that_uses_a_running_service_too(tmp_path: Path):
    settings = Settings(data=tmp_path, port=0)
    with embedded.running(settings, Held()) as url, address.recorder(settings.data) as record:
        record(url)
        with local_service.persistent_service(None, str(tmp_path), None) as used:
            assert used.url == url
            assert signal.getsignal(signal.SIGTERM) is local_service._end
    assert signal.getsignal(signal.SIGTERM) is not local_service._end


def test_run_computes_a_sweep_without_a_service(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    small = SPEC | {"gamma": [1.2, 1.3, 1.4], "settle": 20}
    file, whole, line = tmp_path / "sweep.json", tmp_path / "a.zarr", tmp_path / "a.json"
    file.write_text(json.dumps(small))
    with monkeypatch.context() as patch:
        patch.setattr(local, "_wait", interrupted)
        result = bounce("run", file, "-o", whole)
        assert (result.exit_code, result.stdout, whole.exists()) == (130, "", False)
        assert result.stderr.endswith(f"interrupted; the same command goes on in {whole}.partial\n")
    assert bounce("run", file, "-o", whole, "--workers", 1).exit_code == 0
    with xarray.open_zarr(whole, chunks=None) as stored:
        assert stored.gamma.values.tolist() == [1.2, 1.3, 1.4]
    for every, cells in (((), [1.2, 1.3, 1.4]), (("--every", 2), [1.2, 1.4])):
        result = bounce("run", "-", "-o", line, "--omega", 0.5, *every, input=json.dumps(small))
        assert (result.exit_code, result.stdout) == (0, "")
        assert json.loads(line.read_text())["values"] == cells


def test_a_service_on_the_data_folder_is_used_only_with_a_token_that_it_accepts(tmp_path: Path):
    settings = Settings(data=tmp_path, port=0, token="auto")
    with embedded.running(settings, Held()) as url, address.recorder(settings.data) as record:
        assert local_service._running_on(tmp_path, None) is None
        record(url)
        token = json.loads((tmp_path / "token.json").read_text())["token"]
        for given in (None, "", "auto", token):
            assert local_service._running_on(tmp_path, given) == (url, token)
        assert local_service._running_on(tmp_path, "a-token-of-another-service") is None


@pytest.fixture
def hangup() -> Iterator[None]:
    before = signal.getsignal(signal.SIGHUP)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_local_service_and_a_second_one_does_not_interrupt_that(
    hangup: None, number: signal.Signals
):
    signal.signal(signal.SIGHUP, signal.default_int_handler)
    before = [signal.getsignal(each) for each in (signal.SIGTERM, signal.SIGHUP)]
    cleaned = False

    def work() -> None:
        nonlocal cleaned
        with local_service.ended_by_signals():
            try:
                os.kill(os.getpid(), number)
            finally:
                os.kill(os.getpid(), signal.SIGTERM)
                os.kill(os.getpid(), signal.SIGHUP)
                cleaned = True

    with pytest.raises(SystemExit) as ended:
        work()
    assert (ended.value.code, cleaned) == (128 + number, True)
    assert [signal.getsignal(each) for each in (signal.SIGTERM, signal.SIGHUP)] == before


def test_a_hangup_that_is_ignored_ends_nothing(hangup: None):
    """As `nohup` asks for."""
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    with local_service.ended_by_signals():
        os.kill(os.getpid(), signal.SIGHUP)
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN


def test_figure_computes_in_a_temporary_folder_if_another_command_has_the_data_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    with Ledger(tmp_path / "bounce-data" / "ledger.sqlite"):
        result = figure_1("--workers", "1")
    assert result.exit_code == 0, result.stderr
    assert "another service uses the data folder: using a temporary one\n" in result.stderr
    assert is_picture(Path("figure-1.png"))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_to_figure_leaves_no_temporary_folder_and_no_process(tmp_path: Path, number: signal.Signals):
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    with (
        Ledger(tmp_path / "bounce-data" / "ledger.sqlite"),
        subprocess.Popen(
            [BOUNCE, "figure", "2", "--workers", "1"], cwd=tmp_path, stderr=subprocess.PIPE,
            env=os.environ | {"TMPDIR": str(temporary)},
            # Not ignored, as `nohup` has it for all that it starts.
            preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),  # noqa: PLW1509
        ) as process,
    ):  # fmt: skip
        assert process.stderr
        lines = iter(process.stderr.readline, b"")
        assert next(line for line in lines if b"using a temporary one" in line)
        wait_for(lambda: list(temporary.glob("bounce-*/ledger.sqlite")))
        family = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(number)
        assert process.wait(DEADLINE) == 128 + number
    assert list(temporary.iterdir()) == []
    assert psutil.wait_procs(family, DEADLINE)[1] == []


def test_figure_takes_a_folder_or_a_service(tmp_path: Path, url: str):
    result = figure_1("--data", tmp_path, "--url", url)
    assert result.exit_code == 2
    assert "give one" in result.stderr


def test_figure_does_not_replace_a_data_folder_that_was_named(tmp_path: Path):
    with Ledger(tmp_path / "ledger.sqlite"):
        result = figure_1("--data", tmp_path, "-o", tmp_path / "figure-1.png")
    assert result.exit_code == 1
    assert "another service uses the data folder" in result.stderr
    assert not (tmp_path / "figure-1.png").exists()


# Errors


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["list"], 1, "no service answers at"),
        (["list", "--url", "nonsense"], 1, "http://HOST:PORT"),
        (["status", "nonsense"], 1, "32 hex digits"),
        (["status"], 2, "Missing argument"),
        (["bounce"], 2, "No such command"),
        (["submit", "missing.json"], 2, "does not exist"),
        (["figure", "99"], 1, "unknown figure 99; choose one of: 1, 2, 3"),
        (["figure", "two"], 1, "unknown figure two; choose one of: 1, 2, 3"),
        (["figure", "2", "-o", "figure.gif"], 2, ".png, .svg"),
        (["figure", "2", "-o", "/nowhere/figure.png"], 2, "no folder"),
        (["diagram", "0" * 32, "-o", "diagram"], 2, "does not end in"),
        (["diagram", "0" * 32, "--format", "png", "-o", "/nowhere/diagram"], 2, "no folder /nowhere"),
        (["diagram", "0" * 32], 2, "Missing option '-o'"),
        (["list", "--state", "asleep"], 2, "asleep"),
        (["wait", "0" * 32, "--timeout", "-1"], 2, "timeout"),
        (["serve", "--port", "99999"], 1, "port"),
        (["serve", "--workers", "0"], 1, "workers"),
        (["serve", "--host", "nowhere.invalid", "--port", "0"], 1, "to listen on nowhere.invalid"),
    ],
)
def test_an_error_is_one_message_and_an_exit_code(words: list[str], code: int, message: str):
    result = bounce(*words)
    assert result.exit_code == code
    assert message in result.stderr
    assert result.stdout == ""
    assert "Traceback" not in result.stderr


def test_an_error_of_the_file_system_names_the_file(url: str, job: str, tmp_path: Path):
    result = bounce("diagram", job, "--omega", 0.5, "-o", tmp_path / f"{'a' * 250}.png", url=url)
    assert (result.exit_code, result.stdout) == (1, "")
    assert re.fullmatch(f"Error: {tmp_path}/.*: File name too long\n", result.stderr)


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (OSError(errno.ENOSPC, "No space left"), "No space left"),
        (OSError("odd"), "odd"),
        (BrokenPipeError(errno.EPIPE, "Broken pipe"), None),
        (ValueError("a defect"), None),
    ],
)
def test_an_error_that_is_no_defect_has_a_message(error: Exception, message: str | None):
    assert options._message(error) == message


def test_a_bad_specification_names_field_and_rule(url: str, tmp_path: Path):
    path = tmp_path / "sweep.json"
    path.write_text(json.dumps(SPEC | {"omega": -0.5}))
    result = bounce("submit", path, url=url)
    assert (result.exit_code, result.stdout) == (1, "")
    assert "omega: must be at least" in result.stderr


def test_a_line_outside_the_grid_leaves_the_file_as_it_was(url: str, job: str, tmp_path: Path):
    path = tmp_path / "a.png"
    path.write_bytes(b"before")
    result = bounce("diagram", job, "--omega", 3, "-o", path, url=url)
    assert result.exit_code == 1
    assert "omega: must be within the sweep" in result.stderr
    assert path.read_bytes() == b"before"
    assert bounce("diagram", job, "--omega", 0.5, "-o", tmp_path / "no" / "a.png", url=url).exit_code == 2


@pytest.mark.parametrize("content", [b"not a database, and not one line of it " * 99, None])
def test_an_unusable_ledger_is_reported(tmp_path: Path, content: bytes | None):
    ledger = tmp_path / "ledger.sqlite"
    ledger.mkdir() if content is None else ledger.write_bytes(content)
    result = bounce("serve", "--port", "0", "--data", tmp_path)
    assert (result.exit_code, result.stdout) == (1, "")
    assert "ledger.sqlite cannot be used" in result.stderr


def test_a_pipe_is_written_to_and_not_replaced(url: str, job: str, tmp_path: Path):
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        line = ("diagram", job, "--omega", 0.5, "--every", 40)
        assert bounce(*line, "-o", pipe, url=url).exit_code == 0
        assert pipe.is_fifo()
        assert os.read(reader, 10) == b"direction,"
    finally:
        os.close(reader)


def test_settings_from_the_environment_are_checked_like_options(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("BOUNCE_WORKERS", "many")
    result = bounce("serve", "--port", "0")
    assert result.exit_code == 1
    assert "workers" in result.stderr


# Processes


class Serve:
    """`bounce serve` as a process of its own."""

    def __init__(self, folder: Path, *options: str) -> None:
        self.log = (folder / "log").open("w+")
        words = [BOUNCE, "serve", "--port", "0", "--data", str(folder / "data"), *options]
        self.process = subprocess.Popen(
            words, stdout=subprocess.PIPE, stderr=self.log, text=True, start_new_session=True
        )

    def line(self) -> str:
        assert self.process.stdout
        line = self.process.stdout.readline()
        self.log.seek(0)
        assert line, self.log.read()
        return line

    def end(self, number: int) -> int:
        """Its exit code, once it and everything it started have ended."""
        family = psutil.Process(self.process.pid).children(recursive=True)
        self.process.send_signal(number)
        code = self.process.wait(DEADLINE)
        _, left = psutil.wait_procs(family, timeout=DEADLINE)
        assert left == []
        return code

    def close(self) -> None:
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.communicate()
        self.log.close()


@pytest.fixture
def serve(tmp_path: Path, cluster: Dask) -> Iterator[Serve]:
    """Started after the shared cluster has compiled the kernels, which this service then only reads."""
    serve = Serve(tmp_path)
    yield serve
    serve.close()


def run(*words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [BOUNCE, *words],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        timeout=DEADLINE,
        check=False,
    )


def test_serve_computes_locks_its_data_and_stops_on_a_signal(serve: Serve, spec: Path):
    line = serve.line()
    (url,) = re.findall(
        r"^bounce listens on (http://127\.0\.0\.1:\d+) \(data in .*, 2 worker processes\)$", line
    )

    submitted = run("submit", str(spec), "--wait", BOUNCE_URL=url)
    assert submitted.returncode == 0, submitted.stderr
    assert json.loads(run("list", "--json", BOUNCE_URL=url).stdout)[0]["id"] == submitted.stdout.strip()

    data = line.split("data in ")[1].split(",")[0]
    assert address.find(Path(data)) == url
    assert json.loads(run("list", "--json", BOUNCE_DATA=data).stdout)[0]["id"] == submitted.stdout.strip()
    second = run("serve", "--port", "0", "--data", data, "--workers", "1")
    assert second.returncode == 1
    assert "another service uses the data folder" in second.stderr
    assert "Traceback" not in second.stderr

    port = url.rsplit(":", 1)[1]
    third = run("serve", "--port", port, "--data", data)
    assert third.returncode == 1
    assert (
        f"cannot listen on 127.0.0.1 port {port}: a bouncing-spring service (release {software().release}, "
        f"data in {data}) has it; take another one with --port"
    ) in third.stderr

    assert serve.end(signal.SIGTERM) == 0
    assert not (Path(data) / "service.json").exists()


def test_serve_stops_while_it_is_still_starting(serve: Serve):
    wait_for(lambda: len(psutil.Process(serve.process.pid).children(recursive=True)) >= 2)
    assert serve.end(signal.SIGINT) == 130


def test_a_wait_that_is_interrupted_leaves_the_job_alone(tmp_path: Path):
    with serving(tmp_path, Held()) as url, Client(url) as client:
        job = client.submit(sweep())
        process = subprocess.Popen(
            [BOUNCE, "wait", job.id, "--url", url], stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        assert process.stderr
        process.stderr.readline()
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=DEADLINE)
        assert process.returncode == 130
        assert f"the job continues (cancel it with: bounce cancel {job.id})" in errors
        assert not job.refresh().finished


def test_a_terminal_gets_a_bar(url: str, job: str):
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [BOUNCE, "wait", job, "--url", url],
        stderr=theirs,
        env=os.environ | {"TERM": "xterm", "COLUMNS": "120"},
    )
    os.close(theirs)
    shown = b""
    try:
        while part := os.read(ours, 4096):
            shown += part
    except OSError:  # the other side has closed
        pass
    os.close(ours)
    assert process.wait(DEADLINE) == 0
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown.decode())
    assert "━━━" in text
    assert "100%" in text
    assert "done, 92 of 92 cells" in text


def test_a_reader_that_goes_away_is_no_error(url: str, job: str):
    listing = subprocess.Popen(
        [BOUNCE, "list", "--url", url], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert listing.stdout
    listing.stdout.close()
    assert listing.stderr
    errors = listing.stderr.read()
    listing.stderr.close()
    listing.wait(DEADLINE)
    assert "Traceback" not in errors
