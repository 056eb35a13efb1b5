"""Views of sweeps: the list, one sweep as a grid over two of its axes, two cells side by side."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, NamedTuple
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Query, Response

from matiere.jobs.engine import Engine
from matiere.jobs.job import JobState
from matiere.service.deps import EngineDep
from matiere.service.errors import Problem
from matiere.service.page import words
from matiere.service.page.site import PageRoute, html
from matiere.service.routes import jobs as jobs_api
from matiere.service.routes import sweeps as api
from matiere.service.schemas import JobView, SweepView

router = APIRouter(route_class=PageRoute, include_in_schema=False)

MOST_CELLS = 1000  # that one view reads
PER_PAGE = 30
Index = Annotated[int | None, Query(ge=0, le=15)]
Cells = Annotated[list[str] | None, Query(max_length=8)]


@router.get("/sweeps")
def list_sweeps(
    engine: EngineDep, cursor: Annotated[str | None, Query(max_length=500)] = None
) -> Response:
    """Show sweeps, newest first."""
    page = api.list_sweeps(engine, cursor=cursor, limit=PER_PAGE)
    return html("sweeps.html", "/sweeps", page=page)


class Shown(NamedTuple):
    """Which axes of a grid lie across and down it, and at which value the others are held."""

    rows: int | None
    columns: int | None
    at: list[int]


def _shown(
    rows: Index = None,
    columns: Index = None,
    at: Annotated[list[int] | None, Query(max_length=16)] = None,
) -> Shown:
    return Shown(rows, columns, at or [])


ShownDep = Annotated[Shown, Depends(_shown)]


@router.get("/sweeps/{sweep_id}")
def sweep_view(sweep_id: str, engine: EngineDep, shown: ShownDep) -> Response:
    """Show a sweep: two axes across the grid, the others held at a value each."""
    return html("sweep.html", "/sweeps", **_facts(engine, sweep_id, shown))


@router.get("/sweeps/{sweep_id}/live")
def sweep_live(sweep_id: str, engine: EngineDep, shown: ShownDep) -> Response:
    """Show what of a sweep changes, for the script to put in place."""
    return html("_sweep_live.html", "/sweeps", **_facts(engine, sweep_id, shown))


@router.get("/sweeps/{sweep_id}/compare")
def compare_cells(sweep_id: str, engine: EngineDep, cell: Cells = None) -> Response:
    """Show two cells over each other, with what differs by more than noise."""
    api.find_sweep(engine, sweep_id)
    if cell is None or len(cell) != 2:
        raise Problem("bad_request", "Choose exactly two cells of the sweep to compare.")
    a, b = (JobView.of(jobs_api.find_job(engine, one)) for one in cell)
    sweep = SweepView.of(api.find_sweep(engine, sweep_id))
    return html("compare.html", "/sweeps", sweep=sweep, a=a, b=b)


def _facts(engine: Engine, sweep_id: str, shown: Shown) -> dict[str, Any]:
    sweep = SweepView.of(api.find_sweep(engine, sweep_id))
    cells = [JobView.of(job) for job in engine.list_jobs(sweep_id=sweep_id, limit=MOST_CELLS)]
    ended = sum(n for state, n in sweep.counts.items() if JobState(state).final)
    axes = _axes(sweep, cells)
    grid = (
        _grid(axes, cells, _across(axes, shown[:2]), shown.at)
        if sweep.mode == "grid" and axes
        else None
    )
    asked = {k: v for k, v in shown._asdict().items() if v not in (None, [])}
    query = urlencode(asked, doseq=True)
    return {
        "sweep": sweep, "cells": cells, "grid": grid, "axes": axes, "ended": ended,
        "query": f"?{query}" if query else "",
    }  # fmt: skip


def _axes(sweep: SweepView, cells: Sequence[JobView]) -> list[dict[str, Any]]:
    """Return label and values of every axis, the values as keys and as texts."""
    found = []
    for axis in sweep.axes:
        label = axis["label"]
        values: dict[str, str] = {}
        for value in axis.get("values") or [c.parameters.get(label) for c in cells]:
            values.setdefault(_key(value), words.short(value))
        for key, text in zip(values, axis.get("labels") or [], strict=False):
            values[key] = str(text)
        found.append({"label": label, "keys": list(values), "texts": list(values.values())})
    return found


def _key(value: Any) -> str:
    return json.dumps(value, sort_keys=True)


def _across(
    axes: Sequence[Mapping[str, Any]], chosen: tuple[int | None, int | None]
) -> tuple[int, int]:
    """Return the axes of rows and columns: as chosen, else the two longest, the last across."""
    rows, columns = chosen
    last = len(axes) - 1
    if rows is None or rows > last:
        rows = max(0, last - 1)
    if columns is None or columns > last:
        columns = last
    if rows == columns and last > 0:
        rows = next(i for i in range(len(axes)) if i != columns)
    return rows, columns


def _grid(
    axes: Sequence[Mapping[str, Any]],
    cells: Sequence[JobView],
    across: tuple[int, int],
    at: Sequence[int],
) -> dict[str, Any]:
    """Return the cells by row and column, where the other axes are at the chosen values."""
    rows, columns = across
    held = {
        i: min(at[i] if i < len(at) and at[i] >= 0 else 0, len(axis["keys"]) - 1)
        for i, axis in enumerate(axes)
        if i not in across
    }
    by_place: dict[tuple[str, str], JobView] = {}
    for cell in cells:
        keys = [_key(cell.parameters.get(axis["label"])) for axis in axes]
        if all(keys[i] == axes[i]["keys"][k] for i, k in held.items()):
            by_place[keys[rows], keys[columns]] = cell
    single = rows == columns
    lines = [] if single else axes[rows]["keys"]
    return {
        "rows": None if single else rows,
        "columns": columns,
        "held": held,
        "heads": axes[columns]["texts"],
        "lines": [("", [by_place.get((k, k)) for k in axes[columns]["keys"]])]
        if single
        else [
            (text, [by_place.get((key, k)) for k in axes[columns]["keys"]])
            for key, text in zip(lines, axes[rows]["texts"], strict=True)
        ],
    }
