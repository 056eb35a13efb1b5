"""Budgets of sweeps in the database: what is spent, which cells want more, and the end of one."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import sqlalchemy as sa
from sqlalchemy.engine import Connection

from matiere.jobs.budget import Wish
from matiere.jobs.job import Budget, JobState
from matiere.jobs.store.events import emit
from matiere.jobs.store.tables import film, job, sweep

REASON = "budget"  # stop reason of a cell that keeps what it has
LEAST_SHARE = 1e-9  # of the way: from less nobody can tell how long it takes
BATCH = 200  # cells ended in one transaction


@dataclass(frozen=True)
class OpenBudget:
    """The budget of a sweep that has not ended."""

    sweep_id: str
    seconds: float
    spent_s: float
    closed: bool


def charge(c: Connection, sweep_ids: Collection[str], seconds: float) -> None:
    """Count render seconds against the budgets of those sweeps that have one."""
    if sweep_ids:
        mine = sweep.c.id.in_(sorted(sweep_ids)) & sweep.c.budget.is_not(None)
        spent = sweep.c.budget_spent_s + seconds
        c.execute(sa.update(sweep).where(mine).values(budget_spent_s=spent))


def open_budgets(c: Connection) -> list[OpenBudget]:
    """Return the budgets of sweeps that have not ended, the most urgent sweep first."""
    rows = c.execute(
        sa.select(sweep)
        .where(sweep.c.budget.is_not(None), sweep.c.finished.is_(None), sweep.c.blockers == 0)
        .order_by(sweep.c.priority.desc(), sweep.c.id)
    )
    return [
        OpenBudget(
            r.id,
            float(json.loads(r.budget)["seconds"]),
            r.budget_spent_s,
            bool(r.budget_closed),
        )
        for r in rows
    ]


def wishes(c: Connection, sweep_id: str) -> list[Wish]:
    """Return the cells of a sweep that want more samples."""
    from matiere.jobs.store.jobs import WANTING

    rows = c.execute(
        sa.select(
            film.c.id,
            film.c.geometry_key,
            film.c.width,
            film.c.height,
            film.c.replicates,
            film.c.prefix_spp,
            film.c.seconds,
            film.c.pixel_samples,
            sa.func.min(job.c.target_share),
        )
        .join(job, job.c.film_id == film.c.id)
        .where(job.c.sweep_id == sweep_id, WANTING, ~film.c.whole, film.c.claim_token.is_(None))
        .group_by(film.c.id)
        .order_by(film.c.id)
    )
    return [Wish(*row) for row in rows]


def close(c: Connection, sweep_id: str) -> None:
    """Say that no cell of a sweep gets more."""
    mine = (sweep.c.id == sweep_id) & ~sweep.c.budget_closed
    if c.execute(sa.update(sweep).where(mine).values(budget_closed=True)).rowcount:
        spent = c.scalar(sa.select(sweep.c.budget_spent_s).where(sweep.c.id == sweep_id))
        emit(c, "budget_spent", sweep_id=sweep_id, seconds=spent)


def end_cells(c: Connection, sweep_id: str) -> tuple[int, list[tuple[str, int]]]:
    """End cells of a closed budget that have no samples, at most BATCH of them.

    Return how many, and (job, film) of others: a merge ends them with a last look at their error.
    """
    from matiere.jobs.store.jobs import WANTING, set_state

    rows = c.execute(
        sa.select(job.c.id, job.c.film_id, film.c.prefix_spp)
        .join(film)
        .where(job.c.sweep_id == sweep_id, WANTING)
        .order_by(job.c.cell)
        .limit(BATCH)
    ).all()
    empty = [job_id for job_id, _, spp in rows if not spp]
    for job_id in empty:
        set_state(c, job_id, JobState.UNFINISHED)
    c.execute(sa.update(job).where(job.c.id.in_(empty)).values(stop_reason=REASON))
    return len(empty), [(job_id, film_id) for job_id, film_id, spp in rows if spp]


def views(c: Connection, rows: Sequence[sa.Row[tuple[object, ...]]]) -> dict[str, Budget]:
    """Return the budgets of those rows of `sweep` that have one."""
    shared = {r.id: r for r in rows if r.budget is not None}
    if not shared:
        return {}
    live = [s.value for s in JobState if not s.final]
    near = sa.case((job.c.target_share > LEAST_SHARE, job.c.target_share), else_=None)
    more = sa.case((near >= 1.0, 0.0), else_=film.c.seconds * (1.0 / near - 1.0))
    looked = c.execute(
        sa.select(
            job.c.sweep_id,
            sa.func.count(),
            sa.func.count(near),
            sa.func.sum(more),
        )
        .join(film)
        .where(job.c.sweep_id.in_(list(shared)), job.c.state.in_(live), job.c.ended_spp.is_(None))
        .group_by(job.c.sweep_id)
    )
    needs = {name: float(need or 0.0) if known == n else None for name, n, known, need in looked}
    found = {}
    for name, r in shared.items():
        asked = json.loads(r.budget)
        needed = needs.get(name, 0.0) if r.expanded == r.cells else None
        found[name] = Budget(
            asked["seconds"], asked["target_error"], r.budget_spent_s, needed, bool(r.budget_closed)
        )
    return found
