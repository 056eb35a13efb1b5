"""Find a scene's files under the asset root, never outside it, and read them exactly once.

A name is a relative path. It is refused when it is absolute, a URL, climbs with `..`, or when a
link on the way leads out of the root. What is decoded is what was hashed: a file is read into
memory or compared before and after, so the digest in the film key is that of the pixels rendered.
"""

from __future__ import annotations

import hashlib
import os
import re
import stat
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from io import BufferedReader
from pathlib import Path

from matiere.errors import AssetChanged, Fault, SceneValidationError

MAX_ASSET_BYTES = 4 * 2**30
MAX_HASHED = 1000  # files whose digests a process keeps
RESTED_NS = 2 * 10**9
_URL = re.compile(r"^[A-Za-z][A-Za-z0-9+.-]+:")


@dataclass(frozen=True, slots=True)
class _Seen:
    """A file at one moment: which one it is, and when it was last written."""

    device: int
    inode: int
    size: int
    modified_ns: int
    changed_ns: int

    @staticmethod
    def of(status: os.stat_result) -> _Seen:
        return _Seen(
            status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns
        )


_HASHED: dict[Path, tuple[_Seen, str]] = {}


@dataclass(slots=True)
class AssetRoot:
    """A folder that holds a scene's files, and what is known of them."""

    root: Path
    pins: Mapping[str, str] = field(default_factory=dict)
    _digests: dict[str, tuple[_Seen, str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.root = Path(os.path.realpath(self.root))

    def locate(self, name: str) -> Path:
        """Return the real path of the file `name`; raise SceneValidationError without pointer."""
        if why := unsafe(name):
            raise SceneValidationError([Fault("", "asset_outside_root", f"{name!r} {why}")])
        try:
            real = Path(os.path.realpath(self.root / name, strict=True))
        except (FileNotFoundError, NotADirectoryError):
            why = f"the file {name!r} does not exist in the asset root (usually the scene's folder)"
            raise SceneValidationError([Fault("", "asset_missing", why)]) from None
        except OSError as error:
            why = f"the file {name!r} cannot be opened: {error.strerror}"
            raise SceneValidationError([Fault("", "asset_unreadable", why)]) from None
        if not real.is_relative_to(self.root):
            why = f"{name!r} is a link that leads out of the asset root; put a copy there instead"
            raise SceneValidationError([Fault("", "asset_outside_root", why)])
        return real

    def check(self, name: str) -> Path:
        """Return the real path of a readable regular file, or raise SceneValidationError."""
        real = self.locate(name)
        status = real.stat()
        if not stat.S_ISREG(status.st_mode):
            why = f"{name!r} is not a regular file"
            raise SceneValidationError([Fault("", "asset_unreadable", why)])
        if not os.access(real, os.R_OK):
            why = f"the file {name!r} may not be read (permissions)"
            raise SceneValidationError([Fault("", "asset_unreadable", why)])
        if status.st_size > MAX_ASSET_BYTES:
            why = f"the file {name!r} is larger than {MAX_ASSET_BYTES >> 30} GiB"
            raise SceneValidationError([Fault("", "limit_exceeded", why)])
        return real

    def digest(self, name: str) -> str:
        """Return the SHA-256 of a file in hex, reading it only when it changed since last time."""
        real = self.check(name)
        known = self._digests.get(name)
        if known is None or known[0] != _Seen.of(real.stat()):
            known = self._hash(name, real)
        return known[1]

    def known(self, name: str) -> str | None:
        """Return the digest that a file had when it was last looked at; None if it never was."""
        found = self._digests.get(name)
        return found[1] if found else None

    def read(self, name: str) -> bytes:
        """Return the bytes of a file that has the pinned (or the first seen) digest."""
        real = self.check(name)
        with _open(real) as file:
            data = file.read()
            seen = _Seen.of(os.fstat(file.fileno()))
        self._settle(name, seen, hashlib.sha256(data).hexdigest())
        return data

    def unchanged(self, name: str) -> Path:
        """Return the path of a file that has the pinned (or the first seen) digest.

        For decoders that want a path: call it before and after decoding.
        """
        real = self.check(name)
        known = self._digests.get(name)
        if known is None or known[0] != _Seen.of(real.stat()):
            self._hash(name, real)
        return real

    def _hash(self, name: str, real: Path) -> tuple[_Seen, str]:
        with _open(real) as file:
            seen = _Seen.of(os.fstat(file.fileno()))
            known = _HASHED.get(real)
            if known is None or known[0] != seen:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
                seen = _Seen.of(os.fstat(file.fileno()))
                _remember(real, seen, digest)
            else:
                digest = known[1]
        return self._settle(name, seen, digest)

    def _settle(self, name: str, seen: _Seen, digest: str) -> tuple[_Seen, str]:
        known = self._digests.get(name)
        wanted = self.pins.get(name) or (known[1] if known else digest)
        if digest != wanted:
            why = (
                f"the file {name!r} changed: SHA-256 {digest[:12]}... instead of "
                f"{wanted[:12]}...; submit the scene again to use the new file"
            )
            raise AssetChanged([Fault("", "asset_changed", why)])
        self._digests[name] = (seen, digest)
        return self._digests[name]


def _remember(real: Path, seen: _Seen, digest: str) -> None:
    """Keep a digest for other scenes, of a file that has rested: clocks of files are coarse."""
    if time.time_ns() - max(seen.modified_ns, seen.changed_ns) > RESTED_NS:
        _HASHED[real] = seen, digest
        while len(_HASHED) > MAX_HASHED:
            _HASHED.pop(next(iter(_HASHED)), None)


def unsafe(name: str) -> str | None:
    """Say why `name` cannot be a path below the asset root, or return None."""
    slashes = name.replace("\\", "/")
    if "\0" in name:
        return "holds a NUL character"
    if slashes.startswith("/") or re.match(r"^[A-Za-z]:/", slashes):
        return "is an absolute path; give it relative to the asset root"
    if _URL.match(name):
        return "is a URL; put the file under the asset root and give its relative path"
    if ".." in slashes.split("/"):
        return "climbs out with '..'; files live under the asset root"
    return None


def _open(path: Path) -> BufferedReader:
    return os.fdopen(os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW), "rb")
