"""The stability of the materials of a sweep: one verdict per cell."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from matiere.jobs.pointers import split_pointer
from matiere.jobs.sweep import SweepPlan
from matiere.service.client import Client, JobStatus, ServiceError
from matiere.service.console import live

ORDER = ("pass", "warn", "fail")


def verdicts(client: Client, plan: SweepPlan, jobs: Sequence[JobStatus]) -> dict[int, str]:
    """Return the worst verdict over the materials that vary in each cell: pass, warn or fail.

    Equal materials are tested once. A cell none of whose varying materials can be tested (textures,
    files) has none.
    """
    wanted: dict[str, list[int]] = {}
    for job in jobs:
        if job.cell is not None and job.rendered:
            for material in varying(plan, job.cell):
                wanted.setdefault(json.dumps(material, sort_keys=True), []).append(job.cell)
    found: dict[int, str] = {}
    with live("stability") as show:
        for number, (material, cells) in enumerate(wanted.items(), 1):
            verdict = _verdict(client, json.loads(material))
            show(number, len(wanted), f"{number}/{len(wanted)} materials")
            for cell in cells if verdict else ():
                found[cell] = max(verdict, found.get(cell, "pass"), key=ORDER.index)
    return found


def varying(plan: SweepPlan, cell: int) -> list[Any]:
    """Return the materials of a cell into which the sweep sets a value; all if it sets none."""
    materials: Mapping[str, Any] = plan.scene(cell).get("materials", {})
    parts = [split_pointer(at) for at, _ in plan.patches(cell)]
    names = {p[1] for p in parts if p[0] == "materials" and len(p) > 1}
    return [m for name, m in materials.items() if name in names or not names]


def _verdict(client: Client, material: Any) -> str:
    try:
        return client.check(material)
    except ServiceError as error:
        if error.status != 422:
            raise
        return ""
