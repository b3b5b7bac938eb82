"""Paths beside a ledger, and the file system that it is on."""

from datetime import datetime
from pathlib import Path
from typing import Final

#: File systems shared between machines. SQLite's WAL mode needs memory that all users of the file share.
NETWORK: Final = frozenset(
    (
        "9p", "afs", "beegfs", "ceph", "cifs", "fuse.glusterfs", "fuse.s3fs", "fuse.sshfs", "glusterfs",
        "gpfs", "lustre", "ncpfs", "nfs", "nfs4", "smb3", "smbfs",
    )
)  # fmt: skip


def wal_of(path: Path) -> Path:
    """The write-ahead log of a ledger."""
    return path.with_name(f"{path.name}-wal")


def shm_of(path: Path) -> Path:
    """The index of the write-ahead log."""
    return path.with_name(f"{path.name}-shm")


def lock_of(path: Path) -> Path:
    """The file that the process using a ledger locks."""
    return path.with_suffix(".lock")


def replaced_path(path: Path) -> Path:
    """A path with the time in its name, in microseconds, for a ledger that a restore replaces."""
    return path.with_name(f"{path.stem}-replaced-{datetime.now():%Y%m%dT%H%M%S-%f}{path.suffix}")


def replaced_copies(path: Path) -> list[Path]:
    """The ledgers that restores have replaced, the newest last."""
    copies = path.parent.glob(f"{path.stem}-replaced-*{path.suffix}")
    return sorted(copies, key=lambda copy: copy.stat().st_mtime)


def size_of(path: Path) -> int:
    """Bytes of a file; 0 if it is missing."""
    return path.stat().st_size if path.exists() else 0


def network_file_system(path: Path) -> str | None:
    """The type of `path`'s file system if other machines share it; None if not, or unknown."""
    kind = file_system(path)
    return kind if kind in NETWORK else None


def file_system(path: Path) -> str | None:
    """The type of `path`'s file system, from the system's table of mounts; None if unknown."""
    try:
        mounts = [line.split() for line in Path("/proc/self/mounts").read_text().splitlines()]
    except OSError:
        return None
    kinds = {Path(point.replace("\\040", " ")): kind for _, point, kind, *_ in mounts}
    return next(
        (kinds[folder] for folder in (path.resolve(), *path.resolve().parents) if folder in kinds), None
    )
