"""What was done for a job: the claims of its film while it lived, and what became of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from matiere.jobs.errors import JobNotFound
from matiere.jobs.store.tables import attempt, film, job, reference


@dataclass(frozen=True)
class Attempt:
    """A claim: what a child process was asked to render of a film, and what came of it."""

    token: int  # rises with every claim, never used twice
    state: str  # running | done | merged | failed | lost | void | cancelled
    films: int  # 1, or how many small films of sweeps were rendered together
    chunks: int  # of the film; 0 for small films, rendered whole
    pid: int
    instance_id: str  # of the service that gave it out
    started: float  # Unix seconds
    ended: float | None
    seconds: float | None  # of rendering, as stop rules count them
    error_class: str | None
    message: str | None
    printed: str  # the end of what the process printed meanwhile


def attempts(
    c: Connection, job_id: str, *, after: int = 0, limit: int = 100, newest: bool = False
) -> list[Attempt]:
    """Return claims of a job's film with tokens above `after`, in order; or the `newest` ones.

    Claims that ended before the job came are left out, as are those given out after its end. Raises
    JobNotFound.
    """
    about = c.execute(sa.select(job, film.c.claim_token).join(film).where(job.c.id == job_id))
    row = about.first()
    if row is None:
        raise JobNotFound(f"no job {job_id}")
    meanwhile = (attempt.c.ended.is_(None) | (attempt.c.ended >= row.created)) & (
        attempt.c.id > after
    )
    if row.finished is not None:
        meanwhile &= attempt.c.created <= row.finished
    order = attempt.c.id.desc() if newest else attempt.c.id
    rows = sa.select(attempt).where(_of(c, row), meanwhile).order_by(order).limit(limit)
    found = [_attempt(r) for r in c.execute(rows)]
    return found[::-1] if newest else found


def _of(c: Connection, row: Any) -> sa.ColumnElement[bool]:
    """Pick the claims of a job's film: by its number, or by the file that many were stored in."""
    kept = (reference.c.owner == "film") & (reference.c.owner_id == str(row.film_id))
    kept |= (reference.c.owner == "job") & (reference.c.owner_id == row.id)
    digests = sa.select(reference.c.digest).where(kept, reference.c.kind.in_(("prefix", "film")))
    shared = attempt.c.film_id.is_(None) & (
        attempt.c.digest.in_(list(c.execute(digests).scalars())) | (attempt.c.id == row.claim_token)
    )
    return sa.or_(attempt.c.film_id == row.film_id, shared)


def _attempt(r: Any) -> Attempt:
    together = r.film_id is None
    return Attempt(
        token=r.id,
        state=r.state,
        films=r.chunks if together else 1,
        chunks=0 if together else r.chunks,
        pid=r.child,
        instance_id=r.instance_id,
        started=r.created,
        ended=r.ended,
        seconds=r.seconds,
        error_class=r.error_class,
        message=r.error_message,
        printed=r.log_tail or "",
    )
