"""dask-jobqueue on a real Slurm of this machine, over TLS, as in docs/deployment.md.

    apt-get install slurm-wlm munge && pip install dask-jobqueue
    pytest -n 0 tests/nightly/cluster/test_slurm.py

As root: a munged, a slurmctld and a slurmd of the test's own, with one node of several cores. All files are
in one folder, all ports are free ones of loopback; nothing of an installed Slurm is used but its programs.
What differing and failing nodes do is tested with workers of this machine (tests/system/worker).
"""

import gc
import math
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Self

import dask
import pytest
from blame import blamed, noting_errors
from extras import missing_programs
from paths import CACHE, ROOT
from scripted import free_port, wait_for
from served import Running, running

from worker.executors.clusters import SCHEDULER_SETTINGS, CreatedCluster
from worker.executors.dask import Dask
from worker.kernel_cache import use_cache

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "squeue", "scancel", "sinfo")
#: Where they are.
PATH = f"{os.environ['PATH']}:/usr/sbin"

CONFIGURATION = """
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={controller}
SlurmdPort={daemon}
SlurmUser=root
AuthType=auth/munge
AuthInfo=socket={folder}/munge.socket
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
SlurmdParameters=config_overrides
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
ReturnToService=2
KillWait=5
NodeName={host} NodeAddr=127.0.0.1 CPUs=8 RealMemory=16000 State=UNKNOWN
PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP
"""


def missing() -> str:
    """Why there can be no Slurm here; empty if there can."""
    return missing_programs(PROGRAMS, PATH, "slurm-wlm munge")


class Slurm:
    """A running Slurm; `variables` make its commands find it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.variables = {"SLURM_CONF": str(folder / "slurm.conf"), "PATH": PATH}
        self._processes: list[subprocess.Popen[bytes]] = []

    def start(self) -> None:
        for name in ("state", "spool"):
            (self.folder / name).mkdir(mode=0o755)
        key = self.folder / "munge.key"
        key.write_bytes(os.urandom(128))
        key.chmod(0o400)
        configuration = CONFIGURATION.format(
            folder=self.folder, host=socket.gethostname(), controller=free_port(), daemon=free_port()
        )
        (self.folder / "slurm.conf").write_text(configuration)
        own = (f"--{name}-file={self.folder / f'munge.{name}'}" for name in ("key", "pid", "log", "seed"))
        self._run("munged", "--foreground", "--force", f"--socket={self.folder / 'munge.socket'}", *own)
        wait_for((self.folder / "munge.socket").exists, self.log)
        self._run("slurmctld", "-D")
        self._run("slurmd", "-D")
        wait_for(lambda: "idle" in self.ask("sinfo", "--noheader", "--format=%T"), self.log, 60)

    def ask(self, *command: str) -> str:
        """The output of a command of Slurm."""
        environment = os.environ | self.variables
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=False).stdout

    def jobs(self) -> set[str]:
        """The jobs that run."""
        return set(self.ask("squeue", "--noheader", "--states=R", "--format=%A").split())

    def timed_out(self) -> set[str]:
        """The jobs of the last minutes that Slurm ended because their time was over."""
        return set(self.ask("squeue", "--noheader", "--states=TIMEOUT", "--format=%A").split())

    def log(self) -> str:
        """The ends of all logs."""
        return "\n".join(file.read_text()[-3000:] for file in sorted(self.folder.glob("*.log")))

    def end(self) -> None:
        """End the jobs, then all daemons."""
        self.ask("scancel", "--user=root", "--full", "--signal=KILL")
        self.ask("scancel", "--user=root")
        for process in reversed(self._processes):
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _run(self, program: str, *options: str) -> None:
        with (self.folder / f"{program}.out.log").open("wb") as log:
            command = [str(shutil.which(program, path=PATH)), *options]
            self._processes.append(
                subprocess.Popen(command, stdout=log, stderr=log, env=os.environ | self.variables)
            )


class Allocations:
    """The jobs that Slurm runs during the block, each cancelled `cancel_after` seconds after it was seen."""

    def __init__(self, slurm: Slurm, cancel_after: float = math.inf) -> None:
        self._slurm, self._cancel_after = slurm, cancel_after
        self._since: dict[str, float] = {}
        self.seen: set[str] = set()
        self.ended: set[str] = set()  # cancelled, or timed out
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._follow)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()

    def _follow(self) -> None:
        while not self._over.wait(1.0):
            jobs, now = self._slurm.jobs(), time.monotonic()
            for job in jobs - self.ended:
                if now - self._since.setdefault(job, now) > self._cancel_after:
                    self._slurm.ask("scancel", job)
                    self.ended.add(job)
            self.seen |= jobs
            self.ended |= self.seen & self._slurm.timed_out()


@contextmanager
def slurm_running(folder: Path) -> Iterator[Slurm]:
    """A Slurm in a new folder, ended with the block."""
    folder.mkdir()
    slurm = Slurm(folder)
    try:
        slurm.start()
        yield slurm
    finally:
        slurm.end()


jobqueue = pytest.importorskip("dask_jobqueue", reason="needs dask-jobqueue: pip install dask-jobqueue")
pytestmark = [
    pytest.mark.timeout(2400),
    pytest.mark.skipif(bool(missing()), reason=missing()),
    # Of dask-jobqueue, which waits for no answer of scancel.
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]

PATIENCE = 1500.0


@pytest.fixture(scope="module")
def slurm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Slurm]:
    use_cache()
    with (
        slurm_running(tmp_path_factory.mktemp("slurm") / "files") as queue,
        pytest.MonkeyPatch.context() as patch,
        dask.config.set(SCHEDULER_SETTINGS),
    ):
        for name, value in queue.variables.items():
            patch.setenv(name, value)
        yield queue


@pytest.fixture(autouse=True)
def collected() -> Iterator[None]:
    """A test's cluster goes with the test: it leaves files open, whose warnings are ignored."""
    yield
    gc.collect()


@contextmanager
def computing(folder: Path, walltime: str) -> Iterator[Running]:
    """A service on two jobs of a cluster that speaks TLS, with dask-jobqueue's certificates."""
    cluster = folder / "cluster"
    cluster.mkdir()

    def make() -> Any:
        made = jobqueue.SLURMCluster(
            queue="all",
            cores=1,
            processes=1,
            memory="2GB",
            walltime=walltime,
            python=sys.executable,
            security=True,
            shared_temp_directory=str(cluster),
            local_directory=str(cluster),
            log_directory=str(cluster),
            scheduler_options={"host": "127.0.0.1", "dashboard_address": "127.0.0.1:0"},
            worker_extra_args=["--host", "127.0.0.1", "--no-dashboard", "--dashboard-address", "127.0.0.1:0"],
            job_script_prologue=[f"export PYTHONPATH={ROOT}", f"export NUMBA_CACHE_DIR={CACHE}"],
        )
        made.scale(jobs=2)
        return made

    with (
        closing(Dask(CreatedCluster(make, "slurm:cluster"), timeout=60)) as executor,
        running(folder / "data", executor, chunk_tries=1) as service,
    ):
        yield service


@pytest.mark.parametrize(
    ("walltime", "cancel_after"),
    [("00:10:00", 25.0), ("00:01:00", math.inf)],
    ids=["scancel", "walltime"],  # Slurm looks at time limits twice a minute
)
def test_allocations_that_end_are_replaced_and_no_chunk_is_blamed(
    slurm: Slurm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, walltime: str, cancel_after: float
):
    errors = noting_errors(monkeypatch)
    with (
        computing(tmp_path, walltime) as service,
        Allocations(slurm, cancel_after) as allocations,
    ):
        service.jobs_until(
            lambda: len(allocations.ended) >= 2 and allocations.seen > allocations.ended,
            chunks=40,
            seconds=0.5,
            patience=PATIENCE,
        )
    assert blamed(errors) == []
