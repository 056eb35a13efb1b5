"""The data directory: its layout, its lock, and the note that says who serves it.

    store.sqlite   artifacts/ab/cd/<sha256>   assets/   views/   logs/   server.json   lock

One process at a time owns it (flock on `lock`, released by the kernel when the process dies).
"""

from __future__ import annotations

import errno
import fcntl
import hashlib
import json
import os
import re
from collections.abc import Mapping
from pathlib import Path

from matiere.jobs.artifacts import ArtifactFolder, Artifacts, open_artifacts
from matiere.jobs.errors import AssetMissing, DataDirLocked, DiskFull, JobsError
from matiere.jobs.job import JsonDict
from matiere.scene.assets import unsafe

PRIVATE = 0o700
_DIGEST = re.compile(r"[0-9a-f]{64}")


class DataDir:
    """A locked data directory; make one with `DataDir.open`."""

    def __init__(self, root: Path, lock_fd: int, artifacts_url: str | None = None) -> None:
        """Use `open`."""
        self.root = root
        self._lock_fd = lock_fd
        self.store = root / "store.sqlite"
        self.artifacts: Artifacts = open_artifacts(artifacts_url or root / "artifacts")
        self.assets = root / "assets"
        self.views = root / "views"
        self.logs = root / "logs"
        self.server_note = root / "server.json"

    @classmethod
    def open(cls, path: str | Path, artifacts_url: str | None = None) -> DataDir:
        """Make what is missing (mode 0700) and lock it. Raises DataDirLocked.

        With `artifacts_url` artifacts lie in that object store.
        """
        root = Path(path).absolute()
        for folder in (root, root / "artifacts", root / "assets", root / "views", root / "logs"):
            try:
                folder.mkdir(mode=PRIVATE, parents=True, exist_ok=True)
            except OSError as error:
                raise JobsError(
                    f"cannot make the data directory {folder}: {error.strerror}; "
                    "choose another with --data"
                ) from error
        fd = os.open(root / "lock", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(fd)
            note = read_server_note(root)
            raise DataDirLocked(str(root), note.get("url"), note.get("pid")) from None
        try:
            self = cls(root, fd, artifacts_url)
        except BaseException:
            os.close(fd)
            raise
        self.announce(None)
        ArtifactFolder(root / "artifacts").remove_temporary()  # also what children scribble
        return self

    def announce(self, url: str | None, **more: str | None) -> None:
        """Write `server.json` with this process's pid and URL; only its owner may read it."""
        note = json.dumps({"url": url, "pid": os.getpid(), **more})
        temporary = self.root / "server.json.tmp"
        temporary.unlink(missing_ok=True)
        with os.fdopen(
            os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w"
        ) as file:
            file.write(note + "\n")
        temporary.replace(self.server_note)

    def close(self) -> None:
        """Remove the note and release the lock."""
        if self._lock_fd < 0:
            return
        self.server_note.unlink(missing_ok=True)
        os.close(self._lock_fd)
        self._lock_fd = -1

    # -- assets -------------------------------------------------------------------------------
    def asset_path(self, digest: str) -> Path:
        """Return where the uploaded asset with this SHA-256 lies."""
        return self.assets / ".sha256" / digest[:2] / digest

    def view(self, assets: Mapping[str, str]) -> Path:
        """Return a folder that shows uploaded assets under the names a scene uses.

        The files are hard links; names not in `assets` are taken from the asset folder itself.
        Raises AssetMissing for a digest that was not uploaded.
        """
        if not assets:
            return self.assets
        manifest = json.dumps(sorted(assets.items()))
        folder = self.views / hashlib.sha256(manifest.encode()).hexdigest()[:32]
        for name, digest in sorted(assets.items()):
            if unsafe(name) or not Path(name).parts:
                continue  # the scene's own check refuses it, with a pointer
            if not is_digest(digest) or not (source := self.asset_path(digest)).exists():
                raise AssetMissing(
                    f"asset {name!r} (SHA-256 {digest}) is not in the store; upload it with "
                    f"PUT /v1/assets/{digest} and submit again"
                )
            _link(source, folder / name)
        return folder

    def relative(self, folder: Path) -> str:
        """Return a folder of assets as films name it: a data directory may be moved or copied."""
        return (
            str(folder.relative_to(self.root)) if folder.is_relative_to(self.root) else str(folder)
        )

    def link_named(self, folder: Path, name: str) -> None:
        """Show a file of the asset folder inside a view as well, if there is one."""
        if folder == self.assets or unsafe(name) or not Path(name).parts:
            return
        real = Path(os.path.realpath(self.assets / name))
        if real.is_file() and real.is_relative_to(os.path.realpath(self.assets)):
            _link(real, folder / name)


def _link(source: Path, target: Path) -> None:
    try:
        target.parent.mkdir(mode=PRIVATE, parents=True, exist_ok=True)
        os.link(source, target)
    except FileExistsError:
        pass
    except OSError as error:
        if error.errno == errno.ENOSPC:
            raise DiskFull(f"cannot show an asset to the renderer: {error.strerror}") from error
        # A name no folder can hold: the scene's own check says that the file does not exist.


def is_digest(text: str) -> bool:
    """Tell whether `text` is a SHA-256 in lower-case hex."""
    return _DIGEST.fullmatch(text) is not None


def read_server_note(path: str | Path) -> JsonDict:
    """Return `{"url": ..., "pid": ...}` of the process that serves a data directory, or {}."""
    try:
        note = json.loads((Path(path) / "server.json").read_text())
    except (OSError, ValueError):
        return {}
    return note if isinstance(note, dict) else {}
