"""SQLite as the job store: connections, checks of library and file, backup of a live store.

WAL, `synchronous=FULL`, `BEGIN IMMEDIATE` for writes, and pysqlite3 only: two SQLite libraries in
one process lose each other's POSIX locks.
"""

from __future__ import annotations

import contextlib
import logging
import os
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection, Engine

from matiere.jobs.errors import DiskFull, StoreError

log = logging.getLogger("matiere.jobs.store")

# Older libraries can corrupt a WAL that two connections reset at once (sqlite.org/wal.html).
SAFE_SQLITE = (3, 51, 3)
READ_CONNECTIONS = 8
READ_CACHE_KB = 512
BUSY_TIMEOUT_MS = 10_000
COMPACT_PAGES = 32
BACKUP_PAGES = 1000  # copied at a time; writers go on between
NETWORK_FILE_SYSTEMS = {"nfs", "nfs4", "cifs", "smb3", "smbfs", "9p", "afs", "ceph", "fuse.sshfs"}


def refuse_network_file_system(path: Path) -> None:
    """Raise StoreError if `path` lies on a file system whose locks SQLite cannot trust."""
    best, kind = "", ""
    try:
        lines = Path("/proc/self/mounts").read_text().splitlines()
    except OSError:
        return
    for line in lines:
        fields = line.split()
        where = fields[1].replace("\\040", " ").rstrip("/")
        if len(where) >= len(best) and f"{path.resolve()}/".startswith(where + "/"):
            best, kind = where, fields[2]
    if kind in NETWORK_FILE_SYSTEMS:
        raise StoreError(
            f"{path} is on a network file system ({kind}), where SQLite can lose data; "
            "choose a local --data directory"
        )


def open_sqlite(path: Path, *, writer: bool) -> Engine:
    """Return the pool of the one writing connection, or of the readers."""
    from pysqlite3 import dbapi2

    pool: dict[str, Any] = {"pool_size": 1, "max_overflow": 0}
    if not writer:
        pool = {
            "pool_size": READ_CONNECTIONS,
            "max_overflow": 0,
            "pool_timeout": 60,
            "pool_use_lifo": True,
        }  # few readers at a time keep few caches of pages
    engine = sa.create_engine(
        f"sqlite+pysqlite:///{path}",
        module=dbapi2,
        poolclass=sa.pool.QueuePool,
        connect_args={"check_same_thread": False, "timeout": BUSY_TIMEOUT_MS / 1000},
        **pool,
    )

    @sa.event.listens_for(engine, "connect")
    def _connect(connection: Any, _record: Any) -> None:
        connection.isolation_level = None  # SQLAlchemy's begin, not the driver's guess
        pragmas = ["foreign_keys=ON", f"busy_timeout={BUSY_TIMEOUT_MS}", "mmap_size=0"]
        if writer:
            pragmas += ["journal_mode=WAL", "synchronous=FULL", "journal_size_limit=67108864"]
        else:
            pragmas += ["query_only=ON", "wal_autocheckpoint=0", f"cache_size=-{READ_CACHE_KB}"]
        for pragma in pragmas:
            connection.execute(f"PRAGMA {pragma}")

    @sa.event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writer else "BEGIN")

    return engine


def check_sqlite(connection: Connection, path: Path | None) -> None:
    """Warn of a library with a known fault; raise StoreError if the file is damaged."""
    from pysqlite3 import dbapi2

    if dbapi2.sqlite_version_info < SAFE_SQLITE:
        log.warning("SQLite %s may corrupt a WAL; use 3.51.3 or newer", dbapi2.sqlite_version)
    found = connection.exec_driver_sql("PRAGMA quick_check(3)").scalars().all()
    if found != ["ok"]:
        raise StoreError(f"{path} is damaged: {'; '.join(map(str, found))}")


def worth_compacting(connection: Connection, waited_for: bool = True) -> bool:
    """Tell whether a quarter of the file, and not just a few pages, is free.

    A twentieth is enough where nobody waits meanwhile.
    """
    free = int(connection.exec_driver_sql("PRAGMA freelist_count").scalar_one())
    pages = int(connection.exec_driver_sql("PRAGMA page_count").scalar_one())
    return 20 * free >= pages if not waited_for else free >= COMPACT_PAGES and 4 * free >= pages


def vacuum(writer: Engine) -> None:
    """Write the file anew without its free pages, and empty its log."""
    with writer.connect() as connection:
        raw: Any = connection.connection.driver_connection
        raw.execute("VACUUM")
        raw.execute("PRAGMA wal_checkpoint(TRUNCATE)")


def backup_sqlite(source: Path, target: Path) -> None:
    """Copy a store as it is at one moment, WAL included, while others read and write it.

    The copy appears under its name only when it is complete and checked. Raises StoreError.
    """
    from pysqlite3 import dbapi2

    temporary = target.with_name(target.name + ".tmp")
    with contextlib.suppress(FileNotFoundError):
        temporary.unlink()
    try:
        with (
            contextlib.closing(dbapi2.connect(f"file:{source}?mode=rw", uri=True)) as old,
            contextlib.closing(dbapi2.connect(str(temporary))) as new,
        ):
            # Never checkpoint from here: the service's writer is the only one that does.
            old.execute("PRAGMA wal_autocheckpoint=0")
            old.execute(f"PRAGMA busy_timeout={BUSY_TIMEOUT_MS}")
            old.execute("BEGIN")  # one snapshot: a writer in another process does not restart it
            old.execute("SELECT count(*) FROM sqlite_master").fetchone()
            old.backup(new, pages=BACKUP_PAGES)
            old.execute("ROLLBACK")
            new.execute("PRAGMA journal_mode=DELETE")  # one file, no WAL beside it
            if (found := new.execute("PRAGMA quick_check(1)").fetchone()[0]) != "ok":
                raise StoreError(f"the backup of {source} is damaged: {found}")
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(target)
    except dbapi2.Error as error:
        temporary.unlink(missing_ok=True)
        kind = DiskFull if "full" in str(error) else StoreError
        raise kind(f"cannot back up {source} to {target}: {error}") from error
