"""The event log: append within a transaction, read in order."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from matiere.jobs.job import Event, JsonDict
from matiere.jobs.store import outbox
from matiere.jobs.store.tables import event


def emit(
    c: Connection, kind: str, job_id: str | None = None, sweep_id: str | None = None, **data: Any
) -> None:
    """Append one event of a job (name its sweep too, if it has one) or of a sweep."""
    _count(c, kind, 1, bool(data.get("cached")))
    _tell(c, kind, [(job_id, sweep_id, data)])
    c.execute(
        sa.insert(event).values(
            time=time.time(),
            kind=kind,
            job_id=job_id,
            sweep_id=sweep_id,
            data=json.dumps(data, allow_nan=False),
        )
    )


def emit_news(c: Connection, news: Sequence[JsonDict]) -> None:
    """Append events that are of no job: `{"kind": ..., ...}`."""
    for fields in news:
        emit(c, **fields)


def newest(c: Connection) -> int:
    """Return the number of the newest event, 0 if there is none."""
    return c.scalar(sa.select(sa.func.max(event.c.seq))) or 0


def kept(c: Connection) -> tuple[int, int]:
    """Return the numbers of the oldest and the newest event, 0 and 0 if there is none."""
    oldest = c.scalar(sa.select(sa.func.min(event.c.seq))) or 0
    return oldest, newest(c)


def prune(c: Connection, keep: int, limit: int) -> int:
    """Remove the oldest events beyond the newest `keep` numbers; return how many."""
    last = newest(c) - keep
    some = sa.select(event.c.seq).where(event.c.seq <= last).order_by(event.c.seq).limit(limit)
    seqs = list(c.execute(some).scalars())
    if not seqs:
        return 0
    return c.execute(sa.delete(event).where(event.c.seq <= seqs[-1])).rowcount


def emit_all(
    c: Connection, kind: str, about: Sequence[tuple[str | None, str | None, JsonDict]]
) -> None:
    """Append one event each for many jobs: (job, its sweep, data)."""
    now = time.time()
    rows = [
        {"time": now, "kind": kind, "job_id": job_id, "sweep_id": sweep_id,
         "data": json.dumps(data, allow_nan=False)}
        for job_id, sweep_id, data in about
    ]  # fmt: skip
    if rows:
        _count(c, kind, len(rows), sum(bool(data.get("cached")) for _, _, data in about))
        _tell(c, kind, about)
        c.execute(sa.insert(event), rows)


def read_history(c: Connection, job_id: str, limit: int) -> list[Event]:
    """Return the newest events of a job but for `progress`, oldest first."""
    told = (event.c.job_id == job_id) & (event.c.kind != "progress")
    rows = sa.select(event).where(told).order_by(event.c.seq.desc()).limit(limit)
    return [_event(r) for r in reversed(c.execute(rows).all())]


def _event(r: Any) -> Event:
    return Event(r.seq, r.time, r.kind, r.job_id, r.sweep_id, json.loads(r.data))


def _tell(
    c: Connection, kind: str, about: Sequence[tuple[str | None, str | None, JsonDict]]
) -> None:
    """Put events into the outbox, if this process sends any."""
    if c.info.get("outbox"):
        outbox.enqueue(c, kind, about)


def _count(c: Connection, kind: str, times: int, cached: int) -> None:
    """Count for `Measures.events`, which gets it if the transaction is committed."""
    if (happened := c.info.get("happened")) is not None:
        happened[kind] += times
        happened["cached"] += cached


def read_events(
    c: Connection, after: int, job_id: str | None, sweep_id: str | None, limit: int
) -> list[Event]:
    """Return events with `seq > after`, oldest first."""
    rows = sa.select(event).where(event.c.seq > after).order_by(event.c.seq).limit(limit)
    if job_id is not None:
        rows = rows.where(event.c.job_id == job_id)
    if sweep_id is not None:
        rows = rows.where(event.c.sweep_id == sweep_id)
    return [_event(r) for r in c.execute(rows)]
