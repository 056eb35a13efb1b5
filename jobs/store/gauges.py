"""What waits and works now, counted along indexes: cheap however many jobs have ended."""

from __future__ import annotations

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from matiere.jobs.job import LIVE_STATES, JobState
from matiere.jobs.store.tables import job, sweep


def live_jobs(c: Connection) -> dict[str, int]:
    """Return how many jobs are queued, running and paused."""
    return {
        state.value: c.scalar(sa.select(sa.func.count()).where(job.c.state == state.value)) or 0
        for state in LIVE_STATES
    }


def queue(c: Connection) -> list[tuple[int, int, float]]:
    """Return (priority, jobs that wait, since when the oldest does in Unix seconds)."""
    rows = (
        sa.select(job.c.priority, sa.func.count(), sa.func.min(job.c.queued))
        .where(job.c.state == JobState.QUEUED.value)
        .group_by(job.c.priority)
    )
    return [(int(r[0]), int(r[1]), float(r[2])) for r in c.execute(rows)]


def unexpanded_cells(c: Connection) -> int:
    """Return how many cells of unfinished sweeps have no job yet."""
    waiting = sa.select(sa.func.sum(sweep.c.cells - sweep.c.expanded)).where(
        sweep.c.finished.is_(None), ~sweep.c.cancelled
    )
    return int(c.scalar(waiting) or 0)


def look(c: Connection) -> tuple[dict[str, int], list[tuple[int, int, float]], int]:
    """Return all of these."""
    return live_jobs(c), queue(c), unexpanded_cells(c)
