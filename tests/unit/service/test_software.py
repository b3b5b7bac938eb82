"""What computed a job: the versions and the processor of each run."""

import json

from service import software


def test_a_run_on_the_same_software_is_not_told_again():
    once = software.with_this_run("[]", 5.0)
    assert software.with_this_run(once, 6.0) == once
    (run,) = json.loads(once)
    earlier = json.dumps([run, run | {"release": "0.0.1"}])
    assert [each["began"] for each in json.loads(software.with_this_run(earlier, 7.0))] == [5.0, 5.0, 7.0]
