"""What computed a job: the versions and the processor of each run."""

import json
from typing import Any

from service import software


def runs(text: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(text)
    return found


def test_the_first_run_of_a_job_names_its_software():
    (run,) = runs(software.with_this_run("[]", 5.0))
    here = software.software()
    assert run == {
        "release": here.release, "python": here.python, "libraries": here.libraries,
        "processor": software.processor(), "began": 5.0,
    }  # fmt: skip


def test_a_run_on_the_same_software_is_not_told_again():
    once = software.with_this_run("[]", 5.0)
    assert software.with_this_run(once, 6.0) == once
    (run,) = runs(once)
    earlier = json.dumps([run, {**run, "release": "0.0.1"}])
    assert [r["began"] for r in runs(software.with_this_run(earlier, 7.0))] == [5.0, 5.0, 7.0]
