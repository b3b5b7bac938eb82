"""The documents whose blocks take longest run, as the others do in tests/system."""

from pathlib import Path

import pytest
from documents import LONG, Session, run_in_order

from worker.kernel_cache import use_cache


@pytest.mark.parametrize("document", LONG)
def test_blocks_run_in_order(document: str, tmp_path: Path):
    use_cache()  # otherwise the time to compile counts as time to start the service
    with Session(tmp_path) as session:
        run_in_order(session, document)
