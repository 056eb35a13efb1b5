"""A copy of a data directory, made while the service runs: `matiere backup`.

First the files are held (nothing is unlinked while the copy is made), then the store is copied as
it is at one moment, then every file that this copy names. So all that the copied store speaks of
is in the copy. Files that never change are hard links where the disk allows it.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from urllib.parse import unquote, urlsplit

from matiere.jobs.artifacts import ArtifactFolder, fsync_folder
from matiere.jobs.errors import DiskFull, JobsError
from matiere.jobs.storage import holding
from matiere.jobs.store import garbage
from matiere.jobs.store.database import Database
from matiere.jobs.store.sqlite import backup_sqlite

NOTE = "backup.json"
PRIVATE = 0o700


class BackupError(JobsError):
    """The backup cannot be made as asked."""

    default_code = "backup_failed"


@dataclass(frozen=True)
class Backup:
    """What was copied."""

    target: str
    files: int
    bytes: int  # of artifacts
    linked: int  # of the files: they share their bytes with the original
    assets: int
    seconds: float


def backup(
    data: Path,
    target: Path,
    *,
    database_url: str | None = None,
    artifacts_url: str | None = None,
    after_store: Callable[[], None] | None = None,
) -> Backup:
    """Copy the data directory `data` to the new folder `target`; the service may run meanwhile.

    Artifacts in an object store (`artifacts_url`) are not copied, and not held.
    It is made as `<target>.part` and gets its name when it is complete. `after_store` is called
    between store and files (tests). Raises BackupError or DiskFull.
    """
    begun = time.monotonic()
    if database_url is None and not (data / "store.sqlite").is_file():
        raise BackupError(f"{data} is no data directory of matiere: it has no store.sqlite")
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise BackupError(f"{target} exists and is not empty; name a new folder")
    part = target.with_name(target.name + ".part")
    try:
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir(mode=PRIVATE, parents=True)
        with holding(data, exclusive=False) as held:
            if not held:
                raise BackupError("the service is deleting files without end; try again")
            digests = _copy_store(data, part, database_url)
            if after_store is not None:
                after_store()
            made = _copy_files(data, part, {} if artifacts_url else digests)
        done = Backup(str(target), *made, time.monotonic() - begun)
        _write_note(part, done)
        if target.exists():
            target.rmdir()
        part.rename(target)
        fsync_folder(target.parent)
    except OSError as error:
        kind = DiskFull if error.errno in (errno.ENOSPC, errno.EDQUOT) else BackupError
        raise kind(f"cannot write the backup {target}: {error.strerror}") from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    return done


def _copy_store(data: Path, target: Path, database_url: str | None) -> dict[str, int]:
    if database_url is None:
        backup_sqlite(data / "store.sqlite", target / "store.sqlite")
        copy = Database(target / "store.sqlite", migrate=False)
        try:
            return copy.read(garbage.live_digests)
        finally:
            copy.close()
    database = Database(None, database_url, migrate=False)
    try:
        digests = database.read(garbage.live_digests)
        _dump_postgresql(database_url, target / "store.dump")
        return digests | database.read(garbage.live_digests)  # the dump's moment is between
    finally:
        database.close()


def _dump_postgresql(url: str, file: Path) -> None:
    name, environment = _without_password(url)
    command = ["pg_dump", "--format=custom", "--file", str(file), "--dbname", name]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    except FileNotFoundError:
        raise BackupError(
            "a PostgreSQL store is copied by pg_dump, which is not here: "
            "apt-get install postgresql-client"
        ) from None
    if done.returncode != 0:
        raise BackupError(f"pg_dump failed: {done.stderr.strip()[-500:]}")


def _without_password(url: str) -> tuple[str, dict[str, str]]:
    """Return the URL for `pg_dump` and its environment: a command line is for all to read."""
    parts = urlsplit(url)
    environment = dict(os.environ)
    if parts.password:
        environment["PGPASSWORD"] = unquote(parts.password)
    user, _, host = parts.netloc.rpartition("@")
    place = f"{user.split(':')[0]}@{host}" if user else host
    return parts._replace(scheme="postgresql", netloc=place).geturl(), environment


def _copy_files(data: Path, target: Path, digests: dict[str, int]) -> tuple[int, int, int, int]:
    source, copy = ArtifactFolder(data / "artifacts"), ArtifactFolder(target / "artifacts")
    copy.root.mkdir(mode=PRIVATE)
    linked = size = count = 0
    for digest in digests:
        try:
            linked += _link_or_copy(source.path(digest), copy.path(digest))
        except FileNotFoundError:
            continue  # damaged before the backup: rendered again when it is needed
        size, count = size + digests[digest], count + 1
    assets = 0
    for name in ("assets", "views"):
        (target / name).mkdir(mode=PRIVATE, exist_ok=True)
        for place, _, names in os.walk(data / name):
            fixed = name == "views" or ".sha256" in Path(place).parts  # never written again
            for entry in names:
                if entry.endswith(".tmp"):
                    continue
                path = Path(place, entry)
                there = target / path.relative_to(data)
                if fixed:
                    _link_or_copy(path, there)
                else:
                    there.parent.mkdir(mode=PRIVATE, parents=True, exist_ok=True)
                    shutil.copy2(path, there)
                assets += name == "assets"
    return count, size, linked, assets


def _link_or_copy(source: Path, target: Path) -> bool:
    """Link a file that never changes, or copy it durably; true if it was linked."""
    target.parent.mkdir(mode=PRIVATE, parents=True, exist_ok=True)
    try:
        os.link(source, target)
    except FileNotFoundError:
        raise
    except OSError:  # another disk, or one without links
        shutil.copyfile(source, target)
        with target.open("rb") as file:
            os.fsync(file.fileno())
        return False
    return True


def _write_note(target: Path, done: Backup) -> None:
    from importlib.metadata import PackageNotFoundError, version

    try:
        program = version("matiere")
    except PackageNotFoundError:
        program = "unknown"
    note = {"matiere": program, "made": time.time(), **asdict(done)}
    (target / NOTE).write_text(json.dumps(note, indent=1) + "\n")
    fsync_folder(target)
