"""Codecs, compression levels and shards of a store, compared on chunks of the atlas.

    python -m benchmarks.storage [--chunks 8] [--repeat 3]

The chunks are those of the plan, spread over the atlas of a million cells. First table: processor time of
writing and reading all their arrays in memory with each codec. Second table: the same chunks as files, as
now and with one shard of smaller inner chunks per task, written and then read along Gamma.
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
    """Records of `count` chunks spread over the plan, and the mean kernel time per chunk, s."""
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


def written(target: Any, record: Record, codec: Any, lines: int | None = None) -> zarr.Group:
    """Write a record, each array as one chunk, or as one shard of chunks of `lines` lines along Gamma."""
    group = zarr.open_group(target, mode="w", zarr_format=3)
    for name, values in record.items():
        whole = values.shape
        size = next(n for n in range(min(lines or 1, whole[1]), 0, -1) if whole[1] % n == 0)
        inner, shards = ((1, size, *whole[2:]), whole) if lines else (whole, None)
        group.create_array(name, data=values, chunks=inner, shards=shards, compressors=codec)
    return group


def timed(run: Callable[[], Any], repeat: int, clock: Callable[[], float] = time.process_time) -> float:
    """Median time of a run by `clock`, s; processor time by default."""
    times = []
    for _ in range(repeat):
        start = clock()
        run()
        times.append(clock() - start)
    return statistics.median(times)


def codec_row(name: str, records: list[Record], kernel: float, repeat: int) -> tuple[str, ...]:
    """Row of the table: compression ratio and speeds of one codec."""
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
    """Row of the table: files and times of one layout on disk."""
    codec = ZstdCodec(level=3, checksum=True)
    with tempfile.TemporaryDirectory() as folder:
        targets = [Path(folder) / str(number) for number in range(len(records))]

        def write() -> None:
            for target, record in zip(targets, records, strict=True):
                written(LocalStore(target), record, codec, lines)

        def read() -> None:
            for target in targets:
                group = zarr.open_group(LocalStore(target, read_only=True), mode="r")
                for key in ("flight_time", "outcome"):
                    group[key][0, 0]

        took, line = timed(write, repeat, time.perf_counter), timed(read, 3 * repeat, time.perf_counter)
        files = [
            file for target in targets for file in target.rglob("*") if file.is_file() and "c" in file.parts
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
    arguments = parser.parse_args()
    print(describe("zarr", "numcodecs"), flush=True)
    spec = SweepSpec.model_validate(atlas(1000, 100, 10))
    plan = make_plan(spec)
    records, kernel = computed(spec, plan, arguments.chunks)
    shape = "x".join(map(str, plan.chunk_shape))
    print(f"{len(plan)} chunks of {shape} cells (xi, omega, gamma), {kernel:.2f} s of kernel each")
    head = [
        "codec",
        "ratio",
        "kB per chunk",
        "write, MB/s",
        "read, MB/s",
        "write, ms per chunk",
        "share of the kernel's time",
    ]
    print("\n" + table(head, [codec_row(name, records, kernel, arguments.repeat) for name in CODECS]))
    layouts = {
        "now: a task writes one chunk of each array": None,
        "a task writes a shard, inner chunks of one line along Gamma": 1,
        "a task writes a shard, inner chunks of ten lines": 10,
    }
    rows = [shard_row(name, records, lines, arguments.repeat) for name, lines in layouts.items()]
    head = ["layout", "files per task", "kB per task", "write, ms per task", "read a line, ms per task"]
    print("\n" + table(head, rows))


if __name__ == "__main__":
    main()
