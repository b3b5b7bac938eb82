"""Processes that compute answers: what they return and raise, their priority, and their end."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from functools import partial
from http.client import HTTPConnection
from multiprocessing import active_children
from operator import itemgetter
from pathlib import Path

import psutil
import pytest
from paths import ROOT
from scripted import DEADLINE, Held, wait_for
from served import listening

from kernel.numerics.cache import compiling
from service import background
from service.api import capacity
from service.api.app import create_app
from service.background import NICER, Asker, InThisProcess, Processes
from service.errors import InvalidRequest, NotComputed
from service.jobs.on_demand import ABANDONED_SECONDS
from service.server.web_server import limited
from service.settings import Settings
from worker.executors.dask import Dask
from worker.executors.inline import Inline
from worker.store import StoreDamaged


@pytest.fixture(scope="module")
def processes() -> Iterator[Processes]:
    with closing(Processes(2)) as processes:
        yield processes


def damaged() -> None:
    raise StoreDamaged("a chunk", ((0, 1, 2, 3),))


def refused() -> None:
    raise InvalidRequest.of("xi", "is required")


def unsendable() -> object:
    return lambda: None


def test_a_result_comes_back(processes: Processes):
    assert processes.run(divmod, 17, 5) == (3, 2)
    assert processes.run(os.getpid) != os.getpid()
    assert processes.run(os.nice, 0) == os.nice(0) + NICER
    assert processes.run(os.sched_getscheduler, 0) == os.SCHED_BATCH
    assert all(child.daemon for child in active_children())
    assert InThisProcess().run(divmod, 17, 5) == (3, 2)


def test_errors_come_back_as_they_were_raised(processes: Processes):
    with pytest.raises(StoreDamaged, match="a chunk") as caught:
        processes.run(damaged)
    assert caught.value.chunks == ((0, 1, 2, 3),)
    with pytest.raises(InvalidRequest, match="xi: is required") as refusal:
        processes.run(refused)
    assert [problem.field for problem in refusal.value.problems] == ["xi"]
    with pytest.raises(RuntimeError, match="cannot be sent"):
        processes.run(unsendable)
    assert processes.run(divmod, 17, 5) == (3, 2)


def test_a_process_that_dies_fails_its_answer_alone(processes: Processes):
    with pytest.raises(NotComputed, match="repeat the request"):
        processes.run(os._exit, 1)
    assert processes.run(divmod, 17, 5) == (3, 2)


def hold(megabytes: int) -> int:
    """Keep so much memory in this process for good."""
    globals()["kept"] = b"x" * (megabytes << 20)
    return os.getpid()


def test_a_process_that_dies_idle_is_replaced(processes: Processes):
    pid = processes.run(os.getpid)
    os.kill(pid, signal.SIGKILL)
    wait_for(lambda: pid not in [child.pid for child in active_children()])  # all its threads have ended
    assert processes.run(os.getpid) != pid


def test_a_process_that_holds_much_memory_after_an_answer_is_replaced():
    with closing(Processes(1)) as processes:
        first = processes.run(hold, 1)
        assert processes.run(hold, 500) == first
        child = psutil.Process(processes.run(os.getpid))
        assert child.pid != first
        assert not psutil.pid_exists(first)


def stay_busy(begun: Path, until: Callable[[], bool]) -> int:
    """Tell that this process has begun, and work until this holds."""
    begun.touch()
    wait_for(until)
    return os.getpid()


def start_both(processes: Processes, folder: Path) -> list[int]:
    """Have two answers that end once both processes have started."""
    go, begun = folder / "go", [folder / "first", folder / "second"]
    with ThreadPoolExecutor(2) as pool:
        answers = pool.map(processes.run, [stay_busy] * 2, begun, [go.exists] * 2)
        wait_for(lambda: all(each.exists() for each in begun))
        go.touch()
        return list(answers)


def test_idle_processes_end_by_one_thread_for_all_answers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(background, "IDLE_SECONDS", 2.0)
    with closing(Processes(2)) as processes:
        started = start_both(processes, tmp_path)
        before = threading.active_count()
        for _ in range(50):
            processes.run(abs, 1)
        assert threading.active_count() <= before + 1
        wait_for(lambda: sum(map(psutil.pid_exists, started)) == 1)


def note(folder: Path) -> None:
    """Write down the priority of this process, and from when until when it was noted."""
    began = time.time()
    time.sleep(0.5)
    (folder / str(os.getpid())).write_text(json.dumps([os.nice(0), began, time.time()]))


def test_they_start_one_after_another_at_the_priority_of_the_service(tmp_path: Path):
    with closing(Processes(2, partial(note, tmp_path))) as processes:
        start_both(processes, tmp_path)
    notes = (json.loads(noted.read_text()) for noted in tmp_path.glob("[0-9]*"))
    first, second = sorted(notes, key=itemgetter(1))
    assert first[0] == second[0] == os.nice(0)
    assert first[2] <= second[1]


def start_late(folder: Path) -> None:
    """Start at once as the first process, as another one never."""
    (folder / str(os.getpid())).touch()
    wait_for(lambda: len(list(folder.iterdir())) == 1)


def test_an_answer_takes_an_idle_process_while_its_own_starts(tmp_path: Path):
    (started := tmp_path / "started").mkdir()
    begun, go = tmp_path / "begun", tmp_path / "go"
    with closing(Processes(2, partial(start_late, started))) as processes, ThreadPoolExecutor(2) as pool:
        first = processes.run(os.getpid)
        busy = pool.submit(processes.run, stay_busy, begun, go.exists)
        wait_for(begun.exists)
        waiting = pool.submit(processes.run, os.getpid)
        wait_for(lambda: len(list(started.iterdir())) == 2)
        go.touch()
        assert busy.result() == waiting.result() == first


def die_second(folder: Path) -> None:
    """Die as the second process that starts."""
    (folder / str(os.getpid())).touch()
    if len(list(folder.iterdir())) == 2:
        os._exit(1)


def test_a_process_that_cannot_start_fails_one_answer(tmp_path: Path):
    (started := tmp_path / "started").mkdir()
    begun, go = tmp_path / "begun", tmp_path / "go"
    with closing(Processes(2, partial(die_second, started))) as processes, ThreadPoolExecutor(4) as pool:
        processes.run(abs, 1)
        busy = pool.submit(processes.run, stay_busy, begun, go.exists)
        wait_for(begun.exists)
        errors = [answer.exception() for answer in [pool.submit(processes.run, abs, 1) for _ in range(3)]]
        go.touch()
        busy.result()
    assert [type(error) for error in errors if error] == [NotComputed]


def test_they_end_when_closed_also_while_computing(tmp_path: Path):
    begun = tmp_path / "begun"
    computation = f"import pathlib, signal; pathlib.Path({str(begun)!r}).touch(); signal.pause()"
    with closing(Processes(1)) as processes, ThreadPoolExecutor(1) as pool:
        child = psutil.Process(processes.run(os.getpid))
        waiting = pool.submit(processes.run, exec, computation)
        wait_for(begun.exists)
        processes.close()
        with pytest.raises(NotComputed):
            waiting.result(DEADLINE)
        with pytest.raises(NotComputed):
            processes.run(os.getpid)
    child.wait(DEADLINE)


def compile_and_wait(begun: Path, compiled: Path) -> None:
    with compiling("rigid kernel"):
        begun.touch()
        time.sleep(1.0)
        compiled.touch()
    signal.pause()


def test_a_kernel_is_compiled_to_its_end_for_a_client_that_leaves(tmp_path: Path):
    begun, compiled = tmp_path / "begun", tmp_path / "compiled"
    leaving = Asker()
    with closing(Processes(1)) as processes, ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(leaving.run, partial(processes.run, compile_and_wait, begun, compiled))
        wait_for(begun.exists)
        leaving.leave()
        with pytest.raises(NotComputed):
            waiting.result(DEADLINE)
        assert compiled.exists()


def test_a_frozen_process_gives_its_place_back_when_the_client_leaves(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(background, "STOP_SECONDS", 0.5)
    leaving = Asker()
    with closing(Processes(1)) as processes, ThreadPoolExecutor(1) as pool:
        os.kill(processes.run(os.getpid), signal.SIGSTOP)
        waiting = pool.submit(leaving.run, partial(processes.run, os.getpid))
        wait_for(lambda: leaving._stop is not background._do_nothing)  # it is called
        leaving.leave()
        with pytest.raises(NotComputed):
            waiting.result(DEADLINE)
        assert processes.run(divmod, 17, 5) == (3, 2)


def blocks_interrupts(pid: int) -> bool:
    status = Path(f"/proc/{pid}/status").read_text()
    [blocked] = [line.split()[1] for line in status.splitlines() if line.startswith("SigBlk:")]
    return bool(int(blocked, 16) >> (signal.SIGINT - 1) & 1)


@pytest.mark.parametrize("busy", [False, True])
def test_they_end_with_the_service_that_is_killed_and_not_with_ctrl_c(tmp_path: Path, busy: bool):
    script = tmp_path / "main.py"
    script.write_text(
        "import signal, sys\nfrom service.background import Processes\n"
        "if __name__ == '__main__':\n    Processes(1).run(exec, sys.argv[1])\n    signal.pause()\n"
    )
    code = f"import os\nprint(os.getpid(), flush=True)\nwhile {busy}: pass"
    command = [sys.executable, str(script), code]
    env = os.environ | {"PYTHONPATH": str(ROOT)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=env) as process:
        child = psutil.Process(int(process.stdout.readline()))
        assert (blocks_interrupts(process.pid), blocks_interrupts(child.pid)) == (False, True)
        process.kill()
    try:
        child.wait(DEADLINE)
    finally:
        if child.is_running():
            child.kill()


def test_what_is_computed_for_a_client_that_leaves_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """And the next answer has its place."""
    monkeypatch.setattr(capacity, "GRACE", 0.0)  # a fast machine would have the answer by then
    body = b'{"gamma": 2.0, "omega": 0.5, "xi": 0.26, "settle": 1000000, "model": {"kind": "soft"}}'
    request = (
        b"POST /v1/trajectories HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        b"Content-Length: %d\r\n\r\n%s" % (len(body), body)
    )
    settings = Settings(data=tmp_path, max_trajectories=1, trajectory_seconds=1e9)
    with closing(Processes(1)) as processes, closing(Inline()) as executor:
        app, others = create_app(settings, executor, processes), active_children()
        busy = psutil.Process(processes.run(os.getpid))
        idle = sum(busy.cpu_times()[:2])
        with listening(app, limited(DEADLINE, 9)) as address:
            leases = app.state.service.capacity
            with socket.create_connection(address, timeout=DEADLINE) as connection:
                connection.sendall(request)
                wait_for(lambda: sum(busy.cpu_times()[:2]) > idle + 0.1)
            wait_for(lambda: leases.used == 0 and not busy.is_running())
            wait_for(lambda: set(active_children()) - {*others})  # before another client asks
            assert processes.run(divmod, 17, 5) == (3, 2)


def test_a_worker_stops_what_it_computes_when_the_last_client_leaves(tmp_path: Path):
    """The curves take minutes."""
    curves = "/v1/curves?xi=0.01&omega_start=0.3&omega_stop=2&modes=1-6"
    with closing(Dask(workers=1)) as executor:
        app = create_app(Settings(data=tmp_path), executor, InThisProcess())
        with listening(app, limited(DEADLINE, 9)) as address:
            cache = app.state.service.on_demand

            def asked_last() -> float:
                results = list(cache._results.values())
                return max((asked for result in results for asked in result.askers.values()), default=0.0)

            with closing(HTTPConnection(*address)) as last:
                with closing(HTTPConnection(*address)) as first:
                    first.request("GET", curves)
                    last.request("GET", curves)
                for timeout in (0.1, DEADLINE):  # the client leaves before the last answer
                    with last.getresponse() as answer:
                        assert answer.status == 202
                        answer.read()
                    cache._timeout, before = timeout, time.monotonic()
                    last.request("GET", curves)
                    wait_for(lambda before=before: asked_last() > before)
                free = executor.call(divmod, 17, 5)
                with pytest.raises(TimeoutError):
                    free.result(0.5)
            assert free.result(ABANDONED_SECONDS / 2) == (3, 2)  # and not because nobody has asked lately


def test_a_client_behind_a_proxy_that_leaves_takes_nothing_from_others(tmp_path: Path):
    """A proxy forwards addresses without ports: those of two tabs, or of two users, are the same."""
    threshold = ("GET", "/v1/threshold?omega=0.6&xi=0.05&model=soft", None, {"X-Forwarded-For": "192.0.2.1"})
    app = create_app(Settings(data=tmp_path), Held(), InThisProcess())
    with listening(app, limited(DEADLINE, 9)) as address, closing(HTTPConnection(*address)) as staying:
        cache = app.state.service.on_demand
        cache._timeout = 0.0
        staying.request(*threshold)
        staying.getresponse().read()
        [result] = cache._results.values()
        asked, cache._timeout = max(result.askers.values()), 3.0
        with closing(HTTPConnection(*address)) as leaving:
            leaving.request(*threshold)
            wait_for(lambda: max(result.askers.values()) > asked)
            staying.request(*threshold)
        assert staying.getresponse().status == 202
