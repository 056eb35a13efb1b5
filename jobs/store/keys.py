"""API keys, and which of them submitted what."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from matiere.jobs.store.jobs import LIVE
from matiere.jobs.store.tables import api_key, job, sweep


def add(c: Connection, **values: Any) -> None:
    """Insert a key."""
    c.execute(sa.insert(api_key).values(**values))


def rows(c: Connection) -> Sequence[Any]:
    """Return all keys, oldest first."""
    return c.execute(sa.select(api_key).order_by(api_key.c.created, api_key.c.id)).all()


def change(c: Connection, key_id: str, **values: Any) -> int:
    """Change a key; return how many there were."""
    return c.execute(sa.update(api_key).where(api_key.c.id == key_id).values(**values)).rowcount


def note_owner(c: Connection, target_id: str, key_id: str, samples: float) -> None:
    """Remember who submitted a job or sweep (the first time), and the samples it asks for."""
    for table in (job, sweep):
        mine = (table.c.id == target_id) & table.c.owner.is_(None)
        c.execute(sa.update(table).where(mine).values(owner=key_id, samples=samples))


def load(c: Connection, key_id: str) -> tuple[int, float]:
    """Return how many jobs and cells of a key have not ended, and the samples they ask for."""
    each = sweep.c.samples / sweep.c.cells
    live = c.execute(
        sa.select(
            sa.func.count(),
            sa.func.sum(sa.case((job.c.sweep_id.is_(None), job.c.samples), else_=each)),
        )
        .select_from(job.outerjoin(sweep, job.c.sweep_id == sweep.c.id))
        .where(job.c.state.in_(LIVE))
        .where(sa.func.coalesce(sweep.c.owner, job.c.owner) == key_id)
    ).one()
    left = sweep.c.cells - sweep.c.expanded  # cells that are no jobs yet
    waiting = c.execute(
        sa.select(sa.func.sum(left), sa.func.sum(left * each)).where(
            ~sweep.c.cancelled, sweep.c.owner == key_id
        )
    ).one()
    return int(live[0]) + int(waiting[0] or 0), float(live[1] or 0) + float(waiting[1] or 0)
