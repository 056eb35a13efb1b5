"""What may go: old results, films that nobody used for long, files that nobody names.

Every removal looks again inside its own write transaction, whatever a reading found before: a job
that was submitted meanwhile keeps its film, a file that was wanted again keeps its bytes. A file is
marked `deleting` while no reference names it, unlinked, and its row dropped; the last two in one
write transaction, so that nobody can take a reference between them.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from matiere.jobs.errors import JobNotFound
from matiere.jobs.job import JobState, JsonDict
from matiere.jobs.store import films, removal
from matiere.jobs.store.files import drop_references, unknown
from matiere.jobs.store.jobs import LIVE
from matiere.jobs.store.tables import (
    artifact,
    attempt,
    chunk,
    dependency,
    event,
    film,
    idempotency,
    instance,
    job,
    job_history,
    reference,
    sweep,
)

ENDED = [state.value for state in JobState if state.final]
FILM_KINDS = ("film", "attempt")  # owners whose files are samples, not results


# -- pins -------------------------------------------------------------------------------------
def pin(c: Connection, name: str, pinned: bool) -> str:
    """Keep a job or a sweep whatever its age (or no more); return which it is."""
    hidden = sa.exists().where(sweep.c.id == job.c.sweep_id, sweep.c.deleted)
    for table, kind, there in ((job, "job", ~hidden), (sweep, "sweep", ~sweep.c.deleted)):
        mine = sa.update(table).where(table.c.id == name, there)
        if c.execute(mine.values(pinned=pinned)).rowcount:
            return kind
    raise JobNotFound(f"no job or sweep {name}")


# -- old results ------------------------------------------------------------------------------
def _old_alone(before: float) -> sa.ColumnElement[bool]:
    """Pick jobs outside sweeps that ended before a moment."""
    return (
        job.c.sweep_id.is_(None)
        & (job.c.finished < before)
        & job.c.state.in_(ENDED)
        & ~job.c.pinned
    )


def _old_whole(before: float) -> sa.ColumnElement[bool]:
    """Pick sweeps that ended before a moment; one pinned cell keeps its sweep."""
    held = job.c.pinned | job.c.state.in_(LIVE)
    kept = sa.exists().where(job.c.sweep_id == sweep.c.id, held)
    return (sweep.c.finished < before) & ~sweep.c.pinned & ~kept


def old_jobs(c: Connection, before: float, limit: int) -> list[str]:
    """Return jobs whose results are older than `before`, oldest first."""
    rows = sa.select(job.c.id).where(_old_alone(before)).order_by(job.c.finished).limit(limit)
    return list(c.execute(rows).scalars())


def old_sweeps(c: Connection, before: float, limit: int) -> list[str]:
    """Return sweeps that ended before `before`, oldest first."""
    rows = sa.select(sweep.c.id).where(_old_whole(before)).order_by(sweep.c.finished).limit(limit)
    return list(c.execute(rows).scalars())


def remove_jobs(c: Connection, names: Sequence[str], before: float) -> int:
    """Remove jobs that are still old and not pinned, with their events; return how many."""
    mine = sa.select(job.c.id).where(job.c.id.in_(names), _old_alone(before))
    return _remove_jobs(c, list(c.execute(mine).scalars()))


def remove_cells(c: Connection, sweep_id: str, before: float, limit: int) -> int:
    """Remove some cells of an old sweep, then the sweep itself; return how many rows went."""
    mine = (sweep.c.id == sweep_id) & _old_whole(before)
    if c.scalar(sa.select(sweep.c.id).where(mine)) is None:
        return 0
    cells = sa.select(job.c.id).where(job.c.sweep_id == sweep_id).limit(limit)
    if found := list(c.execute(cells).scalars()):
        return _remove_jobs(c, found)
    drop_references(c, "sweep", [sweep_id])
    c.execute(sa.delete(event).where(event.c.sweep_id == sweep_id))
    _forget_names(c, [sweep_id])
    c.execute(sa.delete(sweep).where(sweep.c.id == sweep_id))
    return 1


def _remove_jobs(c: Connection, names: Sequence[str]) -> int:
    if names:
        drop_references(c, "job", names)
        c.execute(sa.delete(event).where(event.c.job_id.in_(names)))
        c.execute(sa.delete(job_history).where(job_history.c.job_id.in_(names)))
        _forget_names(c, names)
        c.execute(sa.delete(job).where(job.c.id.in_(names)))
    return len(names)


def _forget_names(c: Connection, names: Sequence[str]) -> None:
    """Forget keys of, and dependencies on, jobs or sweeps that go: all were met or broken."""
    c.execute(sa.delete(idempotency).where(idempotency.c.target_id.in_(names)))
    either = dependency.c.waiter.in_(names) | dependency.c.needs.in_(names)
    c.execute(sa.delete(dependency).where(either))


# -- films ------------------------------------------------------------------------------------
@dataclass(frozen=True)
class ColdFilm:
    """A stored film that no live or pinned job needs."""

    id: int
    size: int
    used: float


def _idle() -> sa.ColumnElement[bool]:
    needed = job.c.state.in_(LIVE) | job.c.pinned
    in_sweep = sa.exists().where(sweep.c.id == job.c.sweep_id, sweep.c.pinned)
    return ~sa.exists().where(job.c.film_id == film.c.id, needed | in_sweep)


def film_bytes(c: Connection) -> int:
    """Return the bytes of all stored films, each file once."""
    held = sa.exists().where(
        reference.c.digest == artifact.c.digest, reference.c.owner.in_(FILM_KINDS)
    )
    return int(c.scalar(sa.select(sa.func.sum(artifact.c.size)).where(held)) or 0)


def cold_films(c: Connection, limit: int) -> list[ColdFilm]:
    """Return films that may go, the longest unused first."""
    rows = (
        sa.select(film.c.id, artifact.c.digest, artifact.c.size, film.c.used)
        .join(reference, (reference.c.owner_id == sa.cast(film.c.id, sa.String))
              & (reference.c.owner == "film") & (reference.c.kind == "prefix"))
        .join(artifact, artifact.c.digest == reference.c.digest)
        .where(_idle())
        .order_by(film.c.used, film.c.id)
        .limit(limit)
    )  # fmt: skip
    found = c.execute(rows).all()
    sharing = _films_in(c, {r.digest for r in found})
    return [ColdFilm(r.id, r.size // sharing[r.digest], r.used) for r in found]


def _films_in(c: Connection, digests: Collection[str]) -> dict[str, int]:
    """Return how many films each file holds: small ones share."""
    rows = (
        sa.select(reference.c.digest, sa.func.count())
        .where(reference.c.digest.in_(list(digests)))
        .where(reference.c.owner == "film", reference.c.kind == "prefix")
        .group_by(reference.c.digest)
    )
    return {digest: int(n) for digest, n in c.execute(rows)}


def evict_films(c: Connection, names: Sequence[int]) -> int:
    """Forget the samples of films that are still idle; return how many."""
    mine = sa.select(film.c.id).where(film.c.id.in_(names), _idle())
    found = list(c.execute(mine).scalars())
    for film_id in found:
        films.discard_prefix(c, film_id)
    cells = sa.select(job.c.id).where(job.c.film_id.in_(found), job.c.state.in_(ENDED))
    drop_references(c, "job", list(c.execute(cells).scalars()), "film")  # nothing to develop
    return len(found)


def remove_empty_films(c: Connection, limit: int) -> int:
    """Drop the rows of films that have neither jobs nor samples; return how many."""
    wanted = sa.exists().where(job.c.film_id == film.c.id)
    held = sa.exists().where(
        reference.c.owner == "film",
        reference.c.kind == "prefix",
        reference.c.owner_id == sa.cast(film.c.id, sa.String),
    )
    newest = sa.select(sa.func.max(film.c.id)).scalar_subquery()  # its number is never used again
    rows = sa.select(film.c.id).where(~wanted, ~held, film.c.id < newest).limit(limit)
    found = list(c.execute(rows).scalars())
    removal.drop_films(c, found)
    return len(found)


# -- rows of past work ----------------------------------------------------------------------------
def remove_past_work(c: Connection, before: float, limit: int) -> int:
    """Drop rows of claims and of processes that ended before a moment; return how many.

    A claim whose chunks or file are still there stays, and so does a process whose claim does; and
    the newest claim, so that no token is ever used again.
    """
    newest = sa.select(sa.func.max(attempt.c.id)).scalar_subquery()
    holds = sa.exists().where(chunk.c.token == attempt.c.id)
    named = sa.exists().where(
        reference.c.owner == "attempt", reference.c.owner_id == sa.cast(attempt.c.id, sa.String)
    )
    over = (attempt.c.ended < before) & attempt.c.state.not_in(("running", "done"))
    old = sa.select(attempt.c.id).where(over, ~holds, ~named, attempt.c.id < newest).limit(limit)
    gone = c.execute(sa.delete(attempt).where(attempt.c.id.in_(old))).rowcount
    needed = sa.exists().where(attempt.c.instance_id == instance.c.id)
    past = sa.select(instance.c.id).where(instance.c.ended < before, ~needed).limit(limit)
    rows = c.execute(sa.delete(instance).where(instance.c.id.in_(past))).rowcount
    return int(gone + rows)


# -- files ------------------------------------------------------------------------------------
def _unnamed(before: float) -> sa.ColumnElement[bool]:
    named = sa.exists().where(reference.c.digest == artifact.c.digest)
    return (artifact.c.state == "live") & (artifact.c.created < before) & ~named


def unnamed_files(c: Connection, before: float) -> tuple[int, int]:
    """Return number and bytes of the files that nobody names and that are older than `before`."""
    rows = sa.select(sa.func.count(), sa.func.sum(artifact.c.size)).where(_unnamed(before))
    count, size = c.execute(rows).one()
    return int(count), int(size or 0)


def mark_unnamed(c: Connection, before: float, limit: int) -> int:
    """Mark such files as `deleting`; return how many."""
    some = sa.select(artifact.c.digest).where(_unnamed(before)).limit(limit)
    digests = list(c.execute(some).scalars())
    mine = artifact.c.digest.in_(digests)
    return c.execute(sa.update(artifact).where(mine).values(state="deleting")).rowcount


def unlink_marked(c: Connection, remove: Callable[[Sequence[str]], None], limit: int) -> int:
    """Unlink files that are marked and still unnamed, and drop their rows; return how many."""
    named = sa.exists().where(reference.c.digest == artifact.c.digest)
    rows = sa.select(artifact.c.digest).where(artifact.c.state == "deleting", ~named).limit(limit)
    digests = list(c.execute(rows).scalars())
    if digests:
        remove(digests)
        c.execute(sa.delete(artifact).where(artifact.c.digest.in_(digests)))
    return len(digests)


def unlink_unknown(
    c: Connection, remove: Callable[[Sequence[str]], None], digests: Sequence[str]
) -> int:
    """Unlink those of the files that no row knows: their makers were killed; return how many."""
    strangers = unknown(c, digests)
    remove(strangers)
    return len(strangers)


# -- how much ---------------------------------------------------------------------------------
def usage(c: Connection) -> JsonDict:
    """Return files and bytes by what they are for, each file counted once, where first named."""
    mine = reference.c.digest == artifact.c.digest
    order = (("results", ("job", "sweep")), ("films", ("film", "job")), ("chunks", ("attempt",)))
    its_film = reference.c.kind == "film"  # what a job holds to be developed later
    cases = [
        (
            sa.exists().where(
                mine, reference.c.owner.in_(owners), ~its_film if name == "results" else sa.true()
            ),
            sa.literal(name),
        )
        for name, owners in order
    ]
    kind = sa.case(*cases, else_="unnamed").label("kind")
    rows = sa.select(kind, artifact.c.size).subquery()
    grouped = sa.select(rows.c.kind, sa.func.count(), sa.func.sum(rows.c.size)).group_by(
        rows.c.kind
    )
    found: dict[str, Any] = {
        name: {"files": 0, "bytes": 0} for name in ("results", "films", "chunks", "unnamed")
    }
    for name, count, size in c.execute(grouped):
        found[name] = {"files": count, "bytes": int(size)}
    return found


def live_digests(c: Connection) -> dict[str, int]:
    """Return digest and size of every file that somebody names."""
    named = sa.exists().where(reference.c.digest == artifact.c.digest)
    rows = sa.select(artifact.c.digest, artifact.c.size).where(named)
    return {str(row.digest): int(row.size) for row in c.execute(rows)}
