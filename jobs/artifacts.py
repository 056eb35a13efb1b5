"""Content-addressed files `ab/cd/<sha256>`: written once, never changed.

A file appears under its name only when complete: temporary file, fsync, rename, fsync of the
folder. Several records travel in one file (`pack`), each found by offset.
"""

from __future__ import annotations

import hashlib
import json
import os
import secrets
from collections.abc import Iterable, Sequence
from pathlib import Path

from matiere.jobs.job import JsonDict

MAGIC = b"matiere-pack-1\n"


class DamagedFile(Exception):
    """A stored file does not hold the bytes its name promises."""


class ArtifactFolder:
    """A folder of content-addressed files."""

    def __init__(self, root: str | Path) -> None:
        """Use `root`, which exists or is made on the first write."""
        self.root = Path(root)
        self._temporary = self.root / "tmp"

    def path(self, digest: str) -> Path:
        """Return where the file with this SHA-256 lies."""
        return self.root / digest[:2] / digest[2:4] / digest

    def write(self, pieces: Iterable[bytes]) -> tuple[str, int]:
        """Store bytes durably and return (digest, size). Raises OSError, leaving nothing."""
        hasher, size = hashlib.sha256(), 0
        self._temporary.mkdir(mode=0o700, parents=True, exist_ok=True)
        temporary = self._temporary / f"{os.getpid()}-{secrets.token_hex(8)}"
        try:
            with temporary.open("xb") as file:
                for piece in pieces:
                    hasher.update(piece)
                    size += len(piece)
                    file.write(piece)
                file.flush()
                os.fsync(file.fileno())
            target = self.path(hasher.hexdigest())
            _make_folders(target.parent, self.root)
            temporary.replace(target)
            fsync_folder(target.parent)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        return hasher.hexdigest(), size

    def read(self, digest: str) -> bytes:
        """Return the bytes of a file, checked. Raises DamagedFile if missing or changed."""
        try:
            data = self.path(digest).read_bytes()
        except FileNotFoundError:
            raise DamagedFile(f"artifact {digest} is missing") from None
        if hashlib.sha256(data).hexdigest() != digest:
            raise DamagedFile(f"artifact {digest} does not hold the bytes it was stored with")
        return data

    def has(self, digest: str, size: int) -> bool:
        """Tell whether a file of this name and size is there."""
        try:
            return self.path(digest).stat().st_size == size
        except OSError:
            return False

    def remove(self, digest: str) -> None:
        """Delete a file, if it is there."""
        self.path(digest).unlink(missing_ok=True)

    def remove_temporary(self) -> int:
        """Delete what unfinished writes left behind; only while no child runs."""
        left = list(self._temporary.glob("*")) if self._temporary.is_dir() else []
        for file in left:
            file.unlink(missing_ok=True)
        return len(left)


def _make_folders(folder: Path, root: Path) -> None:
    if folder.is_dir():
        return
    if folder != root:
        _make_folders(folder.parent, root)
    folder.mkdir(mode=0o700, exist_ok=True)
    fsync_folder(folder.parent)


def fsync_folder(folder: Path) -> None:
    """Make renames inside a folder durable."""
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def pack(header: JsonDict, records: Sequence[bytes]) -> Iterable[bytes]:
    """Yield the bytes of one file: a JSON header and records, whose sizes it lists."""
    full = header | {"sizes": [len(record) for record in records]}
    text = json.dumps(full, allow_nan=False, separators=(",", ":")).encode()
    yield MAGIC + len(text).to_bytes(8, "little") + text
    yield from records


def unpack(data: bytes) -> tuple[JsonDict, list[memoryview]]:
    """Return header and records of a packed file."""
    start = len(MAGIC) + 8
    if not data.startswith(MAGIC) or len(data) < start:
        raise DamagedFile("not a packed file")
    length = int.from_bytes(data[len(MAGIC) : start], "little")
    header: JsonDict = json.loads(data[start : start + length])
    view, at, records = memoryview(data), start + length, []
    for size in header["sizes"]:
        records.append(view[at : at + size])
        at += size
    if at != len(data):
        raise DamagedFile("a packed file has another length than its header says")
    return header, records
