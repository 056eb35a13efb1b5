"""What people do to jobs that are there: pause, resume, requeue, change priority; and deadlines.

A sweep is handled by one statement for all its cells and one event, however many they are.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Sequence
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from matiere.jobs.course import is_adaptive
from matiere.jobs.errors import IllegalTransition, JobNotFound
from matiere.jobs.job import (
    ACTIVE_STATES,
    AGEING_S,
    JobError,
    JobState,
    check_transition,
    queue_rank,
)
from matiere.jobs.store import dependencies, jobs, nights
from matiere.jobs.store.events import emit
from matiere.jobs.store.files import drop_references, find_reference
from matiere.jobs.store.tables import film, job, job_history, sweep

ACTIVE = [state.value for state in ACTIVE_STATES]
PAUSED, QUEUED = JobState.PAUSED.value, JobState.QUEUED.value
REQUEUED_STATES = (JobState.FAILED, JobState.CANCELLED, JobState.EXPIRED)
REQUEUED = [state.value for state in REQUEUED_STATES]
DEADLINE = "deadline"  # stop reason of a job that keeps what it has, and code of one with nothing
BATCH = 500  # ids in one statement


# -- pause and resume -------------------------------------------------------------------------
def pause_job(c: Connection, job_id: str) -> bool:
    """Pause a live job; false if it is paused already, or only its images are still to be made.

    Raises IllegalTransition for one that has ended.
    """
    row = _row(c, job_id)
    state = JobState(row.state)
    if state is JobState.PAUSED or (state is JobState.RUNNING and row.ended_spp is not None):
        return False
    jobs.set_state(c, job_id, JobState.PAUSED)
    return True


def resume_job(c: Connection, job_id: str) -> bool:
    """Queue a paused job again, in its old place; false if it is not paused.

    Raises IllegalTransition for one that has ended.
    """
    row = _row(c, job_id)
    state = JobState(row.state)
    if state.final:
        raise IllegalTransition(f"a {row.state} job cannot be resumed")
    if state is not JobState.PAUSED:
        return False
    jobs.set_state(c, job_id, JobState.QUEUED, resumed=True)
    if row.ended_spp is not None:  # its samples are complete: only images are missing
        jobs.set_state(c, job_id, JobState.RUNNING)
    jobs.reopen_if_failed(c, [row.film_id])
    return True


def pause_sweep(c: Connection, sweep_id: str) -> int:
    """Pause the cells that wait or render; return how many."""
    mine = (job.c.sweep_id == sweep_id) & job.c.state.in_(ACTIVE) & job.c.ended_spp.is_(None)
    return _change_cells(c, sweep_id, mine, ACTIVE_STATES, JobState.PAUSED)


def resume_sweep(c: Connection, sweep_id: str) -> int:
    """Queue the paused cells again, in their old places; return how many."""
    paused = (job.c.sweep_id == sweep_id) & (job.c.state == PAUSED)
    jobs.reopen_if_failed(c, sa.select(job.c.film_id).where(paused))
    complete = sa.select(job.c.id).where(paused, job.c.ended_spp.is_not(None))
    developed = list(c.execute(complete).scalars())
    found = _change_cells(c, sweep_id, paused, [JobState.PAUSED], JobState.QUEUED)
    for job_id in developed:
        jobs.set_state(c, job_id, JobState.RUNNING)
    return found


def _change_cells(
    c: Connection, sweep_id: str, mine: Any, old: Sequence[JobState], new: JobState
) -> int:
    for state in old:
        check_transition(state, new)
    paused = new is JobState.PAUSED
    c.execute(sa.update(sweep).where(sweep.c.id == sweep_id).values(paused=paused))
    found = c.execute(sa.update(job).where(mine).values(state=new.value)).rowcount
    kind = "sweep_paused" if paused else "sweep_resumed"
    if found:
        emit(c, kind, sweep_id=sweep_id, cells=found)
    return int(found)


# -- requeue ----------------------------------------------------------------------------------
def requeue_job(c: Connection, job_id: str) -> list[str]:
    """Queue an ended job again as its next attempt; return all that were requeued.

    What was cancelled because this one had failed comes back with it. A live job is left as it
    is. Raises IllegalTransition for a succeeded one, and while a job it waits for has failed.
    """
    row = _row(c, job_id)
    if not JobState(row.state).final:
        return []
    check_transition(JobState(row.state), JobState.QUEUED)
    return _requeue(c, [job_id])


def requeue_sweep(c: Connection, sweep_id: str) -> list[str]:
    """Queue again all cells that ended without success; return all that were requeued.

    A cancelled sweep goes on with the cells that had no job yet.
    """
    again = (sweep.c.id == sweep_id) & sweep.c.cancelled
    c.execute(sa.update(sweep).where(again).values(cancelled=False, finished=None))
    mine = (job.c.sweep_id == sweep_id) & job.c.state.in_(REQUEUED)
    found = list(c.execute(sa.select(job.c.id).where(mine)).scalars())
    return _requeue(c, found) if found else []


def _requeue(c: Connection, job_ids: Iterable[str]) -> list[str]:
    wanted, todo = dict.fromkeys(job_ids), list(job_ids)
    sweeps: set[str] = set()
    while todo:
        ended = todo.pop()
        names = [ended]
        if (sweep_id := _row(c, ended).sweep_id) is not None and sweep_id not in sweeps:
            sweeps.add(sweep_id)
            names.append(sweep_id)
        for name in names:
            for job_id in dependencies.cancelled_by(c, name):
                if job_id not in wanted:
                    wanted[job_id] = None
                    todo.append(job_id)
    again = {"finished": None, "cancelled": False}
    c.execute(sa.update(sweep).where(sweep.c.id.in_(sweeps)).values(again))
    for sweep_id in sweeps:
        nights.drop_pages(c, sweep_id)
    found = list(wanted)
    for start in range(0, len(found), BATCH):
        _start_over(c, found[start : start + BATCH])
    for job_id in found:
        _block_again(c, job_id)
    return found


def _start_over(c: Connection, job_ids: Sequence[str]) -> None:
    """Write down how these attempts ended and make the rows those of new ones."""
    mine, now = job.c.id.in_(job_ids), time.time()
    kept = [column.name for column in job_history.columns if column.name != "job_id"]
    past = sa.select(job.c.id, *(job.c[name] for name in kept)).where(mine)
    before = c.execute(sa.select(job.c.id, job.c.sweep_id, job.c.state, job.c.attempt).where(mine))
    rows = before.all()
    c.execute(sa.insert(job_history).from_select(["job_id", *kept], past))
    drop_references(c, "job", job_ids)
    forgotten = ("started", "finished", "target_share", "ended_spp", "ended_seconds",
                 "ended_relmse", "ended_relmse_lower", "ended_relmse_upper", "stop_reason",
                 "error_code", "error_message", "error_pointer", "error_log")  # fmt: skip
    merged = sa.select(film.c.prefix_spp).where(film.c.id == job.c.film_id).scalar_subquery()
    fresh = dict.fromkeys(forgotten) | {
        "state": QUEUED,
        "cached": False,
        "attempt": job.c.attempt + 1,
        "queued": now,
        "rank": job.c.priority * AGEING_S - now,
        "prefix_spp_at_submit": merged,
        "deadline": sa.case((job.c.deadline > now, job.c.deadline), else_=None),
    }
    c.execute(sa.update(job).where(mine, job.c.state.in_(REQUEUED)).values(fresh))
    jobs.reopen_if_failed(c, sa.select(job.c.film_id).where(mine))
    for row in rows:
        emit(c, "queued", row.id, row.sweep_id, attempt=row.attempt + 1, previous=row.state)


def _block_again(c: Connection, job_id: str) -> None:
    waiter = _row(c, job_id).sweep_id or job_id
    if (needed := dependencies.first_broken(c, waiter)) is not None:
        raise IllegalTransition(dependencies.failure(needed).message)
    left = dependencies.count_open(c, waiter)
    c.execute(sa.update(job).where(job.c.id == job_id).values(blockers=left))
    c.execute(sa.update(sweep).where(sweep.c.id == waiter).values(blockers=left))


# -- priority ---------------------------------------------------------------------------------
def set_priority(c: Connection, job_id: str, priority: int) -> bool:
    """Change the priority of a live job; what it has waited still counts. False if it ended."""
    row = _row(c, job_id)
    if JobState(row.state).final:
        return False
    values = {"priority": priority, "rank": queue_rank(priority, row.queued)}
    c.execute(sa.update(job).where(job.c.id == job_id).values(values))
    if priority != row.priority:
        emit(c, "priority", job_id, row.sweep_id, priority=priority, before=row.priority)
    return True


def set_sweep_priority(c: Connection, sweep_id: str, priority: int) -> int:
    """Change the priority of the live cells; return how many."""
    mine = (job.c.sweep_id == sweep_id) & job.c.state.in_([*ACTIVE, PAUSED])
    rank = priority * AGEING_S - job.c.queued
    found = c.execute(sa.update(job).where(mine).values(priority=priority, rank=rank)).rowcount
    c.execute(sa.update(sweep).where(sweep.c.id == sweep_id).values(priority=priority))
    emit(c, "sweep_priority", sweep_id=sweep_id, priority=priority, cells=found)
    return int(found)


# -- deadlines --------------------------------------------------------------------------------
def due(c: Connection, now: float) -> list[tuple[str, int]]:
    """Return (job, film) of live jobs whose deadline has passed and that still want samples."""
    late = (job.c.deadline <= now) & job.c.state.in_([*ACTIVE, PAUSED]) & job.c.ended_spp.is_(None)
    rows = c.execute(sa.select(job.c.id, job.c.film_id).where(late).order_by(job.c.id))
    return [(row.id, row.film_id) for row in rows]


def expire_job(c: Connection, job_id: str) -> bool:
    """End a job whose deadline has passed: with the samples merged so far, if there are any.

    Its images are still made then. An adaptive film can be shown only between its rounds: false,
    and the job is left to `merge`, paused or not.
    """
    row = _row(c, job_id)
    if JobState(row.state).final or row.ended_spp is not None:
        return True
    made = c.execute(sa.select(film).where(film.c.id == row.film_id)).one()
    prefix = find_reference(c, ("film", row.film_id), "prefix")
    if prefix is None or row.blockers:
        why = "the deadline passed before the first samples were complete"
        jobs.set_state(c, job_id, JobState.EXPIRED, JobError(DEADLINE, why, "/deadline"))
        return True
    if row.state == PAUSED:
        jobs.set_state(c, job_id, JobState.QUEUED, resumed=True)
    if made.scene and is_adaptive(json.loads(made.scene)):
        return False
    facts = {"spp": made.prefix_spp, "seconds": made.seconds, "relmse": made.relmse,
             "lower": made.relmse_lower, "upper": made.relmse_upper, "reason": DEADLINE,
             "cached": False}  # fmt: skip
    jobs.end_job(c, job_id, facts, prefix, made.prefix_record)
    return True


def _row(c: Connection, job_id: str) -> Any:
    row = c.execute(sa.select(job).where(job.c.id == job_id)).first()
    if row is None:
        raise JobNotFound(f"no job {job_id}")
    return row
