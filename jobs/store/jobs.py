"""Jobs and sweeps in the database: submit, change state, end. The only writer of `job.state`."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection
from uuid6 import uuid7

from matiere.jobs.errors import IdempotencyConflict, JobNotFound
from matiere.jobs.job import (
    ACTIVE_STATES,
    LIVE_STATES,
    RENDERED_STATES,
    JobError,
    JobState,
    JsonDict,
    check_transition,
    queue_rank,
)
from matiere.jobs.store import dependencies
from matiere.jobs.store.events import emit
from matiere.jobs.store.files import (
    Blob,
    add_reference,
    add_references,
    discard,
    drop_reference,
)
from matiere.jobs.store.tables import film, idempotency, job, reference, sweep

LIVE = [state.value for state in LIVE_STATES]
ACTIVE = [state.value for state in ACTIVE_STATES]
# Jobs that samples may be rendered for now: not paused, waiting for no other, not complete.
WANTING = job.c.state.in_(ACTIVE) & job.c.ended_spp.is_(None) & (job.c.blockers == 0)

_CUT_SHORT = {"deadline": JobState.EXPIRED, "budget": JobState.UNFINISHED}  # by stop reason
_ENDED = (
    "ended_spp",
    "ended_seconds",
    "ended_relmse",
    "ended_relmse_lower",
    "ended_relmse_upper",
    "stop_reason",
    "film_record",
)


@dataclass(frozen=True)
class FilmSpec:
    """What identifies and makes a film."""

    film_key: str
    geometry_key: str
    scene: JsonDict
    assets: dict[str, str]
    width: int
    height: int
    replicates: int


@dataclass(frozen=True)
class JobSpec:
    """A validated request."""

    film: FilmSpec
    stop: JsonDict
    spp_cap: int
    output: JsonDict
    priority: int
    label: str
    sweep_id: str | None = None
    cell: int | None = None
    parameters: JsonDict = field(default_factory=dict)
    deadline: float | None = None  # Unix seconds
    after: tuple[str, ...] = ()  # jobs and sweeps that must succeed first; a sweep's count for all


@dataclass(frozen=True)
class SweepSpec:
    """A validated sweep; jobs are made of its cells by `store.cells`."""

    label: str
    mode: str
    axes: list[JsonDict]
    base: JsonDict
    columns: int
    cells: int
    priority: int
    plan: Blob  # the artifact that all cells follow from
    request: JsonDict  # stop, root, pins and deadline of its cells
    after: tuple[str, ...] = ()
    baseline: int | None = None
    budget: JsonDict | None = None


@dataclass(frozen=True)
class Key:
    """An idempotency key with the hash of the request it came with."""

    key: str
    body_hash: str


def dumps(value: Any) -> str:
    """Return compact JSON text; NaN and infinity are refused."""
    return json.dumps(value, allow_nan=False, separators=(",", ":"))


# -- submission -------------------------------------------------------------------------------
def submit_job(c: Connection, spec: JobSpec, key: Key | None = None) -> str:
    """Insert a job (and its film, if new) and return the id; a known key returns its job."""
    if key is not None and (known := replayed(c, key, "job")):
        return known
    dependencies.check(c, spec.after)
    job_id = insert_job(c, spec)
    dependencies.cancel_if_broken(c, job_id)
    if key is not None:
        _remember(c, key, "job", job_id)
    return job_id


def insert_sweep(c: Connection, spec: SweepSpec, key: Key | None = None) -> tuple[str, bool]:
    """Insert a sweep without jobs; return its id, and whether the key knew it already."""
    if key is not None and (known := replayed(c, key, "sweep")):
        return known, True
    sweep_id = str(uuid7())
    dependencies.check(c, spec.after)
    blockers = dependencies.add(c, sweep_id, spec.after)
    c.execute(
        sa.insert(sweep).values(
            id=sweep_id,
            label=spec.label,
            mode=spec.mode,
            axes=dumps(spec.axes),
            base=dumps(spec.base),
            cells=spec.cells,
            columns=spec.columns,
            baseline=spec.baseline,
            budget=dumps(spec.budget) if spec.budget else None,
            priority=spec.priority,
            request=dumps(spec.request | {"plan": spec.plan.digest}),
            created=time.time(),
            blockers=blockers,
        )
    )
    add_reference(c, ("sweep", sweep_id), "plan", spec.plan)
    emit(c, "sweep_queued", sweep_id=sweep_id, cells=spec.cells)
    if key is not None:
        _remember(c, key, "sweep", sweep_id)
    return sweep_id, False


def replayed(c: Connection, key: Key, kind: str) -> str | None:
    """Return what was made for this key before; raise IdempotencyConflict for another request."""
    row = c.execute(sa.select(idempotency).where(idempotency.c.key == key.key)).first()
    if row is None:
        return None
    if row.body_hash != key.body_hash or row.kind != kind:
        raise IdempotencyConflict(f"Idempotency-Key {key.key!r} was used for another request")
    return str(row.target_id)


def _remember(c: Connection, key: Key, kind: str, target_id: str) -> None:
    c.execute(
        sa.insert(idempotency).values(
            key=key.key,
            body_hash=key.body_hash,
            kind=kind,
            target_id=target_id,
            created=time.time(),
        )
    )


def _find_or_add_film(c: Connection, spec: FilmSpec) -> tuple[int, int]:
    wanted = sa.select(film.c.id, film.c.prefix_spp, film.c.state, film.c.whole)
    row = c.execute(wanted.where(film.c.film_key == spec.film_key)).first()
    if row is not None:
        c.execute(sa.update(film).where(film.c.id == row.id).values(used=time.time()))
        if row.state == "failed":  # asked for again: the attempts start over
            reopen_film(c, row.id)
        if row.whole:
            make_ordinary(c, row.id, spec)
        return row.id, row.prefix_spp
    result = c.execute(
        sa.insert(film)
        .values(
            film_key=spec.film_key,
            geometry_key=spec.geometry_key,
            scene=dumps(spec.scene),
            assets=dumps(spec.assets),
            width=spec.width,
            height=spec.height,
            replicates=spec.replicates,
            state="open",
            created=time.time(),
            used=time.time(),
        )
        .returning(film.c.id)
    )
    return int(result.scalar_one()), 0


def reopen_film(c: Connection, film_id: int) -> None:
    """Let a failed film be tried again."""
    from matiere.jobs.store.tables import chunk

    fresh = {"state": "open", "tries": 0, "losses": 0}
    c.execute(sa.update(film).where(film.c.id == film_id).values(fresh))
    c.execute(sa.update(chunk).where(chunk.c.film_id == film_id).values(tries=0, losses=0))


def reopen_if_failed(c: Connection, film_ids: Any) -> None:
    """Let those of the films that failed be tried again."""
    failed = sa.select(film.c.id).where(film.c.id.in_(film_ids), film.c.state == "failed")
    for film_id in c.execute(failed).scalars().all():
        reopen_film(c, film_id)


def make_ordinary(c: Connection, film_id: int, spec: FilmSpec) -> None:
    """Let a small film of a sweep be rendered chunk by chunk, as a job beside the sweep may want.

    A child that holds it whole ends first.
    """
    values = {"whole": False, "scene": dumps(spec.scene), "assets": dumps(spec.assets)}
    c.execute(sa.update(film).where(film.c.id == film_id).values(values))


def insert_job(
    c: Connection,
    spec: JobSpec,
    sweep_id: str | None = None,
    blockers: int = 0,
    queued: float | None = None,
) -> str:
    """Insert a job, and its film if it is new, within a transaction; return its id.

    A cell has waited as long as its sweep, since `queued`.
    """
    film_id, prefix_spp = _find_or_add_film(c, spec.film)
    job_id, now = str(uuid7()), time.time()
    if sweep_id is None:
        blockers = dependencies.add(c, job_id, spec.after)
    cached = prefix_spp >= spec.spp_cap
    c.execute(
        sa.insert(job).values(
            id=job_id,
            film_id=film_id,
            sweep_id=sweep_id,
            cell=spec.cell,
            parameters=dumps(spec.parameters),
            state=JobState.QUEUED.value,
            priority=spec.priority,
            stop=dumps(spec.stop),
            spp_cap=spec.spp_cap,
            output=dumps(spec.output),
            label=spec.label,
            cached=cached,
            prefix_spp_at_submit=prefix_spp,
            created=now,
            queued=queued or now,
            rank=queue_rank(spec.priority, queued or now),
            deadline=spec.deadline,
            blockers=blockers,
        )
    )
    emit(c, "queued", job_id=job_id, sweep_id=sweep_id, cached=cached)
    if blockers == 0:
        copy_results(c, job_id, film_id)
    return job_id


def copy_results(c: Connection, job_id: str, film_id: int) -> None:
    """End a job at once if an earlier one had the same film, stop rule and output."""
    mine = c.execute(sa.select(job).where(job.c.id == job_id)).one()
    twin = c.execute(
        sa.select(job)
        .where(
            job.c.film_id == film_id,
            job.c.state == JobState.SUCCEEDED.value,
            job.c.output == mine.output,
            job.c.stop == mine.stop,
        )
        .order_by(job.c.id.desc())
        .limit(1)
    ).first()
    if twin is None:
        return
    c.execute(
        sa.update(job)
        .where(job.c.id == job_id)
        .values({"cached": True} | {name: getattr(twin, name) for name in _ENDED})
    )
    files = c.execute(
        sa.select(reference.c.kind, reference.c.digest).where(
            reference.c.owner == "job", reference.c.owner_id == twin.id
        )
    ).all()
    add_references(c, ("job", job_id), {kind: Blob(digest, 0) for kind, digest in files})
    set_state(c, job_id, JobState.SUCCEEDED)


# -- state ------------------------------------------------------------------------------------
def set_state(
    c: Connection,
    job_id: str,
    new: JobState,
    error: JobError | None = None,
    *,
    settling: bool = True,
    **data: Any,
) -> None:
    """Change a job's state along the table of transitions, log it, and settle who waits for it."""
    row = c.execute(
        sa.select(job.c.state, job.c.sweep_id, job.c.started).where(job.c.id == job_id)
    ).first()
    if row is None:
        raise JobNotFound(f"no job {job_id}")
    check_transition(JobState(row.state), new)
    values: dict[str, Any] = {"state": new.value}
    if new is JobState.RUNNING:
        values["started"] = row.started or time.time()
    if new.final:
        values["finished"] = time.time()
    if error is not None:
        values |= {
            "error_code": error.code,
            "error_message": error.message,
            "error_pointer": error.pointer,
            "error_log": error.log_tail,
        }
        data |= {"code": error.code, "message": error.message, "pointer": error.pointer}
    c.execute(sa.update(job).where(job.c.id == job_id).values(values))
    emit(c, new.value, job_id=job_id, sweep_id=row.sweep_id, **data)
    if new.final and settling:
        dependencies.settle(c, job_id, new in RENDERED_STATES)


def start_jobs(c: Connection, film_id: int) -> None:
    """Mark the queued jobs of a film as running."""
    queued = (job.c.film_id == film_id) & (job.c.state == JobState.QUEUED.value)
    rows = sa.select(job.c.id).where(queued, job.c.blockers == 0)
    for job_id in c.execute(rows).scalars().all():
        set_state(c, job_id, JobState.RUNNING)


def cancel_job(c: Connection, job_id: str) -> bool:
    """Cancel a live job; false if it had ended already."""
    state = c.scalar(sa.select(job.c.state).where(job.c.id == job_id))
    if state is None:
        raise JobNotFound(f"no job {job_id}")
    if JobState(state).final:
        return False
    set_state(c, job_id, JobState.CANCELLED)
    drop_reference(c, ("job", job_id))
    return True


def cancel_sweep(c: Connection, sweep_id: str) -> int:
    """Cancel the live cells of a sweep and those without jobs; return how many of the first."""
    c.execute(sa.update(sweep).where(sweep.c.id == sweep_id).values(cancelled=True))
    rows = sa.select(job.c.id).where(job.c.sweep_id == sweep_id, job.c.state.in_(LIVE))
    found = c.execute(rows).scalars().all()
    for job_id in found:
        cancel_job(c, job_id)
    return len(found)


def fail_film(c: Connection, film_id: int, error: JobError) -> list[str]:
    """Fail every job that still waits for samples of this film; return their ids."""
    rows = sa.select(job.c.id).where(job.c.film_id == film_id, WANTING)
    found = list(c.execute(rows).scalars())
    for job_id in found:
        set_state(c, job_id, JobState.FAILED, error)
    c.execute(sa.update(film).where(film.c.id == film_id).values(state="failed"))
    return found


def fail_job(c: Connection, job_id: str, error: JobError) -> None:
    """Fail one job, if it still lives."""
    state = c.scalar(sa.select(job.c.state).where(job.c.id == job_id))
    if state in ACTIVE:
        set_state(c, job_id, JobState.FAILED, error)
        drop_reference(c, ("job", job_id))


# -- ending -----------------------------------------------------------------------------------
def end_job(
    c: Connection, job_id: str, facts: Mapping[str, Any], prefix: Blob, record: int = 0
) -> None:
    """Record that a job's stop rule fired; it keeps `prefix` until its images are made.

    `record` is the film's place in that file. `facts` holds spp, seconds, relmse, lower, upper,
    reason and cached. A job that was paused a moment ago stays paused.
    """
    state = c.scalar(sa.select(job.c.state).where(job.c.id == job_id))
    if state is None or JobState(state).final:
        return
    if state == JobState.QUEUED.value:
        set_state(c, job_id, JobState.RUNNING)
    c.execute(
        sa.update(job)
        .where(job.c.id == job_id)
        .values(
            ended_spp=facts["spp"],
            ended_seconds=facts["seconds"],
            ended_relmse=facts["relmse"],
            ended_relmse_lower=facts["lower"],
            ended_relmse_upper=facts["upper"],
            stop_reason=facts["reason"],
            cached=facts["cached"],
            film_record=record,
        )
    )
    add_reference(c, ("job", job_id), "film", prefix)
    mine = sa.select(job.c.film_id).where(job.c.id == job_id).scalar_subquery()
    c.execute(sa.update(film).where(film.c.id == mine).values(used=time.time()))


def finish_job(
    c: Connection, job_id: str, files: Mapping[str, Blob], attempt: int | None = None
) -> bool:
    """Attach the images and end the job; false if it was cancelled (or requeued) meanwhile.

    It has succeeded, or expired when only its deadline ended it, or is unfinished when only the
    budget of its sweep did. `attempt` is the one that the images were made for.
    """
    row = c.execute(sa.select(job).where(job.c.id == job_id)).first()
    stale = row is None or row.state != JobState.RUNNING.value or row.ended_spp is None
    if row is None or stale or attempt not in (None, row.attempt):
        discard(c, files.values())
        return False
    add_references(c, ("job", job_id), files)
    drop_reference(c, ("job", job_id), "film")
    set_state(c, job_id, _CUT_SHORT.get(row.stop_reason, JobState.SUCCEEDED))
    return True


def finish_sweep(c: Connection, sweep_id: str, sheet: Blob | None) -> None:
    """Record that a sweep has ended, with its contact sheet if one could be made."""
    if sheet is not None:
        add_reference(c, ("sweep", sweep_id), "contact-sheet.png", sheet)
    mine = (sweep.c.id == sweep_id) & ~sweep.c.deleted
    if c.execute(sa.update(sweep).where(mine).values(finished=time.time())).rowcount == 0:
        return
    emit(c, "sweep_finished", sweep_id=sweep_id)
    dependencies.settle(c, sweep_id, dependencies.standing(c, sweep_id) == dependencies.MET)


def finished_sweeps(c: Connection) -> list[str]:
    """Return sweeps whose cells have all ended but which are not closed yet."""
    live = sa.exists().where(job.c.sweep_id == sweep.c.id, job.c.state.in_(LIVE))
    whole = (sweep.c.expanded == sweep.c.cells) | sweep.c.cancelled
    rows = sa.select(sweep.c.id).where(sweep.c.finished.is_(None), whole, ~live)
    return list(c.execute(rows).scalars())


def jobs_to_develop(c: Connection) -> list[str]:
    """Return jobs whose samples are complete and whose images are still to be made."""
    rows = (
        sa.select(job.c.id)
        .where(job.c.state == JobState.RUNNING.value, job.c.ended_spp.is_not(None))
        .order_by(job.c.rank.desc(), job.c.id)
    )
    return list(c.execute(rows).scalars())
