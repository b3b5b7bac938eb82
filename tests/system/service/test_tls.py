"""Scheduler and workers that speak TLS, started by the commands of docs/deployment.md, and who is refused.

pytest -n 0 tests/system/service/test_tls.py
"""

import json
from contextlib import closing
from pathlib import Path

import pytest
from dask_processes import LOOPBACK, dask_processes
from distributed import Security
from scripted import costing, wait_for
from served import running
from stores import marked

from service.ledger.model import JobState
from service.server.embedded import connected_cluster
from service.settings import Settings
from worker.executors.base import ClusterLost
from worker.executors.dask import Dask
from worker.kernel_cache import use_cache

PATIENCE = 180.0


def certificates(folder: Path) -> dict[str, Path]:
    """A CA, a certificate and a key in files."""
    folder.mkdir(exist_ok=True)
    made = Security.temporary()
    contents = {"ca": made.tls_ca_file, "cert": made.tls_scheduler_cert, "key": made.tls_scheduler_key}
    files = {name: folder / f"{name}.pem" for name in contents}
    for name, content in contents.items():
        files[name].write_text(content)
    return files


def options(files: dict[str, Path]) -> list[str]:
    names = {"--tls-ca-file": "ca", "--tls-cert": "cert", "--tls-key": "key"}
    return [word for option, name in names.items() for word in (option, str(files[name]))]


@pytest.mark.timeout(600)
def test_a_scheduler_of_tls_takes_those_with_certificates_alone(tmp_path: Path):
    use_cache()
    files = certificates(tmp_path)
    written = tmp_path / "scheduler.json"
    with dask_processes(tmp_path / "dask") as processes:
        tls = ["--protocol", "tls", "--scheduler-file", str(written), *LOOPBACK, *options(files)]
        processes.start(["dask", "scheduler", *tls, "--port", "0"])
        wait_for(lambda: written.read_text().endswith("}"), processes.log, PATIENCE)
        address = json.loads(written.read_text())["address"]
        assert address.startswith("tls://127.0.0.1:")
        processes.start(
            ["dask", "worker", *tls, "--nthreads", "1", "--local-directory", str(tmp_path / "scratch")]
        )
        with pytest.raises(ClusterLost):
            Dask(address.replace("tls://", "tcp://"), timeout=3)
        stranger = options(certificates(tmp_path / "stranger"))
        limited = ["--nthreads", "1", "--death-timeout", "10"]
        worker = processes.start(["dask", "worker", address, *LOOPBACK, *stranger, *limited])
        settings = Settings(
            data=tmp_path / "data", scheduler_file=written,
            scheduler_ca=files["ca"], scheduler_cert=files["cert"], scheduler_key=files["key"],
        )  # fmt: skip
        with (
            closing(connected_cluster(settings, marked(settings.data)[1])) as executor,
            running(tmp_path / "data", executor) as service,
        ):
            job = service.submit(costing(chunks=8, seconds=0.1))
            ended = service.until(job, JobState.DONE, seconds=PATIENCE)
            assert ended.chunks_done == ended.chunks_total
            worker.wait(PATIENCE)  # it was never let in
            wait_for(lambda: executor.state().workers == 1)
