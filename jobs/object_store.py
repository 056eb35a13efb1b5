"""Artifacts in an S3-compatible object store, through obstore (`pip install 'matiere[s3]'`).

The same promises as the folder's: an object appears whole, under the SHA-256 of its bytes, and is
never changed (`put` with create semantics). Credentials and endpoint come from the environment, as
for the other tools of AWS (`AWS_ACCESS_KEY_ID`, `AWS_ENDPOINT_URL`, ...); children inherit it.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
from collections.abc import Iterable, Iterator
from typing import Any
from urllib.parse import urlsplit

from matiere.jobs.artifacts import DamagedFile, StorageFault
from matiere.jobs.errors import StoreError

MISSING = "an object store needs one more package: pip install 'matiere[s3]'"
PIECE = 2**20  # bytes of one piece of a stream
SCHEMES = ("s3", "file", "memory")  # the last two for tests and trials


class ObjectStore:
    """A bucket (and prefix) of content-addressed objects `ab/cd/<sha256>`."""

    def __init__(self, url: str) -> None:
        """Use `s3://bucket/prefix`. Raises StoreError for another kind of URL."""
        if urlsplit(url).scheme not in SCHEMES or (url.startswith("s3:") and len(url) < 6):
            raise StoreError(f"artifacts_url is s3://bucket/prefix, not {url!r}")
        try:
            import obstore
            from obstore.store import from_url
        except ImportError:
            raise StoreError(MISSING) from None
        self.location = url
        self._calls = obstore
        options: dict[str, Any] = {"mkdir": True} if url.startswith("file:") else {}
        if url.startswith("s3:"):
            options = {
                "client_options": {"timeout": "60s", "connect_timeout": "10s", "allow_http": True},
                "retry_config": {"max_retries": 3},
            }
        try:
            self._store: Any = from_url(url, **options)
        except Exception as error:
            raise StoreError(f"the object store {url} cannot be used: {_first(error)}") from None

    def path(self, digest: str) -> None:
        """Return None: an object is no local file."""

    def write(self, pieces: Iterable[bytes]) -> tuple[str, int]:
        """Store bytes and return (digest, size). Raises StorageFault, leaving nothing."""
        data = b"".join(pieces)
        digest = hashlib.sha256(data).hexdigest()
        with self._faults():
            try:
                self._calls.put(self._store, _key(digest), data, mode="create", use_multipart=False)
            except FileExistsError:
                pass
            except Exception as error:
                if type(error).__name__ != "AlreadyExistsError":
                    raise
        return digest, len(data)

    def read(self, digest: str) -> bytes:
        """Return the bytes of an object, checked. Raises DamagedFile if missing or changed."""
        with self._faults(digest):
            data = bytes(self._calls.get(self._store, _key(digest)).bytes())
        if hashlib.sha256(data).hexdigest() != digest:
            self.remove(digest)  # so that it can be created again
            why = f"artifact {digest} does not hold the bytes it was stored with"
            raise DamagedFile(why, digest)
        return data

    def stream(self, digest: str) -> Iterator[bytes]:
        """Yield the bytes of an object in pieces. Raises DamagedFile if it is missing."""
        with self._faults(digest):
            for piece in self._calls.get(self._store, _key(digest)).stream(min_chunk_size=PIECE):
                yield bytes(piece)

    def has(self, digest: str, size: int) -> bool:
        """Tell whether an object of this name and size is there."""
        try:
            with self._faults(digest):
                return int(self._calls.head(self._store, _key(digest))["size"]) == size
        except (DamagedFile, StorageFault):
            return False

    def remove(self, digest: str) -> None:
        """Delete an object, if it is there."""
        self.remove_all([digest])

    def remove_all(self, digests: Iterable[str]) -> None:
        """Delete objects, where they are there."""
        keys = [_key(digest) for digest in digests]
        with self._faults(), contextlib.suppress(FileNotFoundError):
            if keys:
                self._calls.delete(self._store, keys)
            return
        for key in keys:  # only a folder stops at a missing one
            with contextlib.suppress(FileNotFoundError):
                self._calls.delete(self._store, key)

    def remove_temporary(self) -> int:
        """Do nothing: an unfinished `put` leaves nothing."""
        return 0

    def written_before(self, moment: float) -> Iterator[str]:
        """Yield the digests of objects last written before `moment` (Unix seconds)."""
        with self._faults():
            for batch in self._calls.list(self._store, chunk_size=500):
                for entry in batch:
                    if entry["last_modified"].timestamp() < moment:
                        yield entry["path"].rsplit("/", 1)[-1]

    @contextlib.contextmanager
    def _faults(self, digest: str = "") -> Iterator[None]:
        try:
            yield
        except (DamagedFile, GeneratorExit):
            raise
        except FileNotFoundError:
            if not digest:
                raise
            raise DamagedFile(f"artifact {digest} is missing", digest) from None
        except Exception as error:
            where = f"{self.location}: {_first(error)}"
            raise StorageFault(errno.EIO, "the object store does not answer", where) from error


def _key(digest: str) -> str:
    return f"{digest[:2]}/{digest[2:4]}/{digest}"


def _first(error: BaseException) -> str:
    return str(error).strip().split("\n")[0]
