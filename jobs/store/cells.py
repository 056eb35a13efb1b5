"""Cells of sweeps in the database: jobs are made of them slice by slice, in order.

A sweep is durable as soon as its row is: it names the artifact that all its cells follow from.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection
from uuid6 import uuid7

from matiere.jobs.job import JobState, JsonDict, queue_rank
from matiere.jobs.store import dependencies
from matiere.jobs.store.batches import end_cells
from matiere.jobs.store.events import emit_all
from matiere.jobs.store.files import Blob, find_reference, set_references
from matiere.jobs.store.jobs import (
    LIVE,
    FilmSpec,
    JobSpec,
    Key,
    SweepSpec,
    dumps,
    insert_job,
    insert_sweep,
    reopen_film,
)
from matiere.jobs.store.tables import artifact, film, job, reference, sweep

Row = Mapping[str, Any]  # of `OpenSweep.facts`, or with `fault`


@dataclass(frozen=True)
class Expansion:
    """A sweep with cells that have no jobs yet."""

    sweep_id: str
    plan: str  # digest of its artifact
    root: str  # folder of its files
    priority: int
    expanded: int
    cells: int
    waiting: int  # jobs of it that have not ended


def unexpanded(c: Connection) -> list[Expansion]:
    """Return sweeps with cells that have no jobs yet, most urgent first."""
    looked_at = sweep.c.budget.is_not(None) & job.c.target_share.is_not(
        None
    )  # its cells take turns
    live = (
        sa.select(sa.func.count())
        .where(job.c.sweep_id == sweep.c.id, job.c.state.in_(LIVE), ~looked_at)
        .scalar_subquery()
    )
    rows = c.execute(
        sa.select(sweep, live.label("live"))
        .where(sweep.c.expanded < sweep.c.cells, ~sweep.c.cancelled, ~sweep.c.paused)
        .where(sweep.c.blockers == 0)
        .order_by(sweep.c.priority.desc(), sweep.c.id)
    ).all()
    found = []
    for r in rows:
        plan = find_reference(c, ("sweep", r.id), "plan")
        if plan is not None:
            root = json.loads(r.request)["root"]
            found.append(
                Expansion(r.id, plan.digest, root, r.priority, r.expanded, r.cells, r.live)
            )
    return found


def submit_sweep(
    c: Connection, spec: SweepSpec, rows: Sequence[Row], key: Key | None = None
) -> str:
    """Insert a sweep and jobs of its first cells; return its id. A known key returns its sweep."""
    sweep_id, known = insert_sweep(c, spec, key)
    if not known:
        insert_cells(c, sweep_id, 0, rows)
        dependencies.cancel_if_broken(c, sweep_id)
    return sweep_id


def insert_cells(c: Connection, sweep_id: str, first: int, rows: Sequence[Row]) -> bool:
    """Make jobs of cells [first, first + len(rows)); false if another did, or it was cancelled.

    A cell whose film holds enough samples ends at once: its reference is taken here, in the
    transaction of the lookup, so no collector comes between.
    """
    about = c.execute(sa.select(sweep).where(sweep.c.id == sweep_id)).first()
    if about is None or about.expanded != first or about.cancelled:
        return False
    request = json.loads(about.request)
    small = [r for r in rows if r.get("small")]
    films = _films(c, sweep_id, request, small)
    _insert_small(c, about, request, [(r, films[r["film_key"]]) for r in small])
    for r in rows:
        if "fault" in r:
            _insert_bad(c, about, request, r)
        elif not r["small"]:
            insert_job(c, _spec(about, request, r), sweep_id, about.blockers, about.created)
    end = first + len(rows)
    c.execute(sa.update(sweep).where(sweep.c.id == sweep_id).values(expanded=end))
    return True


def _films(c: Connection, sweep_id: str, request: JsonDict, rows: Iterable[Row]) -> dict[str, Any]:
    wanted = {r["film_key"]: r for r in rows}
    found = _known(c, wanted)
    now = time.time()
    new = [
        {
            "film_key": key,
            "geometry_key": r["geometry_key"],
            "scene": "",
            "assets": dumps({"root": request["root"], "pins": r["pins"]}),
            "width": r["width"],
            "height": r["height"],
            "replicates": r["replicates"],
            "state": "open",
            "whole": True,
            "plan": request["plan"],
            "cell": r["cell"],
            "created": now,
            "used": now,
        }
        for key, r in wanted.items()
        if key not in found
    ]
    if new:
        c.execute(sa.insert(film), new)
        added = _known(c, [row["film_key"] for row in new])
        plan = find_reference(c, ("sweep", sweep_id), "plan")
        assert plan is not None
        set_references(c, "film", "plan", [(f.id, plan) for f in added.values()])
        found |= added
    used = sa.update(film).where(film.c.id.in_([f.id for f in found.values()]))
    c.execute(used.values(used=now))
    for f in found.values():
        if f.state == "failed":  # asked for again: the attempts start over
            reopen_film(c, f.id)
    return found


def _known(c: Connection, keys: Iterable[str]) -> dict[str, Any]:
    rows = c.execute(sa.select(film).where(film.c.film_key.in_(list(keys))))
    return {r.film_key: r for r in rows}


def _insert_small(
    c: Connection, about: Any, request: JsonDict, cells: Sequence[tuple[Row, Any]]
) -> None:
    if not cells:
        return
    now = time.time()
    prefixes = _prefixes(c, [f.id for _, f in cells])
    rows, ended = [], []
    for r, f in cells:
        job_id = str(uuid7())
        known = f.prefix_spp >= r["spp_cap"] and f.id in prefixes and not about.blockers
        if known:
            facts = {"spp": f.prefix_spp, "seconds": f.seconds, "relmse": f.relmse,
                     "lower": f.relmse_lower, "upper": f.relmse_upper, "reason": "spp",
                     "record": f.prefix_record, "cached": True}  # fmt: skip
            ended.append((job_id, facts, prefixes[f.id]))
        rows.append(_job_row(about, request, r, now) | {
            "id": job_id, "film_id": f.id, "cached": known, "prefix_spp_at_submit": f.prefix_spp,
        })  # fmt: skip
    c.execute(sa.insert(job), rows)
    emit_all(c, "queued", [(row["id"], about.id, {"cached": row["cached"]}) for row in rows])
    end_cells(c, [(job_id, about.id, facts) for job_id, facts, _ in ended], now)
    set_references(c, "job", "film", [(job_id, blob) for job_id, _, blob in ended])
    spp = {job_id: facts["spp"] for job_id, facts, _ in ended}
    _copy_images(c, [row | {"spp": spp[row["id"]]} for row in rows if row["id"] in spp])


def _copy_images(c: Connection, ended: Sequence[JsonDict]) -> None:
    """Give cells the images of earlier jobs with the same samples, stop rule and output."""
    if not ended:
        return
    rows = c.execute(
        sa.select(job.c.film_id, job.c.ended_spp, job.c.stop, job.c.output, reference.c.kind)
        .add_columns(artifact.c.digest, artifact.c.size)
        .join(reference, (reference.c.owner == "job") & (reference.c.owner_id == job.c.id))
        .join(artifact, artifact.c.digest == reference.c.digest)
        .where(
            job.c.film_id.in_([row["film_id"] for row in ended]),
            job.c.state == JobState.SUCCEEDED.value,
            reference.c.kind != "film",
        )
    )
    made: dict[tuple[Any, ...], dict[str, Blob]] = {}
    for *same, kind, digest, size in rows:
        made.setdefault(tuple(same), {})[kind] = Blob(digest, size)
    held: dict[str, list[tuple[object, Blob]]] = {}
    for row in ended if made else ():
        same = [row[name] for name in ("film_id", "spp", "stop", "output")]
        for kind, blob in made.get(tuple(same), {}).items():
            held.setdefault(kind, []).append((row["id"], blob))
    for kind, blobs in held.items():
        set_references(c, "job", kind, blobs)


def _job_row(about: Any, request: JsonDict, r: Row, now: float) -> JsonDict:
    """Return the columns that any cell has; it has waited as long as its sweep."""
    return {
        "queued": about.created,
        "rank": queue_rank(about.priority, about.created),
        "deadline": request.get("deadline"),
        "blockers": about.blockers,
        "sweep_id": about.id,
        "cell": r["cell"],
        "parameters": dumps(r["parameters"]),
        "state": JobState.QUEUED.value,
        "priority": about.priority,
        "stop": dumps(r["stop"]),
        "spp_cap": r["spp_cap"],
        "output": dumps(r["output"]),
        "label": r["label"],
        "created": now,
    }


def _prefixes(c: Connection, film_ids: Sequence[int]) -> dict[int, Blob]:
    rows = c.execute(
        sa.select(reference.c.owner_id, artifact.c.digest, artifact.c.size)
        .join(artifact, artifact.c.digest == reference.c.digest)
        .where(
            reference.c.owner == "film",
            reference.c.kind == "prefix",
            reference.c.owner_id.in_([str(i) for i in film_ids]),
        )
    )
    return {int(r.owner_id): Blob(r.digest, r.size) for r in rows}


def _spec(about: Any, request: JsonDict, r: Row) -> JobSpec:
    assets = {"root": request["root"], "pins": r["pins"]}
    size = r["width"], r["height"], r["replicates"]
    return JobSpec(
        film=FilmSpec(r["film_key"], r["geometry_key"], r["scene"], assets, *size),
        stop=r["stop"],
        spp_cap=r["spp_cap"],
        output=r["output"],
        priority=about.priority,
        label=r["label"],
        cell=r["cell"],
        parameters=r["parameters"],
        deadline=request.get("deadline"),
    )


def _insert_bad(c: Connection, about: Any, request: JsonDict, r: Row) -> None:
    """A cell that was found wrong only now: a failed job that says why."""
    now, fault = time.time(), r["fault"]
    key = hashlib.sha256(f"{about.id}/{r['cell']}".encode()).hexdigest()
    nothing = {"film_key": key, "geometry_key": key, "scene": "{}", "assets": "{}", "width": 1,
               "height": 1, "replicates": 1, "state": "failed", "created": now}  # fmt: skip
    film_id = c.execute(sa.insert(film).values(nothing).returning(film.c.id)).scalar_one()
    job_id = str(uuid7())
    blank = {"stop": {}, "spp_cap": 1, "output": {}}
    row = _job_row(about, request, {**blank, **r}, now) | {
        "id": job_id, "film_id": film_id, "state": JobState.FAILED.value, "finished": now,
        "error_code": fault["code"], "error_message": fault["message"],
        "error_pointer": fault["pointer"],
    }  # fmt: skip
    c.execute(sa.insert(job).values(row))
    why = {k: fault[k] for k in ("code", "message", "pointer")}
    emit_all(c, "failed", [(job_id, about.id, why)])
