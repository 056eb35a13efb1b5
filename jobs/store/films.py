"""Films in the database: claim chunks, complete or give them back, merge, start again.

A claim makes an `attempt` row, whose id is the fencing token, and marks its chunks. Only the
attempt that still holds a chunk can complete it; anything later is a superseded report.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from matiere.jobs.course import is_adaptive
from matiere.jobs.job import JsonDict
from matiere.jobs.store import budgets
from matiere.jobs.store.events import emit
from matiere.jobs.store.files import Blob, add_reference, discard, drop_attempts, drop_reference
from matiere.jobs.store.jobs import ACTIVE, LIVE, WANTING, end_job, start_jobs
from matiere.jobs.store.tables import attempt, chunk, film, instance, job, sweep

MISSING, CLAIMED, DONE = "missing", "claimed", "done"


@dataclass(frozen=True)
class WaitingJob:
    """A live job that wants more samples of its film."""

    id: str
    priority: int
    stop: JsonDict
    spp_cap: int
    prefix_spp_at_submit: int
    sweep_id: str | None
    rank: float = 0.0  # see `queue_rank`


@dataclass(frozen=True)
class FilmRow:
    """A film as stored, with the chunks beyond its prefix and the jobs that wait for it."""

    id: int
    film_key: str
    geometry_key: str
    scene: JsonDict
    assets: dict[str, str]
    width: int
    height: int
    replicates: int
    prefix: Blob | None
    prefix_record: int
    prefix_chunks: int
    prefix_spp: int
    seconds: float  # of all accepted chunks
    pixel_samples: int
    done: dict[int, int]  # chunk index -> token of the attempt that made it
    files: dict[int, Blob]  # token -> artifact
    tries: dict[int, int]
    losses: dict[int, int]
    jobs: list[WaitingJob]


@dataclass(frozen=True)
class Claim:
    """What a child was asked to render."""

    film_id: int
    chunks: Sequence[int]  # positions in the film's course
    instance_id: str
    child: int
    lease_s: float


@dataclass(frozen=True)
class Report:
    """What a child made of a claim."""

    token: int
    film_id: int
    blob: Blob
    seconds: float  # thread seconds / slots
    pixel_samples: int
    printed: str = ""  # by the child meanwhile


@dataclass(frozen=True)
class Loss:
    """How a claim ended without a result."""

    token: int
    film_id: int
    state: str  # failed | lost | cancelled | void
    error_class: str = ""
    message: str = ""
    log_tail: str = ""


@dataclass(frozen=True)
class Merged:
    """A new prefix and the jobs it ends."""

    film_id: int
    old_chunks: int  # the prefix it was made from
    new_chunks: int
    prefix: Blob | None  # None: nothing new was merged
    facts: JsonDict  # spp, seconds, relmse, lower, upper at the new prefix
    ended: Sequence[Mapping[str, Any]]  # each job_id, reason, cached and facts
    shares: Mapping[str, float]  # by job: how far it is on the way to its target error


# -- reading ----------------------------------------------------------------------------------
def next_films(c: Connection, limit: int) -> list[int]:
    """Return films that jobs wait for, most urgent first; not cells that share a budget."""
    wanting = (job.c.ended_spp.is_(None), job.c.blockers == 0)
    ordinary = (~film.c.whole, film.c.claim_token.is_(None))  # nor made so under a child's hands
    shared = sa.exists().where(sweep.c.id == job.c.sweep_id, sweep.c.budget.is_not(None))
    rows = [
        row
        for state in ACTIVE  # each along the index of the queue
        for row in c.execute(
            sa.select(job.c.rank, job.c.id, job.c.film_id)
            .join(film)
            .where(job.c.state == state, *wanting, *ordinary, ~shared)
            .order_by(job.c.rank.desc(), job.c.id)
            .limit(4 * limit)
        )
    ]
    rows.sort(key=lambda row: (-row.rank, row.id))
    return list(dict.fromkeys(row.film_id for row in rows))[:limit]


def resting(c: Connection, film_ids: Sequence[int]) -> set[int]:
    """Return those of the films that a live job will go on with: a paused or a waiting one."""
    mine = job.c.film_id.in_(film_ids) & job.c.state.in_(LIVE) & job.c.ended_spp.is_(None)
    return set(c.execute(sa.select(job.c.film_id).where(mine)).scalars())


def waiting_jobs(c: Connection, film_id: int) -> list[WaitingJob]:
    """Return the live jobs that still want samples of a film, oldest first."""
    return waiting_by_film(c, [film_id])[film_id]


def waiting_by_film(c: Connection, film_ids: Sequence[int]) -> dict[int, list[WaitingJob]]:
    """Return the live jobs that still want samples, oldest first, for each of the films."""
    found: dict[int, list[WaitingJob]] = {film_id: [] for film_id in film_ids}
    rows = c.execute(
        sa.select(
            job.c.film_id,
            job.c.id,
            job.c.priority,
            job.c.stop,
            job.c.spp_cap,
            job.c.prefix_spp_at_submit,
            job.c.sweep_id,
            job.c.rank,
        )
        .where(job.c.film_id.in_(film_ids), WANTING)
        .order_by(job.c.id)
    )
    for film_id, job_id, priority, stop, *rest in rows:
        found[film_id].append(WaitingJob(job_id, priority, json.loads(stop), *rest))
    return found


def load_film(c: Connection, film_id: int) -> FilmRow:
    """Read a film with its unmerged chunks and waiting jobs."""
    from matiere.jobs.store.files import find_reference
    from matiere.jobs.store.tables import artifact

    r = c.execute(sa.select(film).where(film.c.id == film_id)).one()
    chunks = c.execute(sa.select(chunk).where(chunk.c.film_id == film_id)).all()
    done = {k.idx: k.token for k in chunks if k.state == DONE}
    files = c.execute(
        sa.select(attempt.c.id, artifact.c.digest, artifact.c.size)
        .join(artifact, artifact.c.digest == attempt.c.digest)
        .where(attempt.c.film_id == film_id, attempt.c.state == "done")
    )
    return FilmRow(
        id=r.id,
        film_key=r.film_key,
        geometry_key=r.geometry_key,
        scene=json.loads(r.scene),
        assets=json.loads(r.assets),
        width=r.width,
        height=r.height,
        replicates=r.replicates,
        prefix=find_reference(c, ("film", film_id), "prefix"),
        prefix_record=r.prefix_record,
        prefix_chunks=r.prefix_chunks,
        prefix_spp=r.prefix_spp,
        seconds=r.seconds,
        pixel_samples=r.pixel_samples,
        done=done,
        files={token: Blob(digest, size) for token, digest, size in files},
        tries={k.idx: k.tries for k in chunks if k.tries},
        losses={k.idx: k.losses for k in chunks if k.losses},
        jobs=waiting_jobs(c, film_id),
    )


# -- claims -----------------------------------------------------------------------------------
def claim(c: Connection, wanted: Claim) -> int | None:
    """Give chunks to a child and return the token; None if one is taken or nobody waits."""
    if not waiting_jobs(c, wanted.film_id):
        return None
    mine = (chunk.c.film_id == wanted.film_id) & chunk.c.idx.in_(list(wanted.chunks))
    known = c.execute(sa.select(chunk.c.idx, chunk.c.state).where(mine)).all()
    merged = c.scalar(sa.select(film.c.prefix_chunks).where(film.c.id == wanted.film_id)) or 0
    if any(k.state != MISSING for k in known) or min(wanted.chunks) < merged:
        return None
    if c.scalar(sa.select(instance.c.ended).where(instance.c.id == wanted.instance_id)):
        return None  # another process schedules by now
    now = time.time()
    token = c.execute(
        sa.insert(attempt)
        .values(
            film_id=wanted.film_id,
            instance_id=wanted.instance_id,
            child=wanted.child,
            chunks=len(wanted.chunks),
            state="running",
            created=now,
            lease_until=now + wanted.lease_s,
        )
        .returning(attempt.c.id)
    ).scalar_one()
    c.execute(sa.update(chunk).where(mine).values(state=CLAIMED, token=token))
    fresh = set(wanted.chunks) - {k.idx for k in known}
    if fresh:
        row = {"film_id": wanted.film_id, "state": CLAIMED, "token": token}
        row |= {"tries": 0, "losses": 0}
        c.execute(sa.insert(chunk), [row | {"idx": i} for i in sorted(fresh)])
    start_jobs(c, wanted.film_id)
    return int(token)


def complete(c: Connection, report: Report) -> bool:
    """Accept a claim's artifact; false (and counted) if the attempt no longer holds its chunks."""
    held = c.execute(
        sa.update(attempt)
        .where(attempt.c.id == report.token, attempt.c.state == "running")
        .values(
            state="done",
            digest=report.blob.digest,
            seconds=report.seconds,
            log_tail=report.printed or None,
            ended=time.time(),
        )
    )
    mine = (chunk.c.film_id == report.film_id) & (chunk.c.token == report.token)
    if held.rowcount == 0:
        c.execute(
            sa.update(film)
            .where(film.c.id == report.film_id)
            .values(reports_superseded=film.c.reports_superseded + 1)
        )
        discard(c, [report.blob])
        return False
    accepted = c.execute(sa.update(chunk).where(mine, chunk.c.state == CLAIMED).values(state=DONE))
    add_reference(c, ("attempt", report.token), "chunks", report.blob)
    c.execute(
        sa.update(film)
        .where(film.c.id == report.film_id)
        .values(
            pixel_samples=film.c.pixel_samples + report.pixel_samples,
            seconds=film.c.seconds + report.seconds,
            chunks_rendered=film.c.chunks_rendered + accepted.rowcount,
        )
    )
    waiting = waiting_jobs(c, report.film_id)
    for job_ in waiting:
        emit(c, "progress", job_.id, job_.sweep_id, chunks=accepted.rowcount)
    budgets.charge(c, {job_.sweep_id for job_ in waiting if job_.sweep_id}, report.seconds)
    return True


def refuse(c: Connection, token: int, blob: Blob) -> None:
    """Count the report of an attempt that was given up before; its file may go."""
    film_id = c.scalar(sa.select(attempt.c.film_id).where(attempt.c.id == token))
    if film_id is not None:
        complete(c, Report(token, int(film_id), blob, 0.0, 0))
    else:  # of a batch
        discard(c, [blob])


def give_back(c: Connection, loss: Loss) -> None:
    """End an attempt without a result; its chunks are missing again."""
    ended = c.execute(
        sa.update(attempt)
        .where(attempt.c.id == loss.token, attempt.c.state == "running")
        .values(
            state=loss.state,
            error_class=loss.error_class or None,
            error_message=loss.message or None,
            log_tail=loss.log_tail or None,
            ended=time.time(),
        )
    )
    if ended.rowcount == 0:
        return
    mine = (chunk.c.film_id == loss.film_id) & (chunk.c.token == loss.token)
    values: dict[str, Any] = {"state": MISSING}
    if loss.state == "failed":
        values["tries"] = chunk.c.tries + 1
    if loss.state == "lost":
        values["losses"] = chunk.c.losses + 1
    c.execute(sa.update(chunk).where(mine, chunk.c.state == CLAIMED).values(values))


def discard_file(c: Connection, film_id: int, token: int, pixel_samples: int) -> None:
    """Forget a damaged chunk file: what it held is missing again."""
    mine = (chunk.c.film_id == film_id) & (chunk.c.token == token)
    c.execute(sa.update(chunk).where(mine, chunk.c.state == DONE).values(state=MISSING))
    c.execute(sa.update(attempt).where(attempt.c.id == token).values(state="lost"))
    c.execute(
        sa.update(film)
        .where(film.c.id == film_id)
        .values(pixel_samples=film.c.pixel_samples - pixel_samples)
    )
    drop_reference(c, ("attempt", token))


def film_of(c: Connection, job_id: str) -> int:
    """Return the film of a job."""
    return int(c.execute(sa.select(job.c.film_id).where(job.c.id == job_id)).scalar_one())


def discard_prefix(c: Connection, film_id: int) -> None:
    """Forget a damaged prefix: the film starts again, and jobs that ended on it wait again."""
    drop_reference(c, ("film", film_id), "prefix")
    fresh = {"prefix_chunks": 0, "prefix_spp": 0, "prefix_record": 0, "pixel_samples": 0,
             "seconds": 0.0}  # fmt: skip
    c.execute(sa.update(film).where(film.c.id == film_id).values(fresh))
    done = sa.update(attempt).where(attempt.c.film_id == film_id, attempt.c.state == "done")
    drop_attempts(c, c.execute(done.values(state="lost").returning(attempt.c.id)).scalars().all())
    running = (attempt.c.film_id == film_id) & (attempt.c.state == "running")
    c.execute(sa.update(attempt).where(running).values(state="void"))
    c.execute(sa.delete(chunk).where(chunk.c.film_id == film_id))
    again = (job.c.film_id == film_id) & job.c.state.in_(LIVE) & job.c.ended_spp.is_not(None)
    for job_id in c.execute(sa.select(job.c.id).where(again)).scalars().all():
        drop_reference(c, ("job", job_id), "film")
    c.execute(sa.update(job).where(again).values(ended_spp=None, stop_reason=None))


# -- merging ----------------------------------------------------------------------------------
def commit_merge(c: Connection, merged: Merged) -> bool:
    """Make the new prefix the film's, free the chunk files inside it, end jobs."""
    current = c.scalar(sa.select(film.c.prefix_chunks).where(film.c.id == merged.film_id))
    if current != merged.old_chunks:
        return False
    if merged.prefix is not None:
        add_reference(c, ("film", merged.film_id), "prefix", merged.prefix)
        c.execute(
            sa.update(film)
            .where(film.c.id == merged.film_id)
            .values(
                prefix_chunks=merged.new_chunks,
                prefix_record=0,
                prefix_spp=merged.facts["spp"],
                relmse=merged.facts["relmse"],
                relmse_lower=merged.facts["lower"],
                relmse_upper=merged.facts["upper"],
            )
        )
        _free_chunks(c, merged)
    for job_id, share in merged.shares.items():
        c.execute(sa.update(job).where(job.c.id == job_id).values(target_share=share))
    for waiting in waiting_jobs(c, merged.film_id) if merged.prefix else []:
        told = ("spp", "seconds", "relmse", "lower", "upper")
        facts: JsonDict = {key: merged.facts[key] for key in told}
        if waiting.id in merged.shares:
            facts["target_share"] = merged.shares[waiting.id]
        emit(c, "look", waiting.id, waiting.sweep_id, **facts)
    if merged.ended:
        prefix = merged.prefix or _stored_prefix(c, merged.film_id)
        record = 0 if merged.prefix else stored_record(c, merged.film_id)
        for ended in merged.ended:
            end_job(c, ended["job_id"], ended, prefix, record)
    return True


def _stored_prefix(c: Connection, film_id: int) -> Blob:
    from matiere.jobs.store.files import find_reference

    prefix = find_reference(c, ("film", film_id), "prefix")
    assert prefix is not None
    return prefix


def merged_so_far(c: Connection, job_id: str) -> tuple[int, Blob | None]:
    """Return where the merged samples of a job's film lie: place in the file, and the file."""
    from matiere.jobs.store.files import find_reference

    mine = sa.select(film.c.id, film.c.prefix_record).join(job, job.c.film_id == film.c.id)
    row = c.execute(mine.where(job.c.id == job_id)).one()
    return row.prefix_record, find_reference(c, ("film", row.id), "prefix")


def stored_record(c: Connection, film_id: int) -> int:
    """Return the place of a film in the file of its prefix."""
    return int(c.execute(sa.select(film.c.prefix_record).where(film.c.id == film_id)).scalar_one())


def _free_chunks(c: Connection, merged: Merged) -> None:
    inside = (chunk.c.film_id == merged.film_id) & (chunk.c.idx < merged.new_chunks)
    tokens = set(c.execute(sa.select(chunk.c.token).where(inside).distinct()).scalars())
    c.execute(sa.delete(chunk).where(inside))
    beyond = set(
        c.execute(
            sa.select(chunk.c.token)
            .where(chunk.c.film_id == merged.film_id, chunk.c.token.in_(tokens))
            .distinct()
        ).scalars()
    )
    spent = tokens - beyond  # attempts whose every chunk is merged
    done = sa.update(attempt).where(attempt.c.id.in_(spent), attempt.c.state == "done")
    c.execute(done.values(state="merged"))
    drop_attempts(c, spent)


def drop_unmerged(c: Connection, film_id: int) -> None:
    """Forget chunks beyond the prefix of a film nobody waits for."""
    if resting(c, [film_id]):
        return
    done = sa.update(attempt).where(attempt.c.film_id == film_id, attempt.c.state == "done")
    tokens = c.execute(done.values(state="cancelled").returning(attempt.c.id)).scalars().all()
    drop_attempts(c, tokens)
    kept = chunk.c.state == CLAIMED  # its report may still come, or its child's death
    c.execute(sa.delete(chunk).where(chunk.c.film_id == film_id, ~kept))
    merged = sa.update(film).where(film.c.id == film_id)
    c.execute(merged.values(pixel_samples=film.c.width * film.c.height * film.c.prefix_spp))


# -- starting again ---------------------------------------------------------------------------
def void_dead(c: Connection, instance_id: str, pid: int) -> JsonDict:
    """Take over from a dead instance: its claims are void at once. Return what was found."""
    dead = c.execute(
        sa.select(attempt.c.id, attempt.c.film_id).where(attempt.c.state == "running")
    ).all()
    c.execute(sa.update(film).where(film.c.claim_token.is_not(None)).values(claim_token=None))
    voided = sum(
        c.execute(sa.select(sa.func.count()).where(chunk.c.token == token)).scalar_one()
        for token, _ in dead
    )
    for token, film_id in dead:  # of a batch film_id is null: it holds no chunks
        give_back(c, Loss(token, film_id, "void", "service_died"))
    present = c.execute(
        sa.select(sa.func.count()).select_from(chunk).where(chunk.c.state == DONE)
    ).scalar_one()
    now = time.time()
    c.execute(sa.update(instance).where(instance.c.ended.is_(None)).values(ended=now))
    c.execute(
        sa.insert(instance).values(
            id=instance_id, pid=pid, started=now, chunks_present=present, chunks_voided=voided
        )
    )
    return {"claims_voided": len(dead), "chunks_voided": voided, "chunks_present": present}


def begun_films(c: Connection) -> list[tuple[tuple[int, int, int, bool], int, int, int]]:
    """Return ((width, height, replicates, adaptive), largest cap, merged, done) of films begun.

    Merged and done count chunks; films that no chunk was rendered of are left out.
    """
    cap = sa.func.max(job.c.spp_cap)
    done = (
        sa.select(sa.func.count())
        .where(chunk.c.film_id == film.c.id, chunk.c.state == DONE)
        .scalar_subquery()
    )
    rows = c.execute(
        sa.select(film, cap.label("cap"), done.label("done"))
        .join(job, job.c.film_id == film.c.id)
        .where(WANTING, film.c.pixel_samples > 0, ~film.c.whole)
        .group_by(film.c.id)
    )
    return [
        (
            (r.width, r.height, r.replicates, is_adaptive(json.loads(r.scene))),
            r.cap,
            r.prefix_chunks,
            r.done,
        )
        for r in rows
    ]


def end_instance(c: Connection, instance_id: str) -> None:
    """Record that this instance closed in order."""
    c.execute(sa.update(instance).where(instance.c.id == instance_id).values(ended=time.time()))
