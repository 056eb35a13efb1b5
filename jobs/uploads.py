"""Uploads of assets, whole or piece by piece: what came is kept until the rest comes.

    assets/.sha256/ab/<digest>     what was verified
    assets/.uploads/<digest>       the beginning of it, one writer at a time (flock)

An upload that was cut off can be continued from where it ended, for a day. The bytes are hashed
when they are complete: whatever was lost or mixed up on the way is noticed then.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import shutil
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

from uuid6 import uuid7

from matiere.jobs.artifacts import fsync_folder
from matiere.jobs.datadir import DataDir, is_digest
from matiere.jobs.errors import AssetMismatch, DiskFull, UploadBusy, WrongOffset

PART_DAYS_S = 86400.0
CHECK_BYTES = 2**26  # between looks at the free disk


class Uploads:
    """Takes assets into a data directory."""

    def __init__(self, data: DataDir, min_free_bytes: int) -> None:
        """Refuse what would leave less than `min_free_bytes` of the disk free."""
        self._data, self._min_free = data, min_free_bytes

    def held(self, digest: str) -> bool:
        """Tell whether the asset is there, whole."""
        return is_digest(digest) and self._data.asset_path(digest).exists()

    def offset(self, digest: str) -> int:
        """Return how many bytes of an unfinished upload are kept."""
        try:
            return self._part(digest).stat().st_size if is_digest(digest) else 0
        except OSError:
            return 0

    def whole(self, digest: str, stream: Iterable[bytes]) -> bool:
        """Store streamed bytes under their digest; false if they were there already.

        What came of a stream that breaks off is kept. Raises AssetMismatch (then nothing is kept)
        and DiskFull.
        """
        if not is_digest(digest):
            raise AssetMismatch(f"{digest!r} is not a SHA-256 in lower-case hex")
        if self.held(digest):
            for _ in stream:
                pass
            return False
        with self._writing(digest, alone=False) as (path, file):
            file.truncate(0)
            hasher = hashlib.sha256()
            for piece in stream:
                hasher.update(piece)
                file.write(piece)
                self._check_room(len(piece), file)
            self._finish(digest, path, file, hasher.hexdigest())
        return True

    def append(self, digest: str, stream: Iterable[bytes], first: int, total: int) -> int:
        """Continue an upload of `total` bytes at `first`; return how many are there now.

        When all are, the asset is. Raises WrongOffset unless just `first` bytes are kept,
        UploadBusy while another request writes, AssetMismatch and DiskFull.
        """
        if self.held(digest):
            for _ in stream:
                pass
            return total
        with self._writing(digest, alone=True) as (path, file):
            kept = file.seek(0, os.SEEK_END)
            if kept != first:
                raise WrongOffset(f"{kept} bytes are kept, so the next is byte {kept}", kept)
            self._check_room(0, file, total - first)
            for piece in stream:
                if kept + len(piece) > total:
                    file.truncate(first)
                    raise WrongOffset("more bytes came than were announced", first)
                kept += file.write(piece)
                self._check_room(len(piece), file)
            if kept == total:
                file.flush()
                with path.open("rb") as written:
                    found = hashlib.file_digest(written, "sha256").hexdigest()
                self._finish(digest, path, file, found)
            return kept

    def forget(self, digest: str) -> None:
        """Remove what came of an upload."""
        self._part(digest).unlink(missing_ok=True)

    def sweep(self, now: float | None = None) -> int:
        """Remove beginnings that nobody continued for a day; return how many."""
        count, before = 0, (time.time() if now is None else now) - PART_DAYS_S
        with contextlib.suppress(OSError):
            for path in list(self._folder.iterdir()):
                with contextlib.suppress(OSError):
                    if path.stat().st_mtime < before:
                        path.unlink()
                        count += 1
        return count

    # -- inside -------------------------------------------------------------------------------
    @property
    def _folder(self) -> Path:
        return self._data.assets / ".uploads"

    def _part(self, digest: str) -> Path:
        return self._folder / digest

    @contextlib.contextmanager
    def _writing(self, digest: str, alone: bool) -> Iterator[tuple[Path, BinaryIO]]:
        """Give the unfinished file, locked; or one of its own while another request has that."""
        try:
            self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            path = self._part(digest)
            file = path.open("ab+")
        except OSError as error:
            raise _full(error) from error
        with file:
            if _lock(file) and _is(path, file):
                yield from self._guarded(path, file)
                return
        if alone:
            raise UploadBusy("another request is uploading this asset")
        path = self._folder / f"{uuid7()}.tmp"
        try:
            file = path.open("xb+")
        except OSError as error:
            raise _full(error) from error
        with file:
            try:
                yield from self._guarded(path, file)
            finally:
                path.unlink(missing_ok=True)

    def _guarded(self, path: Path, file: BinaryIO) -> Iterator[tuple[Path, BinaryIO]]:
        try:
            yield path, file
        except OSError as error:
            path.unlink(missing_ok=True)  # its room is needed
            raise _full(error) from error
        except (AssetMismatch, DiskFull):
            path.unlink(missing_ok=True)
            raise

    def _finish(self, digest: str, path: Path, file: BinaryIO, found: str) -> None:
        if found != digest:
            raise AssetMismatch(f"the bytes have SHA-256 {found}, not {digest}; nothing was kept")
        file.flush()
        os.fsync(file.fileno())
        target = self._data.asset_path(digest)
        target.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        path.replace(target)
        fsync_folder(target.parent)

    def _check_room(self, more: int, file: BinaryIO, wanted: int = 0) -> None:
        """Raise DiskFull before the disk is: at the begin, and now and then."""
        at = file.tell()
        if wanted or at // CHECK_BYTES != (at - more) // CHECK_BYTES:
            free = shutil.disk_usage(self._data.assets).free
            if free - wanted < self._min_free:
                raise DiskFull("the asset would leave too little of the disk free")


def _lock(file: BinaryIO) -> bool:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _is(path: Path, file: BinaryIO) -> bool:
    """Tell whether a locked file is still the one of this name: it may have been completed."""
    try:
        return os.path.samestat(path.stat(), os.fstat(file.fileno()))
    except OSError:
        return False


def _full(error: OSError) -> DiskFull:
    return DiskFull(f"the asset cannot be stored: {error.strerror}")
