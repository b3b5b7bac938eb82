"""Client and commands on the data folder of an earlier kernel."""

from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from earlier_kernel import IDS, earlier_folder
from scripted import Scripted
from served import service_at

from kernel.params import KERNEL_VERSION
from service.cli.main import main
from service.client import Client, Conflict

NOTICE = f"computed by kernel version 1; this release computes version {KERNEL_VERSION}"


def test_client_and_commands_follow_to_the_new_job(tmp_path: Path):
    folder = earlier_folder(tmp_path)
    with closing(Scripted()) as executor, service_at(folder, executor) as url, Client(url) as client:

        def bounce(*words: str) -> Any:
            return CliRunner().invoke(main, words, env={"BOUNCE_URL": url})

        old_id = IDS["interrupted"]
        old = client.job(old_id)
        assert f"notice    {old.notice}" in bounce("status", old_id).stdout
        waited = client.job(old_id).wait(progress=False)
        assert (waited.id, waited.state) == (old.replaced_by, "done")
        assert f"job {old_id} was replaced by job {waited.id}" in bounce("wait", old_id).stderr
        resumed = bounce("resume", old_id)
        assert resumed.exit_code == 0, resumed.stderr
        assert resumed.stdout == f"{waited.id}\n"
        assert NOTICE in resumed.stderr
        assert old.resume().id == waited.id
        done = IDS["done"]
        assert client.job(done).wait(progress=False).id == done
        with pytest.raises(Conflict, match="submit the sweep again"):
            client.job(done).resume()
        assert f"the job is {NOTICE}" in bounce("threshold", done).stderr
