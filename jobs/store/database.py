"""One database, one writer: transactions and migrations over SQLite or PostgreSQL.

All writes of a process run in one writer thread on one connection, each in its own transaction;
readers get read-only connections with a consistent snapshot.
"""

from __future__ import annotations

import logging
import queue
import shutil
import threading
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar

import alembic.command
import alembic.config
import alembic.script
import sqlalchemy as sa
from alembic.migration import MigrationContext
from sqlalchemy.engine import Connection

from matiere.jobs.errors import DiskFull, StoreError
from matiere.jobs.measure import Measures
from matiere.jobs.store import postgresql, sqlite

logging.getLogger("alembic").setLevel(logging.WARNING)
T = TypeVar("T")
P = ParamSpec("P")
Task = tuple[Callable[[Connection], Any] | None, Future[Any]]  # None: compact


def _translate(error: sa.exc.DBAPIError) -> StoreError:
    text = str(error.orig).strip()
    full = ("disk is full", "No space left", "disk I/O error")
    if any(words in text for words in full) or getattr(error.orig, "sqlstate", "") == "53100":
        return DiskFull(f"the job database cannot grow: {text}; free space on its disk")
    ours = type(error.orig).__module__.startswith("psycopg")
    if ours and getattr(error.orig, "sqlstate", None) is None:
        return StoreError(f"cannot reach the job database: {text}")
    return StoreError(f"the job database refused: {text}")


class Database:
    """The open store. `write` and `read` take a function of a connection and return its result."""

    def __init__(self, path: Path | None, url: str | None = None, *, migrate: bool = True) -> None:
        """Open (and create) `path` with SQLite, or a PostgreSQL database by `url`."""
        self.path = path
        self.measures = Measures()
        self.on_commit: Callable[[], None] | None = None  # called in the writer thread
        self.has_file: Callable[[str, int], bool] | None = None  # see `files.add_references`
        self.shared = url is not None  # other processes may write too
        self.outbox = False  # whether events go to webhooks: set it before the first event
        self._leads = False
        if url is not None:
            self._writer = postgresql.open_postgresql(url, writer=True)
            self._readers = postgresql.open_postgresql(url, writer=False)
            sa.event.listen(self._writer, "connect", self._lose_lease)
        else:
            assert path is not None
            sqlite.refuse_network_file_system(path.parent)
            self._writer = sqlite.open_sqlite(path, writer=True)
            self._readers = sqlite.open_sqlite(path, writer=False)
        self._tasks: queue.SimpleQueue[Task | None]
        self._tasks = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="matiere-writer", daemon=True)
        self._thread.start()
        self._closed = False
        try:
            if not self.shared:
                self.write(lambda c: sqlite.check_sqlite(c, self.path))
            if migrate:
                self._migrate()
        except BaseException:
            self.close()
            raise

    # -- transactions -------------------------------------------------------------------------
    def write(
        self, action: Callable[Concatenate[Connection, P], T], *args: P.args, **kwargs: P.kwargs
    ) -> T:
        """Run `action(connection, ...)` in one write transaction; raise what it raises.

        It runs in the writer thread.
        """
        if self._closed:
            raise StoreError("the job database is closed")
        future: Future[T] = Future()
        begun = time.monotonic()
        self._tasks.put((lambda c: action(c, *args, **kwargs), future))
        try:
            return future.result()
        finally:
            self.measures.writes.observe(time.monotonic() - begun)

    def read(
        self, action: Callable[Concatenate[Connection, P], T], *args: P.args, **kwargs: P.kwargs
    ) -> T:
        """Run `action(connection, ...)` on a read-only connection, in one consistent snapshot."""
        try:
            with self._readers.connect() as connection, connection.begin():
                return action(connection, *args, **kwargs)
        except sa.exc.DBAPIError as error:
            raise _translate(error) from error

    def _run(self) -> None:
        while (task := self._tasks.get()) is not None:
            action, future = task
            try:
                if action is None:
                    sqlite.vacuum(self._writer)
                    future.set_result(None)
                    continue
                with self._writer.begin() as connection:
                    connection.info.update(has_file=self.has_file, outbox=self.outbox)
                    happened = connection.info["happened"] = Counter()
                    result = action(connection)
                self.measures.events.update(happened)
                if self.on_commit is not None:  # first: who gets the result may read at once
                    self.on_commit()
                future.set_result(result)
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

    # -- the scheduler lease --------------------------------------------------------------------
    @property
    def leads(self) -> bool:
        """Tell whether this process is the one that schedules."""
        return self._leads

    def lead(self) -> bool:
        """Try to become the process that schedules: at once on SQLite, whose lock is the folder's.

        It lasts until `follow`, `close`, or the loss of the writing connection.
        """
        if self.shared:
            self._leads = self.write(postgresql.take_lease)
        else:
            self._leads = True
        return self._leads

    def follow(self) -> None:
        """Let another process schedule."""
        if self.shared and self._leads:
            self.write(postgresql.drop_lease)
        self._leads = False

    def _lose_lease(self, _connection: Any, _record: Any) -> None:
        self._leads = False  # the lease went with the connection before this one

    # -- start --------------------------------------------------------------------------------
    def _migrate(self) -> None:
        config = alembic.config.Config()
        config.set_main_option("script_location", str(Path(__file__).parents[1] / "migrations"))
        script = alembic.script.ScriptDirectory.from_config(config)
        head = script.get_current_head()
        known = {revision.revision for revision in script.walk_revisions()}

        def revision(connection: Connection) -> str | None:
            return MigrationContext.configure(connection).get_current_revision()

        def upgrade(connection: Connection) -> None:
            if revision(connection) == head:  # another process was faster
                return
            config.attributes["connection"] = connection
            alembic.command.upgrade(config, "head")

        current = self.read(revision)
        if current == head:
            return
        if current is not None and current not in known:
            raise StoreError(
                f"the job database is at revision {current}, newer than this program ({head}); "
                "install the newer matiere or choose another --data"
            )
        if current is not None and self.path is not None:
            sqlite.backup_sqlite(self.path, self.path.with_suffix(f".{current}.backup"))
        self.write(upgrade)

    def size(self) -> int:
        """Return the bytes the store takes, its log included."""
        if self.path is None:
            text = "SELECT pg_database_size(current_database())"
            return int(self.read(lambda c: c.exec_driver_sql(text).scalar_one()))
        files = (self.path, self.path.with_name(self.path.name + "-wal"))
        return sum(file.stat().st_size for file in files if file.exists())

    def compact(self, waited_for: bool = True) -> bool:
        """Give the free pages of an SQLite file back to the disk, where they are worth the work.

        Writers wait meanwhile, about a second for 100 MB. PostgreSQL does so by itself.
        """
        if self.path is None or not self.read(sqlite.worth_compacting, waited_for):
            return False
        if shutil.disk_usage(self.path.parent).free < 3 * self.size():  # the copy, and its log
            return False
        future: Future[Any] = Future()
        self._tasks.put((None, future))
        future.result()
        return True

    def check(self) -> None:
        """Do one harmless write transaction; raise StoreError if it fails."""
        self.write(lambda c: c.exec_driver_sql("UPDATE instance SET pid = pid WHERE 1 = 0"))
