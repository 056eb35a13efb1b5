"""Space and time: what is kept, what a collection removes, pins."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

from fastapi import APIRouter, Query

from matiere.service.deps import EngineDep
from matiere.service.jsonbody import StrictRoute
from matiere.service.routes.jobs import find_job
from matiere.service.routes.sweeps import find_sweep
from matiere.service.schemas import CollectedView, JobView, SweepView

router = APIRouter(tags=["storage"], route_class=StrictRoute)


@router.get("/v1/storage")
def storage(engine: EngineDep) -> dict[str, object]:
    """Show bytes and files by what they are for, the limits, and the free disk."""
    return engine.storage.usage()


@router.post("/v1/storage:collect", response_model=CollectedView)
def collect(
    engine: EngineDep,
    dry_run: Annotated[bool, Query(description="only tell what would go")] = False,
) -> CollectedView:
    """Remove old results, films beyond the limit and files that nobody names."""
    return CollectedView(**asdict(engine.storage.collect(dry_run=dry_run)))


@router.post("/v1/jobs/{job_id}:pin", response_model=JobView)
def pin_job(job_id: str, engine: EngineDep) -> JobView:
    """Keep a job, its results and its film, whatever their age."""
    find_job(engine, job_id)
    engine.storage.pin(job_id, True)
    return JobView.of(engine.get_job(job_id))


@router.post("/v1/jobs/{job_id}:unpin", response_model=JobView)
def unpin_job(job_id: str, engine: EngineDep) -> JobView:
    """Keep a job no longer than others."""
    find_job(engine, job_id)
    engine.storage.pin(job_id, False)
    return JobView.of(engine.get_job(job_id))


@router.post("/v1/sweeps/{sweep_id}:pin", response_model=SweepView)
def pin_sweep(sweep_id: str, engine: EngineDep) -> SweepView:
    """Keep a sweep with all its cells, whatever their age."""
    find_sweep(engine, sweep_id)
    engine.storage.pin(sweep_id, True)
    return SweepView.of(engine.get_sweep(sweep_id))


@router.post("/v1/sweeps/{sweep_id}:unpin", response_model=SweepView)
def unpin_sweep(sweep_id: str, engine: EngineDep) -> SweepView:
    """Keep a sweep no longer than others."""
    find_sweep(engine, sweep_id)
    engine.storage.pin(sweep_id, False)
    return SweepView.of(engine.get_sweep(sweep_id))
