"""Jobs and sweeps that somebody deletes: gone in one transaction, whatever they were doing.

Nothing is told to stop here: a film that no job names is abandoned by the scheduler as after a
cancel, and a report that still comes finds nothing to be written to. Such films are marked as
forgotten and dropped once no child holds them; asked for again before that, they are kept.
A sweep may have 100,000 cells, and writers wait for each other: it is hidden in the transaction
that deletes it, and its rows go slice by slice after that, after a restart too.
One event stays of what was deleted, so that lists that follow the events learn of it, and so that a
deletion that is sent twice is answered alike.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Sequence
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from matiere.jobs.errors import DeletionRefused, JobNotFound
from matiere.jobs.job import JobState
from matiere.jobs.store.events import emit
from matiere.jobs.store.files import drop_references, mark_unreferenced
from matiere.jobs.store.jobs import LIVE
from matiere.jobs.store.tables import (
    attempt,
    chunk,
    dependency,
    event,
    film,
    idempotency,
    job,
    job_history,
    reference,
    sweep,
)

JOB, SWEEP = "deleted", "sweep_deleted"  # kinds of the events that stay
FORGOTTEN = -1.0  # `film.used` of a film whose jobs were all deleted
BATCH = 500  # ids in one statement


def delete_job(c: Connection, job_id: str) -> bool:
    """Remove a job with its results; false if it was deleted before.

    Raises JobNotFound, and DeletionRefused for a cell, a pinned job, and one others wait for.
    """
    row = c.execute(sa.select(job).where(job.c.id == job_id)).first()
    if row is None:
        _was_deleted(c, event.c.job_id == job_id, JOB, f"no job {job_id}")
        return False
    if row.sweep_id is not None:
        why = f"the job is cell {row.cell} of sweep {row.sweep_id}, which is deleted as a whole"
        raise DeletionRefused(why, code="part_of_sweep")
    if row.pinned:
        raise DeletionRefused("the job is pinned", code="pinned")
    _refuse_needed(c, [job_id], job.c.id == job_id)
    _remove(c, [job_id])
    emit(c, JOB, job_id=job_id)
    return True


def delete_sweep(c: Connection, sweep_id: str) -> bool:
    """Hide a sweep with its cells, results and night; false if it was deleted before.

    `remove_hidden` removes the rows. Raises JobNotFound, and DeletionRefused while it or a cell is
    pinned or waited for.
    """
    row = c.execute(sa.select(sweep).where(sweep.c.id == sweep_id)).first()
    if row is None:
        _was_deleted(c, event.c.sweep_id == sweep_id, SWEEP, f"no sweep {sweep_id}")
        return False
    if row.deleted:
        return False
    mine = job.c.sweep_id == sweep_id
    cell = c.execute(sa.select(job.c.cell).where(mine, job.c.pinned).limit(1)).scalar()
    if row.pinned or cell is not None:
        whose = "the sweep" if row.pinned else f"cell {cell} of the sweep"
        raise DeletionRefused(f"{whose} is pinned", code="pinned")
    _refuse_needed(c, [sweep_id], mine)
    now = time.time()
    over = {"deleted": True, "cancelled": True, "finished": row.finished or now}
    c.execute(sa.update(sweep).where(sweep.c.id == sweep_id).values(over))
    stopped = {"state": JobState.CANCELLED.value, "finished": now}
    c.execute(sa.update(job).where(mine, job.c.state.in_(LIVE)).values(stopped))
    _forget_names(c, [sweep_id])
    emit(c, SWEEP, sweep_id=sweep_id, cells=row.cells)
    return True


def hidden(c: Connection) -> str | None:
    """Return a deleted sweep whose rows are still there, if there is one."""
    return c.scalar(sa.select(sweep.c.id).where(sweep.c.deleted).limit(1))


def remove_hidden(c: Connection, limit: int) -> bool:
    """Remove some cells of a deleted sweep, or the last of it; false if there is none."""
    sweep_id = hidden(c)
    if sweep_id is None:
        return False
    cells = sa.select(job.c.id).where(job.c.sweep_id == sweep_id).limit(limit)
    if names := list(c.execute(cells).scalars()):
        _remove(c, names)
        return True
    c.execute(sa.delete(event).where(event.c.sweep_id == sweep_id, event.c.kind != SWEEP))
    _drop_files(c, "sweep", [sweep_id])
    c.execute(sa.delete(sweep).where(sweep.c.id == sweep_id))
    return True


def _was_deleted(c: Connection, mine: sa.ColumnElement[bool], kind: str, why: str) -> None:
    if c.scalar(sa.select(event.c.seq).where(mine, event.c.kind == kind).limit(1)) is None:
        raise JobNotFound(why)


def _refuse_needed(c: Connection, names: Sequence[str], mine: sa.ColumnElement[bool]) -> None:
    """Raise while a job that has not ended waits for any of `names` or of the jobs `mine`."""
    wanted = dependency.c.needs.in_(names) | dependency.c.needs.in_(sa.select(job.c.id).where(mine))
    waiters = list(c.execute(sa.select(dependency.c.waiter).where(wanted)).scalars())
    waiting = job.c.state.in_(LIVE) & (job.c.id.in_(waiters) | job.c.sweep_id.in_(waiters))
    first = c.execute(sa.select(job.c.id, job.c.sweep_id).where(waiting).limit(1)).first()
    if first is not None:
        who = f"sweep {first.sweep_id}" if first.sweep_id else f"job {first.id}"
        raise DeletionRefused(f"{who} waits for it", code="waited_for")


def _remove(c: Connection, names: Sequence[str]) -> None:
    """Remove jobs with all that is theirs."""
    mine = job.c.id.in_(names)
    film_ids = set(c.execute(sa.select(job.c.film_id).where(mine)).scalars())
    c.execute(sa.delete(event).where(event.c.job_id.in_(names)))
    _drop_files(c, "job", names)
    c.execute(sa.delete(job_history).where(job_history.c.job_id.in_(names)))
    _forget_names(c, names)
    c.execute(sa.delete(job).where(mine))
    wanted = sa.exists().where(job.c.film_id == film.c.id)
    left = sa.update(film).where(film.c.id.in_(film_ids), ~wanted)
    c.execute(left.values(used=FORGOTTEN))


def _forget_names(c: Connection, names: Sequence[str]) -> None:
    c.execute(sa.delete(idempotency).where(idempotency.c.target_id.in_(names)))
    either = dependency.c.waiter.in_(names) | dependency.c.needs.in_(names)
    c.execute(sa.delete(dependency).where(either))


def _drop_files(c: Connection, owner: str, names: Sequence[str]) -> None:
    """Forget files and have those that nobody else names unlinked: they were asked to go."""
    mine = (reference.c.owner == owner) & reference.c.owner_id.in_(names)
    gone = c.execute(sa.delete(reference).where(mine).returning(reference.c.digest))
    for digests in _slices(sorted(set(gone.scalars()))):
        mark_unreferenced(c, digests)


def _slices(items: Sequence[Any]) -> Iterator[Sequence[Any]]:
    for start in range(0, len(items), BATCH):
        yield items[start : start + BATCH]


# -- films --------------------------------------------------------------------------------------
def forgotten_films(c: Connection, limit: int) -> dict[int, bool]:
    """Return films whose jobs were all deleted, and whether a child holds them as a whole."""
    wanted = sa.exists().where(job.c.film_id == film.c.id)
    rows = sa.select(film.c.id, film.c.claim_token).where(film.c.used < 0, ~wanted)
    return {i: token is not None for i, token in c.execute(rows.limit(limit))}


def drop_forgotten(c: Connection, film_ids: Collection[int]) -> int:
    """Drop those of the films that are still forgotten, with their samples; return how many."""
    wanted = sa.exists().where(job.c.film_id == film.c.id)
    mine = film.c.id.in_(list(film_ids)) & (film.c.used < 0) & film.c.claim_token.is_(None)
    found = list(c.execute(sa.select(film.c.id).where(mine, ~wanted)).scalars())
    drop_films(c, found)
    return len(found)


def drop_films(c: Connection, film_ids: Sequence[int]) -> None:
    """Drop films that no job names, with samples and claims.

    The rows of the newest film and of the newest claim stay, emptied: no number is used twice, so
    that what a child still reports is never taken for something else.
    """
    if not film_ids:
        return
    of_film = attempt.c.film_id.in_(film_ids)
    tokens = c.execute(sa.select(attempt.c.id).where(of_film)).scalars()
    drop_references(c, "attempt", [str(token) for token in tokens])
    c.execute(sa.delete(chunk).where(chunk.c.film_id.in_(film_ids)))
    last_claim = sa.select(sa.func.max(attempt.c.id)).scalar_subquery()
    c.execute(sa.delete(attempt).where(of_film, attempt.c.id < last_claim))
    over = sa.case((attempt.c.state.in_(("running", "done")), "void"), else_=attempt.c.state)
    c.execute(sa.update(attempt).where(of_film).values(film_id=None, state=over))
    drop_references(c, "film", [str(film_id) for film_id in film_ids])
    newest = c.scalar(sa.select(sa.func.max(film.c.id)))
    c.execute(sa.delete(film).where(film.c.id.in_(film_ids), film.c.id < newest))
    empty = {"film_key": f"gone {newest}", "scene": "", "plan": None, "prefix_chunks": 0,
             "prefix_spp": 0, "prefix_record": 0, "pixel_samples": 0, "used": 0.0}  # fmt: skip
    c.execute(sa.update(film).where(film.c.id.in_(film_ids)).values(empty))


# -- what stays ---------------------------------------------------------------------------------
def forget_deletions(c: Connection, before: float, limit: int) -> int:
    """Remove what tells of deletions before a moment; return how many lines."""
    old = event.c.kind.in_((JOB, SWEEP)) & (event.c.time < before)
    seqs = list(c.execute(sa.select(event.c.seq).where(old).limit(limit)).scalars())
    for some in _slices(seqs):
        c.execute(sa.delete(event).where(event.c.seq.in_(some)))
    return len(seqs)
