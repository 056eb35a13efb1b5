"""What nights are made of, in the database: rows of cells, and the pages a sweep has."""

from __future__ import annotations

import json
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from matiere.jobs.job import JsonDict
from matiere.jobs.night import PAGE
from matiere.jobs.store.files import Blob, add_reference, discard, drop_reference
from matiere.jobs.store.jobs import LIVE
from matiere.jobs.store.tables import artifact, film, job, reference, sweep

KIND = "night-{:05}"  # reference kind of a page of a sweep
SIGNATURE = "signature"  # reference kind of a job


def page_rows(c: Connection, sweep_id: str, page: int) -> list[JsonDict]:
    """Return the rows of one page's cells, each with the digest of its signature or None."""
    cells = (job.c.cell >= page * PAGE) & (job.c.cell < (page + 1) * PAGE)
    mine = (reference.c.owner == "job") & (reference.c.owner_id == job.c.id)
    stored = reference.alias()
    its = (stored.c.owner == "job") & (stored.c.owner_id == job.c.id) & (stored.c.kind == "film")
    joined = job.join(film).outerjoin(reference, mine & (reference.c.kind == SIGNATURE))
    rows = (
        sa.select(
            job,
            film.c.film_key,
            reference.c.digest.label("signature"),
            stored.c.digest.label("film_file"),
        )
        .select_from(joined.outerjoin(stored, its))
        .where(job.c.sweep_id == sweep_id, cells)
        .order_by(job.c.cell)
    )
    return [_row(r) for r in c.execute(rows)]


def _row(r: Any) -> JsonDict:
    known = r.ended_relmse_upper is not None
    failed = r.error_code is not None
    return {
        "cell": r.cell,
        "label": r.label,
        "parameters": json.loads(r.parameters),
        "state": r.state,
        "error": {"code": r.error_code, "message": r.error_message} if failed else None,
        "spp": r.ended_spp or 0,
        "seconds": r.ended_seconds or 0.0,
        "relmse": r.ended_relmse,
        "relmse_interval": [r.ended_relmse_lower, r.ended_relmse_upper] if known else None,
        "stop_reason": r.stop_reason,
        "cached": bool(r.cached),
        "film_key": r.film_key,
        "job_id": r.id,
        "signature": r.signature,
        "film": [r.film_file, r.film_record] if r.film_file else None,
    }  # fmt: skip


def missing_pages(c: Connection, sweep_id: str) -> list[int]:
    """Return the pages of an ended sweep's night that are still to be made."""
    cells = c.scalar(sa.select(sweep.c.cells).where(sweep.c.id == sweep_id)) or 0
    have = {kind for kind, _ in _pages(c, sweep_id)}
    return [page for page in range(-(-cells // PAGE)) if KIND.format(page) not in have]


def pages(c: Connection, sweep_id: str) -> list[Blob]:
    """Return the pages of a sweep's night, in order; none while it is not complete."""
    return [] if missing_pages(c, sweep_id) else [blob for _, blob in _pages(c, sweep_id)]


def add_page(c: Connection, sweep_id: str, page: int, blob: Blob) -> bool:
    """Record a page; false (and the file goes) if cells were queued again meanwhile."""
    live = sa.exists().where(job.c.sweep_id == sweep_id, job.c.state.in_(LIVE))
    if c.scalar(sa.select(live)):
        discard(c, [blob])
        return False
    add_reference(c, ("sweep", sweep_id), KIND.format(page), blob)
    return True


def drop_pages(c: Connection, sweep_id: str) -> None:
    """Forget the night of a sweep whose cells are queued again."""
    for kind, _ in _pages(c, sweep_id):
        drop_reference(c, ("sweep", sweep_id), kind)


def _pages(c: Connection, sweep_id: str) -> list[tuple[str, Blob]]:
    rows = c.execute(
        sa.select(reference.c.kind, artifact.c.digest, artifact.c.size)
        .join(artifact, artifact.c.digest == reference.c.digest)
        .where(
            reference.c.owner == "sweep",
            reference.c.owner_id == sweep_id,
            reference.c.kind.like(KIND.split("{")[0] + "%"),
        )
        .order_by(reference.c.kind)
    )
    return [(r.kind, Blob(r.digest, r.size)) for r in rows]
