"""Small films in the database: claimed whole, many to an attempt, and stored many to a file."""

from __future__ import annotations

import json
import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from matiere.jobs.job import AGEING_S, JobError, JobState, JsonDict
from matiere.jobs.store import dependencies
from matiere.jobs.store.events import emit_all
from matiere.jobs.store.files import Blob, discard, drop_reference, set_references
from matiere.jobs.store.films import WaitingJob, waiting_by_film
from matiere.jobs.store.jobs import ACTIVE, WANTING, end_job
from matiere.jobs.store.tables import attempt, dependency, film, instance, job, reference


@dataclass(frozen=True)
class SmallFilm:
    """A film that one child renders whole, and the jobs that wait for it."""

    id: int
    film_key: str
    geometry_key: str
    plan: str  # artifact of the sweep it came with
    cell: int
    assets: JsonDict
    width: int
    height: int
    replicates: int
    prefix: str | None  # digest of the file that holds what is rendered already
    record: int  # its place there
    prefix_spp: int
    jobs: tuple[WaitingJob, ...]

    @property
    def samples(self) -> int:
        """Samples that are still to be rendered."""
        spp = max(waiting.spp_cap for waiting in self.jobs) - self.prefix_spp
        return self.width * self.height * spp

    @property
    def rank(self) -> tuple[int, str]:
        """Sort key: the most urgent first, then the oldest."""
        return -int(max(waiting.rank for waiting in self.jobs) // AGEING_S), self.jobs[0].id


@dataclass(frozen=True)
class BatchReport:
    """What a child made of a claim of small films: facts by film as `BatchRenderer` gives them."""

    token: int
    blob: Blob | None
    films: Sequence[Mapping[str, Any]]
    samples: Mapping[int, int]  # by film
    printed: str = ""  # by the child meanwhile


def waiting_films(c: Connection, limit: int) -> list[SmallFilm]:
    """Return small films that nobody renders and jobs wait for, most urgent first."""
    wanting = (job.c.ended_spp.is_(None), job.c.blockers == 0)
    found = [
        row
        for state in ACTIVE  # each along the index of the queue
        for row in c.execute(
            sa.select(job.c.rank, job.c.id, job.c.film_id)
            .join(film)
            .where(job.c.state == state, *wanting, film.c.whole, film.c.claim_token.is_(None))
            .order_by(job.c.rank.desc(), job.c.id)
            .limit(limit)
        )
    ]
    found.sort(key=lambda row: (-row.rank, row.id))
    ids = list(dict.fromkeys(row.film_id for row in found))[:limit]
    waiting = waiting_by_film(c, ids)
    prefixes = {
        int(owner): digest
        for owner, digest in c.execute(
            sa.select(reference.c.owner_id, reference.c.digest).where(
                reference.c.owner == "film",
                reference.c.kind == "prefix",
                reference.c.owner_id.in_([str(i) for i in ids]),
            )
        )
    }
    rows = {r.id: r for r in c.execute(sa.select(film).where(film.c.id.in_(ids)))}
    return [
        SmallFilm(
            id=i,
            film_key=rows[i].film_key,
            geometry_key=rows[i].geometry_key,
            plan=rows[i].plan,
            cell=rows[i].cell,
            assets=json.loads(rows[i].assets),
            width=rows[i].width,
            height=rows[i].height,
            replicates=rows[i].replicates,
            prefix=prefixes.get(i),
            record=rows[i].prefix_record,
            prefix_spp=rows[i].prefix_spp,
            jobs=tuple(waiting[i]),
        )
        for i in ids
        if waiting[i]
    ]


def claim_films(
    c: Connection, film_ids: Sequence[int], instance_id: str, child: int, lease_s: float
) -> tuple[int, set[int]] | None:
    """Give films to a child: the token and those that were still to be had, or None."""
    if c.scalar(sa.select(instance.c.ended).where(instance.c.id == instance_id)):
        return None  # another process schedules by now
    wanted = sa.exists().where(job.c.film_id == film.c.id, WANTING)
    free = (
        sa.select(film.c.id)
        .where(film.c.id.in_(film_ids), film.c.claim_token.is_(None), film.c.whole, wanted)
        .order_by(film.c.id)
    )
    got = set(c.execute(free).scalars())
    if not got:
        return None
    now = time.time()
    row = {"instance_id": instance_id, "child": child, "chunks": len(got), "state": "running",
           "created": now, "lease_until": now + lease_s}  # fmt: skip
    token = int(c.execute(sa.insert(attempt).values(row).returning(attempt.c.id)).scalar_one())
    c.execute(sa.update(film).where(film.c.id.in_(got)).values(claim_token=token))
    mine = job.c.film_id.in_(got) & WANTING & (job.c.state == JobState.QUEUED.value)
    begun = sa.update(job).where(mine).values(state=JobState.RUNNING.value, started=now)
    rows = c.execute(begun.returning(job.c.id, job.c.sweep_id)).all()
    emit_all(c, "running", [(r.id, r.sweep_id, {}) for r in rows])
    return token, got


def any_wanted(c: Connection, token: int) -> bool:
    """Tell whether a job waits for any film of a claim."""
    mine = sa.select(film.c.id).where(film.c.claim_token == token)
    return (
        c.scalar(sa.select(job.c.id).where(job.c.film_id.in_(mine), WANTING).limit(1)) is not None
    )


def complete_films(c: Connection, report: BatchReport) -> bool:
    """Store what was rendered and end the jobs that it satisfies; false if the claim was void."""
    now = time.time()
    values: JsonDict = {"state": "merged", "ended": now, "log_tail": report.printed or None}
    if report.blob is not None:
        values["digest"] = report.blob.digest
    mine = (attempt.c.id == report.token) & (attempt.c.state == "running")
    if c.execute(sa.update(attempt).where(mine).values(values)).rowcount == 0:
        discard(c, [report.blob] if report.blob else [])
        return False
    held = set(c.execute(sa.select(film.c.id).where(film.c.claim_token == report.token)).scalars())
    made = [f for f in report.films if f["id"] in held]
    if made:
        assert report.blob is not None
        _store_films(c, report, made)
        _end_jobs(c, [ended | {"record": f["record"]} for f in made for ended in f["ended"]],
                  report.blob, now)  # fmt: skip
    free(c, report.token)
    return True


def _store_films(c: Connection, report: BatchReport, made: Sequence[Mapping[str, Any]]) -> None:
    assert report.blob is not None
    rows = [
        {
            "film_id": f["id"],
            "chunks": f["chunks"],
            "spp": f["spp"],
            "record": f["record"],
            "error": f["relmse"],
            "lower": f["lower"],
            "upper": f["upper"],
            "more_samples": report.samples[f["id"]],
            "more_s": f["rendered_s"],
            "more_chunks": f["rendered_chunks"],
        }
        for f in made
    ]
    c.execute(
        sa.update(film)
        .where(film.c.id == sa.bindparam("film_id"))
        .values(
            prefix_chunks=sa.bindparam("chunks"),
            prefix_spp=sa.bindparam("spp"),
            prefix_record=sa.bindparam("record"),
            relmse=sa.bindparam("error"),
            relmse_lower=sa.bindparam("lower"),
            relmse_upper=sa.bindparam("upper"),
            pixel_samples=film.c.pixel_samples + sa.bindparam("more_samples"),
            seconds=film.c.seconds + sa.bindparam("more_s"),
            chunks_rendered=film.c.chunks_rendered + sa.bindparam("more_chunks"),
            tries=0,
            losses=0,
        ),
        rows,
    )
    set_references(c, "film", "prefix", [(f["id"], report.blob) for f in made])


def _end_jobs(c: Connection, ended: Sequence[Mapping[str, Any]], blob: Blob, now: float) -> None:
    """End jobs by what `settle` says of them: cells at once, others once they have images."""
    by_id = {e["job_id"]: e for e in ended}
    mine = job.c.id.in_(list(by_id)) & WANTING
    live = c.execute(sa.select(job.c.id, job.c.sweep_id).where(mine)).all()
    cells = [r for r in live if r.sweep_id is not None]
    for r in live:
        if r.sweep_id is None:
            end_job(c, r.id, {"cached": False, **by_id[r.id]}, blob, by_id[r.id]["record"])
    end_cells(c, [(r.id, r.sweep_id, {**by_id[r.id], "cached": False}) for r in cells], now)
    set_references(c, "job", "film", [(r.id, blob) for r in cells])


def end_cells(
    c: Connection, cells: Sequence[tuple[str, str, Mapping[str, Any]]], now: float
) -> None:
    """End jobs (id, sweep, facts) as succeeded; their images are made when somebody asks."""
    if not cells:
        return
    rows = [
        {
            "job_id": job_id,
            "spp": f["spp"],
            "s": f["seconds"],
            "error": f["relmse"],
            "lower": f["lower"],
            "upper": f["upper"],
            "reason": f["reason"],
            "record": f["record"],
            "known": f["cached"],
        }
        for job_id, _, f in cells
    ]
    c.execute(
        sa.update(job)
        .where(job.c.id == sa.bindparam("job_id"))
        .values(
            state=JobState.SUCCEEDED.value,
            finished=now,
            ended_spp=sa.bindparam("spp"),
            ended_seconds=sa.bindparam("s"),
            ended_relmse=sa.bindparam("error"),
            ended_relmse_lower=sa.bindparam("lower"),
            ended_relmse_upper=sa.bindparam("upper"),
            stop_reason=sa.bindparam("reason"),
            film_record=sa.bindparam("record"),
            cached=sa.bindparam("known"),
        ),
        rows,
    )
    emit_all(c, "succeeded", [(job_id, sweep_id, {}) for job_id, sweep_id, _ in cells])
    ids = [job_id for job_id, _, _ in cells]
    waited_for = sa.select(dependency.c.needs).where(dependency.c.needs.in_(ids)).distinct()
    for job_id in list(c.execute(waited_for).scalars()):
        dependencies.settle(c, job_id, True)


def free(c: Connection, token: int) -> None:
    """Let others claim the films of an attempt."""
    c.execute(sa.update(film).where(film.c.claim_token == token).values(claim_token=None))


def give_back_films(
    c: Connection, token: int, state: str, error: JobError | None, guilty: Collection[int]
) -> list[int]:
    """End a claim without a result; return the guilty films that are held by it.

    `state` is failed or lost (counted for the guilty), cancelled or void (counted for none).
    """
    values: JsonDict = {"state": state, "ended": time.time()}
    if error is not None:
        values |= {"error_class": error.code, "error_message": error.message}
        values["log_tail"] = error.log_tail or None
    mine = (attempt.c.id == token) & (attempt.c.state == "running")
    if c.execute(sa.update(attempt).where(mine).values(values)).rowcount == 0:
        return []
    held = (film.c.claim_token == token) & film.c.id.in_(list(guilty))
    found = list(c.execute(sa.select(film.c.id).where(held)).scalars())
    blame(c, found, state)
    free(c, token)
    return found


def blame(c: Connection, film_ids: Iterable[int], state: str) -> None:
    """Count a crash (failed) or a kill from outside (lost) against films."""
    column = {"failed": film.c.tries, "lost": film.c.losses}.get(state)
    if column is not None:
        mine = film.c.id.in_(list(film_ids))
        c.execute(sa.update(film).where(mine).values({column.name: column + 1}))


def counted(c: Connection, film_id: int) -> tuple[int, int]:
    """Return the crashes and the kills counted against a film."""
    row = c.execute(sa.select(film.c.tries, film.c.losses).where(film.c.id == film_id)).one()
    return int(row.tries), int(row.losses)


def forget_prefix(c: Connection, digest: str) -> None:
    """Forget a damaged file of films: what it held is rendered again."""
    held = sa.select(reference.c.owner_id).where(
        reference.c.owner == "film", reference.c.kind == "prefix", reference.c.digest == digest
    )
    for film_id in [int(i) for i in c.execute(held).scalars()]:
        drop_reference(c, ("film", film_id), "prefix")
        fresh = {"prefix_chunks": 0, "prefix_spp": 0, "prefix_record": 0, "pixel_samples": 0,
                 "seconds": 0.0}  # fmt: skip
        c.execute(sa.update(film).where(film.c.id == film_id).values(fresh))
