"""The event log: append within a transaction, read in order."""

from __future__ import annotations

import json
import time
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from matiere.jobs.job import Event
from matiere.jobs.store.tables import event, job


def emit(
    c: Connection, kind: str, *, job_id: str | None = None, sweep_id: str | None = None, **data: Any
) -> None:
    """Append one event; the sweep of a job is filled in when not given."""
    if job_id is not None and sweep_id is None:
        sweep_id = c.scalar(sa.select(job.c.sweep_id).where(job.c.id == job_id))
    c.execute(
        sa.insert(event).values(
            time=time.time(),
            kind=kind,
            job_id=job_id,
            sweep_id=sweep_id,
            data=json.dumps(data, allow_nan=False),
        )
    )


def read_events(
    c: Connection, after: int, job_id: str | None, sweep_id: str | None, limit: int
) -> list[Event]:
    """Return events with `seq > after`, oldest first."""
    rows = sa.select(event).where(event.c.seq > after).order_by(event.c.seq).limit(limit)
    if job_id is not None:
        rows = rows.where(event.c.job_id == job_id)
    if sweep_id is not None:
        rows = rows.where(event.c.sweep_id == sweep_id)
    return [
        Event(r.seq, r.time, r.kind, r.job_id, r.sweep_id, json.loads(r.data))
        for r in c.execute(rows)
    ]
