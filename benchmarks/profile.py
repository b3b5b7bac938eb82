"""Profile of the atlas: sampled stacks of both workers and of the service.

    python -m benchmarks.profile [--omega 50] [--rate 100] [-o docs/atlas-profile.svg]

1000 x --omega x 10 cells of `rigid`, 300 plate periods, over HTTP on the embedded cluster, as in
benchmarks.atlas. py-spy (extra `bench`) samples the processes from outside. Compiled kernels appear as the
Python function that calls them; waiting threads are left out. Writes a flame graph and prints the share of
each purpose of the code.
"""

import argparse
import html
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path

import psutil

from benchmarks.atlas import atlas, warm
from benchmarks.machine import describe
from benchmarks.tables import table
from service.client import Client
from service.server import embedded
from worker.executors.dask import Dask

Stack = tuple[str, ...]

#: The project's packages, at which the paths of frames are cut.
PACKAGES = ("kernel", "worker", "service")

#: Purposes of the code by text of a stack's frames; the first match in this order counts.
PURPOSES = (
    ("kernel: the compiled physics", ("run_line (kernel",)),
    (
        "store: compressing and writing chunks",
        ("write_chunk (worker", "fsync_files (worker", "checksum (worker"),
    ),
    ("store: zarr's threads", ("(zarr/",)),
    ("task: everything else around the kernel", ("run_chunk (worker", "run_watched (worker")),
    ("ledger and supervisor", ("(service/jobs/",)),
    ("HTTP", ("(uvicorn/", "(service/", "(starlette/")),
    ("Dask: scheduler, workers, client", ("(distributed/", "(tornado/", "(dask/")),
)
#: Innermost functions of waiting threads.
WAITS = ("EpollSelector.select ", "Condition.wait ", "Popen.poll ", "_worker ")
ROW, WIDTH = 17, 1200
LEAST = 0.002


def sampled(pids: Iterable[int], seconds: float, rate: int, folder: Path) -> list[subprocess.Popen[bytes]]:
    """Start sampling processes; folded stacks are written to folder/PID.txt."""
    spy = Path(sys.executable).with_name("py-spy")
    return [
        subprocess.Popen([
            spy, "record", "--pid", str(pid), "--format", "raw", "--rate", str(rate), "--nonblocking",
            "--duration", str(int(seconds)), "--output", folder / f"{pid}.txt",
        ], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for pid in pids
    ]  # fmt: skip


def stacks(file: Path, root: str) -> Counter[Stack]:
    """Folded stacks of a file below the frame `root`; without line numbers, paths from the package on."""
    samples: Counter[Stack] = Counter()
    for line in file.read_text().splitlines():
        frames, _, count = line.rpartition(" ")
        stack = (root, *(_named(frame) for frame in frames.split(";")))
        if not stack[-1].startswith(WAITS):
            samples[stack] += int(count)
    return samples


def _named(frame: str) -> str:
    """`function (package/file.py)` of `function (some/long/path/package/file.py:12)`."""
    name, _, location = frame.rpartition(" (")
    path = location.rstrip(")").rpartition(":")[0] or location.rstrip(")")
    parts = path.split("/")
    starts = [i for i, part in enumerate(parts[:-1]) if part in PACKAGES]
    starts += [i + 1 for i, part in enumerate(parts) if part == "site-packages"]
    return f"{name} ({'/'.join(parts[starts[-1] if starts else -2 :])})"


def purpose(stack: Stack) -> str:
    """The purpose of a sample."""
    for name, signs in PURPOSES:
        if any(sign in frame for frame in stack for sign in signs):
            return name
    return "Python and the rest"


def flame(samples: Counter[Stack], title: str) -> str:
    """A flame graph as SVG: one bar per frame, as wide as its share; the functions it calls are above it."""
    total = sum(samples.values())
    bars: list[tuple[int, float, float, str]] = []  # level, left, share, frame

    def lay(level: int, left: float, below: list[tuple[Stack, int]]) -> None:
        groups: dict[str, list[tuple[Stack, int]]] = {}
        for stack, count in sorted(below):
            if len(stack) > level:
                groups.setdefault(stack[level], []).append((stack, count))
        for frame, group in groups.items():
            share = sum(count for _, count in group) / total
            if share >= LEAST:
                bars.append((level, left, share, frame))
                lay(level + 1, left, group)
            left += share

    lay(0, 0.0, list(samples.items()))
    top = max(level for level, *_ in bars)
    height = (top + 1) * ROW + 34
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" font-family="monospace">'
    text = f'<rect width="100%" height="100%" fill="#fff"/><text x="8" y="16" font-size="13">{title}</text>'
    drawn = [_bar(frame, left * WIDTH, (top - level) * ROW + 28, share) for level, left, share, frame in bars]
    return "\n".join([head, text, *drawn, "</svg>\n"])


def _bar(frame: str, left: float, top: float, share: float) -> str:
    name, width = html.escape(frame), share * WIDTH
    colour = next(
        (c for sign, c in (("kernel", "#e4632d"), ("worker/", "#e9a13b"), ("zarr", "#5fa8a0"),
                           ("distributed", "#7f9ec7"), ("service", "#b58bc0")) if sign in frame), "#cfcabd",
    )  # fmt: skip
    label = html.escape(frame[: int(width / 6.2)]) if width > 25 else ""
    box = f'x="{left:.1f}" y="{top}" width="{max(width - 0.5, 0.3):.1f}" height="{ROW - 1}"'
    words = f'<text x="{left + 3:.1f}" y="{top + 12}" font-size="10">{label}</text>' if label else ""
    return f'<g><title>{name}: {share:.1%}</title><rect {box} fill="{colour}"/>{words}</g>'


def main() -> None:
    """Run the atlas, sample, draw and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--omega", type=int, default=50)
    parser.add_argument("--rate", type=int, default=100, help="samples per second of each process")
    parser.add_argument("-o", "--output", default="docs/atlas-profile.svg")
    arguments = parser.parse_args()
    print(describe("dask", "zarr", "py-spy"), flush=True)
    samples: Counter[Stack] = Counter()
    with tempfile.TemporaryDirectory() as folder, closing(Dask(workers=2)) as executor:
        workers = [
            p.pid for p in psutil.Process().children(recursive=True) if "spawn_main" in " ".join(p.cmdline())
        ]
        names = dict.fromkeys(workers, "worker") | {psutil.Process().pid: "service"}
        settings = embedded.settings(data=Path(folder) / "data", host="127.0.0.1", port=0)
        with embedded.running(settings, executor) as url, Client(url) as client:
            warm(client)
            spies = sampled(names, 600, arguments.rate, Path(folder))
            client.submit(atlas(1000, arguments.omega, 10)).wait(progress=False)
            for spy in spies:
                spy.send_signal(2)  # SIGINT: it writes its samples
                spy.wait(60)
        for pid, name in names.items():
            samples += stacks(Path(folder) / f"{pid}.txt", name)
    total, by_purpose = sum(samples.values()), Counter[str]()
    for stack, count in samples.items():
        by_purpose[purpose(stack)] += count
    title = (
        f"{1000 * arguments.omega * 10:,} cells of the atlas, both workers and the service, {total:,} samples"
    )
    Path(arguments.output).write_text(flame(samples, title))
    head = ["purpose", "share of all processes' busy time"]
    print("\n" + table(head, [(name, f"{count / total:.1%}") for name, count in by_purpose.most_common()]))
    print(f"\n{arguments.output}")


if __name__ == "__main__":
    main()
