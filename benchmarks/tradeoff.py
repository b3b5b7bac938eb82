"""Cost and error of each contact model: `bounce tradeoff` without a service.

    python -m benchmarks.tradeoff [-o docs/tradeoff.png]

Runs the measurements of `worker.analysis.work_precision` one after another in this process, so that they do
not share the machine. The figure and numbers of docs/accuracy.md come from here.
"""

from pathlib import Path

from benchmarks.measuring import describe, options
from service.cli.tradeoff import report
from service.render import work_precision
from service.results.work_precision import table
from worker.analysis.work_precision import SETUPS, measure


def main() -> None:
    """Print the table, and write the figure to the file of option -o."""
    output = options(__doc__, output="").output
    print(describe(), end="\n\n")
    rows = [measure(setup) for setup in SETUPS]
    print(report(table(rows).model_dump()))
    if output:
        Path(output).write_bytes(work_precision.draw(rows, Path(output).suffix[1:]))


if __name__ == "__main__":
    main()
