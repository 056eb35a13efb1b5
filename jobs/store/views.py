"""Rows to the values of `matiere.jobs.job`, and lists of them."""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from matiere.jobs.errors import JobNotFound
from matiere.jobs.job import (
    AGEING_S,
    ARTIFACT_MEDIA_TYPES,
    IMAGES,
    LIVE_STATES,
    RENDERED,
    Job,
    JobError,
    JobState,
    JsonDict,
    Sweep,
)
from matiere.jobs.store import budgets, dependencies
from matiere.jobs.store.files import references_of
from matiere.jobs.store.tables import film, job, job_history, sweep

_FILM = [
    film.c.film_key,
    film.c.width,
    film.c.height,
    film.c.prefix_spp,
    film.c.pixel_samples,
    film.c.seconds,
    film.c.relmse,
    film.c.relmse_lower,
    film.c.relmse_upper,
]
_THERE = ~sa.exists().where(sweep.c.id == job.c.sweep_id, sweep.c.deleted)  # not hidden

NEWEST = "-created"
ENDED_ORDERS = ("finished", "-finished")  # of those that have ended
NO_SWEEP = "none"  # in place of a sweep's id: jobs that are no cells
INNER = ("film", "signature")  # files of a job that nobody fetches one by one


def get_job(c: Connection, job_id: str) -> Job:
    """Return one job. Raises JobNotFound."""
    found = _jobs(c, sa.select(job, *_FILM).join(film).where(job.c.id == job_id, _THERE))
    if not found:
        raise JobNotFound(f"no job {job_id}")
    return found[0]


def list_jobs(
    c: Connection,
    state: JobState | None,
    sweep_id: str | None,
    after: str | None,
    limit: int,
    *,
    label: str | None = None,
    order: str | None = None,
) -> list[Job]:
    """Return jobs newest first (with NO_SWEEP only single ones), or a sweep's cells in order.

    `order` is one of ORDERS. `after` is the `position` of the last one seen.
    """
    rows = sa.select(job, *_FILM).join(film).where(_THERE).limit(limit)
    if state is not None:
        rows = rows.where(job.c.state == state.value)
    if label is not None:
        rows = rows.where(job.c.label == label)
    if sweep_id == NO_SWEEP:
        rows = rows.where(job.c.sweep_id.is_(None))
    elif sweep_id is not None:
        rows = rows.where(job.c.sweep_id == sweep_id)
    if order is None and sweep_id not in (None, NO_SWEEP):
        rows = rows.order_by(job.c.cell)
        if after is not None:
            last = sa.select(job.c.cell).where(job.c.id == after).scalar_subquery()
            rows = rows.where(job.c.cell > last)
        return _jobs(c, rows)
    return _jobs(c, _in_order(rows, job, order or NEWEST, after))


def position(row: Job | Sweep, order: str | None) -> str:
    """Return where a job or sweep stands in an order, for the list to go on after it."""
    if order in ENDED_ORDERS:
        return f"{struct.pack('>d', row.finished or 0.0).hex()}_{row.id}"
    return row.id


def _in_order(
    rows: sa.Select[Any], table: sa.Table, order: str, after: str | None
) -> sa.Select[Any]:
    """Sort by when rows were made (their ids tell) or ended, and go on after a position."""
    down = order.startswith("-")
    keys: list[sa.ColumnElement[Any]] = [table.c.id]
    values: list[Any] = [after]
    if order in ENDED_ORDERS:
        rows = rows.where(table.c.finished.is_not(None))
        keys = [table.c.finished, table.c.id]
        values = _unpacked(after)
    if after is not None:
        here, there = sa.tuple_(*keys), sa.tuple_(*map(sa.literal, values))
        rows = rows.where(here < there if down else here > there)
    return rows.order_by(*(key.desc() if down else key for key in keys))


def _unpacked(after: str | None) -> list[Any]:
    """Return moment and id of a position; the begin of the list for one that is none."""
    try:
        moment, _, name = (after or "").partition("_")
        return [struct.unpack(">d", bytes.fromhex(moment))[0], name]
    except (ValueError, struct.error):
        return [0.0, ""]


def cell_of(c: Connection, sweep_id: str, cell: int) -> Job | None:
    """Return the job of a cell, or None while it has none."""
    mine = (job.c.sweep_id == sweep_id) & (job.c.cell == cell)
    found = _jobs(c, sa.select(job, *_FILM).join(film).where(mine, _THERE))
    return found[0] if found else None


def job_facts(c: Connection, job_id: str) -> JsonDict:
    """Return what making a job's images needs beyond the Job: scene, output, chunk counters.

    Instead of a scene, a small film of a sweep has the `plan` and `cell` that it follows from.
    """
    row = c.execute(
        sa.select(job.c.output, job.c.film_record, film)
        .join(film, film.c.id == job.c.film_id)
        .where(job.c.id == job_id)
    ).one()
    source = {"scene": json.loads(row.scene)} if row.scene else {"plan": row.plan, "cell": row.cell}
    return {
        **source,
        "record": row.film_record,
        "output": json.loads(row.output),
        "assets": json.loads(row.assets),
        "width": row.width,
        "height": row.height,
        "replicates": row.replicates,
        "chunks_rendered": row.chunks_rendered,
        "reports_superseded": row.reports_superseded,
    }


def get_sweep(c: Connection, sweep_id: str) -> Sweep:
    """Return one sweep with its counts. Raises JobNotFound."""
    row = c.execute(sa.select(sweep).where(sweep.c.id == sweep_id, ~sweep.c.deleted)).first()
    if row is None:
        raise JobNotFound(f"no sweep {sweep_id}")
    return _sweeps(c, [row])[0]


def list_sweeps(
    c: Connection,
    after: str | None,
    limit: int,
    *,
    label: str | None = None,
    order: str | None = None,
) -> list[Sweep]:
    """Return sweeps, newest first or in one of ORDERS, after a `position`."""
    rows = sa.select(sweep).where(~sweep.c.deleted).limit(limit)
    if label is not None:
        rows = rows.where(sweep.c.label == label)
    return _sweeps(c, c.execute(_in_order(rows, sweep, order or NEWEST, after)).all())


def job_scene(c: Connection, job_id: str) -> JsonDict | None:
    """Return the scene of a job with its stop rule's film and output; None for a cell by plan."""
    asked = sa.select(job.c.output, film.c.scene).join(film, film.c.id == job.c.film_id)
    row = c.execute(asked.where(job.c.id == job_id)).first()
    if row is None or not row.scene:
        return None
    scene: JsonDict = json.loads(row.scene)
    output = json.loads(row.output)
    return scene | ({"output": output} if output else {})


def job_output(c: Connection, job_id: str) -> JsonDict:
    """Return how a job's image is shown: view, exposure, ..."""
    output: JsonDict = json.loads(
        c.execute(sa.select(job.c.output).where(job.c.id == job_id)).scalar_one()
    )
    return output


def counts(c: Connection) -> dict[str, int]:
    """Return the number of jobs in every state."""
    rows = c.execute(sa.select(job.c.state, sa.func.count()).group_by(job.c.state)).all()
    return {s.value: 0 for s in JobState} | {r[0]: r[1] for r in rows}


def live(c: Connection) -> int:
    """Return how many jobs have not ended, the cells that are no jobs yet among them."""
    waiting = sa.select(sa.func.sum(sweep.c.cells - sweep.c.expanded)).where(~sweep.c.cancelled)
    states = [state.value for state in LIVE_STATES]
    jobs = sa.select(sa.func.count()).select_from(job).where(job.c.state.in_(states))
    return int(c.scalar(jobs) or 0) + int(c.scalar(waiting) or 0)


def _jobs(c: Connection, query: sa.Select[Any]) -> list[Job]:
    rows = c.execute(query).all()
    ids = [r.id for r in rows]
    kinds = references_of(c, "job", ids)
    waiters = dict.fromkeys(r.sweep_id or r.id for r in rows)
    needs = dependencies.needs_by_waiter(c, list(waiters))
    past = _history(c, [r.id for r in rows if r.attempt > 1])
    return [
        _job(
            r,
            _fetchable(r.state, kinds.get(r.id, [])),
            needs.get(r.sweep_id or r.id, ()),
            tuple(past.get(r.id, ())),
        )
        for r in rows
    ]


def _fetchable(state: str, kinds: Sequence[str]) -> list[str]:
    """Leave out the film; what it holds of an ended cell is developed when somebody asks."""
    made = {kind for kind in kinds if kind not in INNER}
    on_demand = "film" in kinds and state == JobState.SUCCEEDED.value
    return sorted(made | set(IMAGES)) if on_demand else sorted(made)


def _history(c: Connection, job_ids: Sequence[str]) -> dict[str, list[JsonDict]]:
    """Return how the earlier attempts of jobs ended, first to last."""
    if not job_ids:
        return {}
    rows = sa.select(job_history).where(job_history.c.job_id.in_(job_ids))
    found: dict[str, list[JsonDict]] = {}
    for r in c.execute(rows.order_by(job_history.c.job_id, job_history.c.attempt)):
        line = {key: value for key, value in r._mapping.items() if key != "job_id"}
        found.setdefault(r.job_id, []).append(line)
    return found


def _effective_priority(r: Any) -> float:
    end = r.finished or time.time()
    return float(round(r.priority + max(0.0, end - r.queued) / AGEING_S, 2))


def _job(
    r: Any, kinds: Sequence[str], after: tuple[str, ...] = (), history: tuple[JsonDict, ...] = ()
) -> Job:
    ended = r.ended_spp is not None
    relmse, lower, upper = (
        (r.ended_relmse, r.ended_relmse_lower, r.ended_relmse_upper)
        if ended
        else (r.relmse, r.relmse_lower, r.relmse_upper)
    )
    error = None
    if r.error_code is not None:
        error = JobError(r.error_code, r.error_message, r.error_pointer or "", r.error_log or "")
    stop = json.loads(r.stop)
    return Job(
        id=r.id,
        state=JobState(r.state),
        label=r.label,
        priority=r.priority,
        stop=stop,
        width=r.width,
        height=r.height,
        film_key=r.film_key,
        cached=bool(r.cached),
        created=r.created,
        started=r.started,
        finished=r.finished,
        spp=r.ended_spp if ended else min(r.prefix_spp, r.spp_cap),
        progress=_progress(r, stop),
        seconds=r.ended_seconds if ended else r.seconds,
        relmse=relmse,
        relmse_interval=None if upper is None else (lower, upper),
        stop_reason=r.stop_reason,
        error=error,
        sweep_id=r.sweep_id,
        cell=r.cell,
        parameters=json.loads(r.parameters),
        artifacts=tuple(kinds),
        effective_priority=_effective_priority(r),
        deadline=r.deadline,
        after=after,
        waiting_for=r.blockers,
        attempt=r.attempt,
        history=history,
        pinned=bool(r.pinned),
        target_seconds=_target_seconds(r),
    )


def _target_seconds(r: Any) -> float | None:
    """Return the render seconds in all at which the target error is expected, if that is known."""
    merged = r.prefix_spp * r.width * r.height
    if r.ended_spp is not None or not (r.target_share and merged and r.pixel_samples):
        return None
    return float(r.seconds * merged / r.pixel_samples / r.target_share)


def _progress(r: Any, stop: JsonDict) -> float:
    """Return the share of the way to the stop condition that is nearest."""
    if r.state in RENDERED:
        return 1.0
    if r.ended_spp is not None:
        return 0.99
    shares = [r.pixel_samples / (r.width * r.height * r.spp_cap)]
    if stop.get("seconds"):
        shares.append(r.seconds / stop["seconds"])
    if r.target_share is not None:
        shares.append(r.target_share)
    return float(min(0.99, max(shares)))


def _sweeps(c: Connection, rows: Sequence[Any]) -> list[Sweep]:
    ids = [r.id for r in rows]
    kinds = references_of(c, "sweep", ids)
    found: dict[str, dict[str, int]] = {i: {s.value: 0 for s in JobState} for i in ids}
    needs, shared = dependencies.needs_by_waiter(c, ids), budgets.views(c, rows)
    grouped = (
        sa.select(job.c.sweep_id, job.c.state, sa.func.count())
        .where(job.c.sweep_id.in_(ids))
        .group_by(job.c.sweep_id, job.c.state)
    )
    for sweep_id, state, n in c.execute(grouped):
        found[sweep_id][state] = n
    for r in rows:  # cells that have no job yet
        state = JobState.CANCELLED if r.cancelled else JobState.QUEUED
        found[r.id][state.value] += r.cells - r.expanded
    return [
        Sweep(
            id=r.id,
            label=r.label,
            mode=r.mode,
            axes=json.loads(r.axes),
            cells=r.cells,
            counts=found[r.id],
            created=r.created,
            finished=r.finished,
            columns=r.columns,
            baseline=r.baseline,
            artifacts=tuple(k for k in kinds.get(r.id, []) if k in ARTIFACT_MEDIA_TYPES),
            after=needs.get(r.id, ()),
            waiting_for=r.blockers,
            pinned=bool(r.pinned),
            budget=shared.get(r.id),
        )
        for r in rows
    ]
