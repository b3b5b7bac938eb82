"""Slurm on this machine alone: its own munged, slurmctld and slurmd, with one node of several cores.

Needs root and Debian's packages: `apt-get install slurm-wlm munge`. All files are in one folder, all ports
are free ones of loopback, and nothing of an installed Slurm is used but its programs.
"""

import math
import os
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Self

from extras import missing_programs
from scripted import free_port, wait_for

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
        self.most = 0  # at a time
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
            self.most = max(self.most, len(jobs))


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
