"""Who waits for whom: `after` of jobs and sweeps.

Only what was there before can be named, so no cycle can be made. A job counts what it still waits
for in `blockers` (a cell counts for its sweep) and is not begun before that is 0. What a job
waits for has to succeed: when it ends otherwise, all that wait for it are cancelled with the code
`dependency_failed`, in the same transaction.
"""

from __future__ import annotations

from collections.abc import Sequence

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from matiere.errors import Fault, SceneValidationError
from matiere.jobs.job import LIVE_STATES, RENDERED, JobError, JobState
from matiere.jobs.store.tables import dependency, job, sweep

MET, OPEN, BROKEN = "met", "open", "broken"
CODE = "dependency_failed"
LIVE = [state.value for state in LIVE_STATES]


def standing(c: Connection, needed: str) -> str | None:
    """Return MET, OPEN or BROKEN for a job or sweep; None if there is none of this id."""
    state = c.scalar(sa.select(job.c.state).where(job.c.id == needed))
    if state is not None:
        good = state in RENDERED
        return MET if good else BROKEN if JobState(state).final else OPEN
    row = c.execute(sa.select(sweep).where(sweep.c.id == needed, ~sweep.c.deleted)).first()
    if row is None:
        return None
    if row.finished is None:
        return OPEN
    if row.expanded < row.cells:
        return BROKEN
    bad = sa.exists().where(job.c.sweep_id == needed, job.c.state.not_in(RENDERED))
    return BROKEN if c.scalar(sa.select(bad)) else MET


def check(c: Connection, after: Sequence[str]) -> None:
    """Raise SceneValidationError for ids that no job or sweep has."""
    faults = [
        Fault(f"/after/{place}", "not_found", f"no job or sweep has the id {needed!r}")
        for place, needed in enumerate(after)
        if standing(c, needed) is None
    ]
    if faults:
        raise SceneValidationError(faults)


def add(c: Connection, waiter: str, after: Sequence[str]) -> int:
    """Record what `waiter` waits for; return how many of it are not met yet."""
    rows = [{"waiter": waiter, "needs": needed} for needed in dict.fromkeys(after)]
    if rows:
        c.execute(sa.insert(dependency), rows)
    return count_open(c, waiter)


def needs_of(c: Connection, waiter: str) -> list[str]:
    """Return what a job or sweep waits for, sorted."""
    mine = sa.select(dependency.c.needs).where(dependency.c.waiter == waiter)
    return list(c.execute(mine.order_by(dependency.c.needs)).scalars())


def needs_by_waiter(c: Connection, waiters: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return what each of `waiters` waits for; those that wait for nothing are left out."""
    rows = c.execute(
        sa.select(dependency)
        .where(dependency.c.waiter.in_(waiters))
        .order_by(dependency.c.waiter, dependency.c.needs)
    )
    found: dict[str, tuple[str, ...]] = {}
    for waiter, needed in rows:
        found[waiter] = (*found.get(waiter, ()), needed)
    return found


def count_open(c: Connection, waiter: str) -> int:
    """Return how many of the dependencies are not met."""
    return sum(standing(c, needed) != MET for needed in needs_of(c, waiter))


def first_broken(c: Connection, waiter: str) -> str | None:
    """Return a dependency that ended without success, if there is one."""
    return next((n for n in needs_of(c, waiter) if standing(c, n) == BROKEN), None)


def failure(needed: str) -> JobError:
    """Return why a job that waits for `needed` is cancelled."""
    why = f"{needed}, which this waits for, ended without success; requeue that first"
    return JobError(CODE, why, "/after")


def settle(c: Connection, ended: str, met: bool) -> None:
    """Let go, or cancel, all that wait for a job or sweep that has just ended."""
    from matiere.jobs.store import jobs
    from matiere.jobs.store.files import drop_reference

    if met:
        for waiter in _waiters(c, ended):
            _release(c, waiter)
        return
    gone = [ended]
    while gone:
        needed = gone.pop()
        for waiter in _waiters(c, needed):
            _expand_no_further(c, waiter)
            for job_id in _live(c, waiter):
                jobs.set_state(c, job_id, JobState.CANCELLED, failure(needed), settling=False)
                drop_reference(c, ("job", job_id))
                gone.append(job_id)


def cancel_if_broken(c: Connection, waiter: str) -> None:
    """Cancel what was just submitted when a job it waits for had ended without success before."""
    if (needed := first_broken(c, waiter)) is not None:
        from matiere.jobs.store import jobs

        _expand_no_further(c, waiter)
        for job_id in _live(c, waiter):
            jobs.set_state(c, job_id, JobState.CANCELLED, failure(needed))


def cancelled_by(c: Connection, ended: str) -> list[str]:
    """Return jobs that were cancelled because `ended` had not succeeded."""
    waiters = _waiters(c, ended)
    mine = job.c.id.in_(waiters) | job.c.sweep_id.in_(waiters)
    mine &= (job.c.state == JobState.CANCELLED.value) & (job.c.error_code == CODE)
    return list(c.execute(sa.select(job.c.id).where(mine)).scalars())


def _waiters(c: Connection, needed: str) -> list[str]:
    return list(
        c.execute(sa.select(dependency.c.waiter).where(dependency.c.needs == needed)).scalars()
    )


def _expand_no_further(c: Connection, waiter: str) -> None:
    c.execute(sa.update(sweep).where(sweep.c.id == waiter).values(cancelled=True))


def _live(c: Connection, waiter: str) -> list[str]:
    mine = (job.c.id == waiter) | (job.c.sweep_id == waiter)
    return list(c.execute(sa.select(job.c.id).where(mine, job.c.state.in_(LIVE))).scalars())


def _release(c: Connection, waiter: str) -> None:
    from matiere.jobs.store import jobs

    left = count_open(c, waiter)
    c.execute(sa.update(sweep).where(sweep.c.id == waiter).values(blockers=left))
    mine = (job.c.id == waiter) | (job.c.sweep_id == waiter)
    c.execute(sa.update(job).where(mine).values(blockers=left))
    row = c.execute(sa.select(job.c.film_id, job.c.state).where(job.c.id == waiter)).first()
    if row is not None and left == 0 and row.state == JobState.QUEUED.value:
        jobs.reopen_if_failed(c, [row.film_id])
        jobs.copy_results(c, waiter, row.film_id)
