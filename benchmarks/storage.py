"""How the store's bytes should be kept: codecs, their levels, and shards, on real chunks of the atlas.

    python -m benchmarks.storage [--chunks 8] [--repeat 3]

Chunks are those the plan makes, spread over the million-cell atlas, computed by the kernel. First table:
every array of them through zarr with each codec, in memory, processor time. Second: the same chunks as files,
as they are now and as one shard per task of smaller inner chunks, written and then read along Gamma.
"""

import argparse
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.codecs import BloscCodec, ZstdCodec
from zarr.storage import LocalStore, MemoryStore

from benchmarks.atlas import atlas
from benchmarks.machine import describe
from benchmarks.tables import short, table
from worker import schema, store
from worker.plan import Plan, make_plan
from worker.schema import layout
from worker.spec import SweepSpec
from worker.tasks import run_chunk

Record = dict[str, NDArray[Any]]

CODECS: dict[str, Any] = {
    "none": None,
    **{f"zstd {level}": ZstdCodec(level=level, checksum=True) for level in (0, 1, 3, 5, 9)},
    "blosc lz4, shuffle": BloscCodec(cname="lz4", clevel=5, shuffle="shuffle"),
    "blosc zstd 1, shuffle": BloscCodec(cname="zstd", clevel=1, shuffle="shuffle"),
    "blosc zstd 3, shuffle": BloscCodec(cname="zstd", clevel=3, shuffle="shuffle"),
    "blosc zstd 3, bitshuffle": BloscCodec(cname="zstd", clevel=3, shuffle="bitshuffle"),
}


def computed(spec: SweepSpec, plan: Plan, count: int) -> tuple[list[Record], float]:
    """So many chunks spread over the plan, as arrays; and how long one took to compute, s."""
    names = [array.name for array in schema.arrays(spec)]
    records, kernel = [], []
    with tempfile.TemporaryDirectory() as folder:
        url = f"{folder}/atlas.zarr"
        store.create(url, layout(spec, plan.chunk_shape))
        run_chunk(spec, plan[0], url)  # compiles
        for index in np.linspace(0, len(plan) - 1, count).astype(int):
            chunk = plan[int(index)]
            kernel.append(run_chunk(spec, chunk, url).kernel_seconds)
            records.append(store.read_chunk(url, chunk, names))
    return records, statistics.mean(kernel)


def written(place: Any, record: Record, codec: Any, lines: int | None = None) -> zarr.Group:
    """One chunk's arrays, each one chunk, or one shard of chunks of so many lines along Gamma."""
    group = zarr.open_group(place, mode="w", zarr_format=3)
    for name, values in record.items():
        whole = values.shape
        size = next(n for n in range(min(lines or 1, whole[1]), 0, -1) if whole[1] % n == 0)
        inner, shards = ((1, size, *whole[2:]), whole) if lines else (whole, None)
        group.create_array(name, data=values, chunks=inner, shards=shards, compressors=codec)
    return group


def timed(run: Callable[[], Any], repeat: int, clock: Callable[[], float] = time.process_time) -> float:
    """Median seconds, of the processor unless another clock is given."""
    times = []
    for _ in range(repeat):
        start = clock()
        run()
        times.append(clock() - start)
    return statistics.median(times)


def codec_row(name: str, records: list[Record], kernel: float, repeat: int) -> tuple[str, ...]:
    """Ratio and speeds of one codec."""
    raw = sum(values.nbytes for record in records for values in record.values())
    kept = 0
    write, read = [], []
    for record in records:
        content: dict[str, Any] = {}
        write.append(timed(lambda r=record, c=content: written(MemoryStore(c), r, CODECS[name]), repeat))
        group = zarr.open_group(MemoryStore(content), mode="r")
        read.append(timed(lambda g=group, r=record: [g[key][...] for key in r], repeat))
        kept += sum(len(buffer) for key, buffer in content.items() if "/c/" in key or key.endswith("/c"))
    each = statistics.mean(write)
    return (
        name, short(raw / kept), short(kept / len(records) / 1e3), short(raw / 1e6 / sum(write)),
        short(raw / 1e6 / sum(read)), short(each * 1e3), f"{each / kernel:.1%}",
    )  # fmt: skip


def shard_row(name: str, records: list[Record], lines: int | None, repeat: int) -> tuple[str, ...]:
    """Files and times of one way to lay chunks out on the disk."""
    codec = ZstdCodec(level=3, checksum=True)
    with tempfile.TemporaryDirectory() as folder:
        places = [Path(folder) / str(number) for number in range(len(records))]

        def write() -> None:
            for place, record in zip(places, records, strict=True):
                written(LocalStore(place), record, codec, lines)

        def read() -> None:
            for place in places:
                group = zarr.open_group(LocalStore(place, read_only=True), mode="r")
                for key in ("flight_time", "outcome"):
                    group[key][0, 0]

        took, line = timed(write, repeat, time.perf_counter), timed(read, 3 * repeat, time.perf_counter)
        files = [
            file for place in places for file in place.rglob("*") if file.is_file() and "c" in file.parts
        ]
        size = sum(file.stat().st_size for file in files)
    count = len(records)
    return (
        name, short(len(files) / count), short(size / count / 1e3), short(took / count * 1e3),
        short(line / count * 1e3),
    )  # fmt: skip


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--chunks", type=int, default=8)
    parser.add_argument("--repeat", type=int, default=3)
    given = parser.parse_args()
    print(describe("zarr", "numcodecs"), flush=True)
    spec = SweepSpec.model_validate(atlas(1000, 100, 10))
    plan = make_plan(spec)
    records, kernel = computed(spec, plan, given.chunks)
    shape = "x".join(map(str, plan.chunk_shape))
    print(f"{len(plan)} chunks of {shape} cells (xi, omega, gamma), {kernel:.2f} s of kernel each")
    head = [
        "codec",
        "ratio",
        "kB a chunk",
        "write, MB/s",
        "read, MB/s",
        "write, ms a chunk",
        "of the kernel's time",
    ]
    print("\n" + table(head, [codec_row(name, records, kernel, given.repeat) for name in CODECS]))
    layouts = {
        "now: a task writes one chunk of each array": None,
        "a task writes a shard, inner chunks of one line along Gamma": 1,
        "a task writes a shard, inner chunks of ten lines": 10,
    }
    rows = [shard_row(name, records, lines, given.repeat) for name, lines in layouts.items()]
    head = ["layout", "files a task", "kB a task", "write, ms a task", "read a line, ms a task"]
    print("\n" + table(head, rows))


if __name__ == "__main__":
    main()
