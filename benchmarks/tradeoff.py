"""Cost and error of each contact model: `bounce tradeoff` without a service.

    python -m benchmarks.tradeoff [-o docs/tradeoff.png]

Runs the measurements of `worker.analysis.work_precision` one after another in this process, so that they do
not share the machine. The figure and numbers of docs/accuracy.md come from here.
"""

import argparse
from pathlib import Path

from benchmarks.machine import describe
from service.cli.tradeoff import report
from service.render import work_precision
from service.results.work_precision import table
from worker.analysis.work_precision import SETUPS, measure


def main() -> None:
    """Print the table, and write the figure to the file of option -o."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    arguments = parser.parse_args()
    print(describe(), end="\n\n")
    rows = [measure(setup) for setup in SETUPS]
    print(report(table(rows).model_dump()))
    if arguments.output:
        arguments.output.write_bytes(work_precision.draw(rows, arguments.output.suffix[1:]))


if __name__ == "__main__":
    main()
