"""One database, one writer: connections, transactions, migrations, start-up checks.

All writes run in one writer thread on one connection, each in its own transaction; readers get
read-only connections. On SQLite that means WAL, `synchronous=FULL`, `BEGIN IMMEDIATE` for writes
and pysqlite3 only: two SQLite libraries in one process lose each other's POSIX locks.
"""

from __future__ import annotations

import logging
import queue
import shutil
import threading
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any, TypeVar

import alembic.command
import alembic.config
import alembic.script
import sqlalchemy as sa
from alembic.migration import MigrationContext
from sqlalchemy.engine import Connection, Engine

from matiere.jobs.errors import DiskFull, StoreError

log = logging.getLogger("matiere.jobs.store")
logging.getLogger("alembic").setLevel(logging.WARNING)
T = TypeVar("T")

# Older libraries can corrupt a WAL that two connections reset at once (sqlite.org/wal.html).
SAFE_SQLITE = (3, 51, 3)
READ_CONNECTIONS = 8
BUSY_TIMEOUT_MS = 10_000
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


def _sqlite_engine(path: Path, *, writer: bool) -> Engine:
    from pysqlite3 import dbapi2

    pool: dict[str, Any] = {"pool_size": 1, "max_overflow": 0}
    if not writer:
        pool = {"pool_size": READ_CONNECTIONS, "max_overflow": 0, "pool_timeout": 60}
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
            pragmas += ["query_only=ON", "wal_autocheckpoint=0"]
        for pragma in pragmas:
            connection.execute(f"PRAGMA {pragma}")

    @sa.event.listens_for(engine, "begin")
    def _begin(connection: Connection) -> None:
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writer else "BEGIN")

    return engine


def _translate(error: sa.exc.DBAPIError) -> StoreError:
    text = str(error.orig)
    if "disk is full" in text or "No space left" in text or "disk I/O error" in text:
        return DiskFull(f"the job database cannot grow: {text}; free space on its disk")
    return StoreError(f"the job database refused: {text}")


class Database:
    """The open store. `write` and `read` take a function of a connection and return its result."""

    def __init__(self, path: Path | None, url: str | None = None) -> None:
        """Open (and create) `path` with SQLite, or any database by `url`."""
        self.path = path
        self.on_commit: Callable[[], None] | None = None  # called in the writer thread
        if url is not None:
            self._writer = sa.create_engine(url, pool_size=1, max_overflow=0)
            self._readers = sa.create_engine(url, pool_size=READ_CONNECTIONS)
        else:
            assert path is not None
            refuse_network_file_system(path.parent)
            self._writer = _sqlite_engine(path, writer=True)
            self._readers = _sqlite_engine(path, writer=False)
        self._tasks: queue.SimpleQueue[tuple[Callable[[Connection], Any], Future[Any]] | None]
        self._tasks = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="matiere-writer", daemon=True)
        self._thread.start()
        self._closed = False
        try:
            self._check_library()
            self._migrate()
        except BaseException:
            self.close()
            raise

    # -- transactions -------------------------------------------------------------------------
    def write(self, action: Callable[[Connection], T]) -> T:
        """Run `action` in one write transaction in the writer thread; raise what it raises."""
        if self._closed:
            raise StoreError("the job database is closed")
        future: Future[T] = Future()
        self._tasks.put((action, future))
        return future.result()

    def read(self, action: Callable[[Connection], T]) -> T:
        """Run `action` on a read-only connection, in one consistent snapshot."""
        try:
            with self._readers.connect() as connection, connection.begin():
                return action(connection)
        except sa.exc.DBAPIError as error:
            raise _translate(error) from error

    def _run(self) -> None:
        while (task := self._tasks.get()) is not None:
            action, future = task
            try:
                with self._writer.begin() as connection:
                    result = action(connection)
                future.set_result(result)
                if self.on_commit is not None:
                    self.on_commit()
            except sa.exc.DBAPIError as error:
                future.set_exception(_translate(error))
            except BaseException as error:
                future.set_exception(error)

    def close(self) -> None:
        """Finish queued writes and close all connections."""
        if self._closed:
            return
        self._closed = True
        self._tasks.put(None)
        self._thread.join()
        self._readers.dispose()
        self._writer.dispose()  # the last SQLite connection checkpoints the WAL

    # -- start --------------------------------------------------------------------------------
    def _check_library(self) -> None:
        if self._writer.dialect.name != "sqlite":
            return
        from pysqlite3 import dbapi2

        if dbapi2.sqlite_version_info < SAFE_SQLITE:
            log.warning("SQLite %s may corrupt a WAL; use 3.51.3 or newer", dbapi2.sqlite_version)
        found = self.write(lambda c: c.exec_driver_sql("PRAGMA quick_check(3)").scalars().all())
        if found != ["ok"]:
            raise StoreError(f"{self.path} is damaged: {'; '.join(map(str, found))}")

    def _migrate(self) -> None:
        config = alembic.config.Config()
        config.set_main_option("script_location", str(Path(__file__).parents[1] / "migrations"))
        script = alembic.script.ScriptDirectory.from_config(config)
        head = script.get_current_head()

        def upgrade(connection: Connection) -> None:
            config.attributes["connection"] = connection
            alembic.command.upgrade(config, "head")

        current = self.read(lambda c: MigrationContext.configure(c).get_current_revision())
        if current == head:
            return
        known = {revision.revision for revision in script.walk_revisions()}
        if current is not None and current not in known:
            raise StoreError(
                f"the job database is at revision {current}, newer than this program ({head}); "
                "install the newer matiere or choose another --data"
            )
        if current is not None and self.path is not None:
            shutil.copy2(self.path, self.path.with_suffix(f".{current}.backup"))
        self.write(upgrade)

    def check(self) -> None:
        """Do one harmless write transaction; raise StoreError if it fails."""
        self.write(lambda c: c.exec_driver_sql("UPDATE instance SET pid = pid WHERE 1 = 0"))
