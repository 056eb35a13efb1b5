"""PostgreSQL as the job store, by URL: several service processes, one writer, one scheduler.

Every write transaction takes one advisory lock first, as `BEGIN IMMEDIATE` does on SQLite: writes
of all processes follow one another, so events become visible in the order of their numbers and no
two transactions read the same state and then change it. The scheduler lease is a second advisory
lock, held by the session of the writing connection: it ends with the connection, on the server,
whatever became of the process.
"""

from __future__ import annotations

import logging
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection, Engine

from matiere.jobs.errors import StoreError

log = logging.getLogger("matiere.jobs.store")

READ_CONNECTIONS = 8
LOCK_SPACE = 0x6D617469  # "mati": advisory locks are a pair of numbers of our choice
WRITE_LOCK, LEASE_LOCK = 1, 2
MISSING = "a PostgreSQL store needs one more package: pip install 'matiere[postgres]'"
# A dead host's connection, and with it the lease, is given up after about half a minute.
SESSION = {
    "synchronous_commit": "on",
    "lock_timeout": "'30s'",
    "idle_in_transaction_session_timeout": "'60s'",
    "tcp_keepalives_idle": "10",
    "tcp_keepalives_interval": "5",
    "tcp_keepalives_count": "4",
}


def parse_url(url: str) -> sa.URL:
    """Return a database URL with our driver. Raises StoreError, never showing a password."""
    try:
        parsed = sa.make_url(url)
    except (sa.exc.ArgumentError, ValueError):
        raise StoreError(
            "database_url is not a URL; write postgresql://user@host/database"
        ) from None
    if parsed.drivername not in ("postgresql", "postgres", "postgresql+psycopg"):
        raise StoreError(
            f"database_url names {parsed.drivername!r}; the store is PostgreSQL "
            "(postgresql://user@host/database), or SQLite below --data when no URL is given"
        )
    try:
        import psycopg  # noqa: F401
    except ImportError:
        raise StoreError(MISSING) from None
    return parsed.set(drivername="postgresql+psycopg")


def open_postgresql(url: str, *, writer: bool) -> Engine:
    """Return the pool of the one writing connection of this process, or of its readers."""
    pool: dict[str, Any] = {"pool_size": 1, "max_overflow": 0}
    if not writer:
        pool = {"pool_size": READ_CONNECTIONS, "max_overflow": 0, "pool_timeout": 60}
    engine = sa.create_engine(
        parse_url(url),
        pool_pre_ping=True,  # a restarted server costs no failed request
        isolation_level="READ COMMITTED" if writer else "REPEATABLE READ",
        connect_args={"application_name": "matiere", "connect_timeout": 10},
        **pool,
    )

    @sa.event.listens_for(engine, "connect")
    def _connect(connection: Any, _record: Any) -> None:
        settings = SESSION | ({} if writer else {"default_transaction_read_only": "on"})
        with connection.cursor() as cursor:
            for name, value in settings.items():
                cursor.execute(f"SET {name} = {value}")
        connection.commit()

    if writer:

        @sa.event.listens_for(engine, "begin")
        def _begin(connection: Connection) -> None:
            connection.exec_driver_sql(f"SELECT pg_advisory_xact_lock({LOCK_SPACE}, {WRITE_LOCK})")

    return engine


def take_lease(connection: Connection) -> bool:
    """Try to become the process that schedules; it lasts as long as this connection."""
    found = connection.exec_driver_sql(f"SELECT pg_try_advisory_lock({LOCK_SPACE}, {LEASE_LOCK})")
    return bool(found.scalar_one())


def drop_lease(connection: Connection) -> None:
    """Let another process schedule."""
    connection.exec_driver_sql(f"SELECT pg_advisory_unlock({LOCK_SPACE}, {LEASE_LOCK})")
