"""Content-addressed files `ab/cd/<sha256>`: written once, never changed.

A file appears under its name only when complete: temporary file, fsync, rename, fsync of the
folder. Several records travel in one file (`pack`), each found by offset.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import secrets
import shutil
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

from matiere.jobs.job import JsonDict

MAGIC = b"matiere-pack-1\n"
PIECE = 2**20  # bytes read at a time when a file is streamed


class DamagedFile(Exception):
    """A stored file does not hold the bytes its name promises."""

    def __init__(self, message: str, digest: str = "") -> None:
        """Name the file, where it is known."""
        super().__init__(message)
        self.digest = digest


class StorageFault(OSError):
    """A file could not be written: the disk is full, read-only or broken. Try again later."""


class Artifacts(Protocol):
    """Content-addressed files, wherever they lie: in a folder, or in an object store."""

    @property
    def location(self) -> str:
        """What `open_artifacts` opens them by, in a child too."""

    def path(self, digest: str) -> Path | None:
        """Return the local file, or None if there is none."""

    def write(self, pieces: Iterable[bytes]) -> tuple[str, int]:
        """Store bytes durably and return (digest, size). Raises StorageFault, leaving nothing."""

    def read(self, digest: str) -> bytes:
        """Return the bytes, checked. Raises DamagedFile if missing or changed."""

    def stream(self, digest: str) -> Iterator[bytes]:
        """Yield the bytes in pieces, unchecked. Raises DamagedFile if missing."""

    def has(self, digest: str, size: int) -> bool:
        """Tell whether a file of this name and size is there."""

    def remove(self, digest: str) -> None:
        """Delete a file, if it is there."""

    def remove_all(self, digests: Iterable[str]) -> None:
        """Delete files, where they are there."""

    def remove_temporary(self) -> int:
        """Delete what unfinished writes left behind; only while no child runs."""

    def written_before(self, moment: float) -> Iterator[str]:
        """Yield the digests of files last written before `moment` (Unix seconds)."""


def open_artifacts(location: str | Path) -> Artifacts:
    """Return the files at a folder or at a URL (`s3://bucket/prefix`)."""
    if "://" not in str(location):
        return ArtifactFolder(location)
    from matiere.jobs.object_store import ObjectStore

    return ObjectStore(str(location))


def local_file(artifacts: Artifacts, digest: str, scratch: str | Path) -> Path:
    """Return a local file that holds an artifact: its own, or a copy in the folder `scratch`."""
    if (path := artifacts.path(digest)) is not None:
        return path
    copy = Path(scratch) / digest
    if not copy.exists():
        copy.write_bytes(artifacts.read(digest))
    return copy


class ArtifactFolder:
    """A folder of content-addressed files."""

    def __init__(self, root: str | Path) -> None:
        """Use `root`, which exists or is made on the first write."""
        self.root = Path(root)
        self.location = str(root)
        self.temporary = self.root / "tmp"  # on the same disk, so that a rename moves nothing

    def path(self, digest: str) -> Path:
        """Return where the file with this SHA-256 lies."""
        return self.root / digest[:2] / digest[2:4] / digest

    def write(self, pieces: Iterable[bytes]) -> tuple[str, int]:
        """Store bytes durably and return (digest, size). Raises StorageFault, leaving nothing."""
        temporary = self.temporary / f"{os.getpid()}-{secrets.token_hex(8)}"
        try:
            return self._write(pieces, temporary)
        except OSError as error:
            raise StorageFault(error.errno, error.strerror, str(self.root)) from error
        finally:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)

    def _write(self, pieces: Iterable[bytes], temporary: Path) -> tuple[str, int]:
        hasher, size = hashlib.sha256(), 0
        self.temporary.mkdir(mode=0o700, parents=True, exist_ok=True)
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
        return hasher.hexdigest(), size

    def read(self, digest: str) -> bytes:
        """Return the bytes of a file, checked. Raises DamagedFile if missing or changed."""
        try:
            data = self.path(digest).read_bytes()
        except FileNotFoundError:
            raise DamagedFile(f"artifact {digest} is missing", digest) from None
        if hashlib.sha256(data).hexdigest() != digest:
            why = f"artifact {digest} does not hold the bytes it was stored with"
            raise DamagedFile(why, digest)
        return data

    def stream(self, digest: str) -> Iterator[bytes]:
        """Yield the bytes of a file in pieces, unchecked. Raises DamagedFile if missing."""
        try:
            with self.path(digest).open("rb") as file:
                while piece := file.read(PIECE):
                    yield piece
        except FileNotFoundError:
            raise DamagedFile(f"artifact {digest} is missing", digest) from None

    def has(self, digest: str, size: int) -> bool:
        """Tell whether a file of this name and size is there."""
        try:
            return self.path(digest).stat().st_size == size
        except OSError:
            return False

    def remove(self, digest: str) -> None:
        """Delete a file, if it is there."""
        self.path(digest).unlink(missing_ok=True)

    def remove_all(self, digests: Iterable[str]) -> None:
        """Delete files, where they are there."""
        for digest in digests:
            self.remove(digest)

    def remove_temporary(self) -> int:
        """Delete what unfinished writes left behind; only while no child runs."""
        left = list(self.temporary.glob("*")) if self.temporary.is_dir() else []
        for entry in left:
            if entry.is_dir():
                shutil.rmtree(entry, ignore_errors=True)
            else:
                entry.unlink(missing_ok=True)
        return len(left)

    def written_before(self, moment: float) -> Iterator[str]:
        """Yield the digests of files last written before `moment` (Unix seconds)."""
        for file in self.root.glob("??/??/*"):
            with contextlib.suppress(FileNotFoundError):
                if file.stat().st_mtime < moment:
                    yield file.name


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
