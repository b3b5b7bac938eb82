"""The ledger of a process that is killed."""

import subprocess
import sys
from pathlib import Path

import numpy as np
from ledgers import current
from paths import ROOT, SUPPORT

from service.ledger.ledger import Ledger


def test_what_a_transaction_returned_survives_a_kill(tmp_path: Path):
    """A process that marks chunks one by one and prints each is killed in the middle."""
    program = (
        "import sys; from pathlib import Path; sys.path[:0] = sys.argv[2:]\n"
        "from service.ledger.ledger import Ledger; from ledgers import accept, reports\n"
        "ledger = Ledger(Path(sys.argv[1])); job = accept(ledger, chunks=100000)\n"
        "for chunk in range(100000):\n"
        "    with ledger.writing() as writing: writing.mark_done(job, reports(chunk))\n"
        "    print(chunk, flush=True)\n"
    )
    path = tmp_path / "ledger.sqlite"
    command = [sys.executable, "-c", program, str(path), str(SUPPORT), str(ROOT)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        printed = [int(process.stdout.readline()) for _ in range(50)]
        process.kill()
    with Ledger(path) as ledger:
        mask = ledger.done_mask(current(ledger))
        assert mask[printed].all()
        assert np.count_nonzero(mask) == current(ledger).chunks_done
