"""Views of the machine: processes, queue, disk, counters."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Response

from matiere.jobs.job import JobState
from matiere.service.deps import EngineDep
from matiere.service.page.site import PageRoute, html

router = APIRouter(route_class=PageRoute, include_in_schema=False)


@router.get("/workers")
def workers(engine: EngineDep) -> Response:
    """Show who renders, what waits, and how much room there is."""
    return html("workers.html", "/workers", **_facts(engine))


@router.get("/workers/live")
def workers_live(engine: EngineDep) -> Response:
    """Show the same, for the script to put in place."""
    return html("_workers_live.html", "/workers", **_facts(engine))


def _facts(engine: EngineDep) -> dict[str, Any]:
    running = engine.list_jobs(state=JobState.RUNNING, limit=20)
    queued = engine.list_jobs(state=JobState.QUEUED, limit=200)
    queued.sort(key=lambda job: -job.effective_priority)
    return {
        "status": engine.status(),
        "usage": engine.storage.usage(),
        "running": running,
        "queued": queued[:20],
    }
