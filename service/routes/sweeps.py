"""Sweeps: one base scene, some axes, a job per cell, a contact sheet."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, TypeVar

from fastapi import APIRouter, Query, Request, Response

from matiere.errors import MatiereError
from matiere.jobs.engine import Engine
from matiere.jobs.errors import JobNotFound, NotReadyYet
from matiere.jobs.job import JobState, Sweep
from matiere.jobs.store.views import position
from matiere.service import deps
from matiere.service.deps import EngineDep, InFlightDep, KeyDep, LabelIs, Order, OwnerDep
from matiere.service.errors import Problem
from matiere.service.jsonbody import StrictRoute
from matiere.service.routes.jobs import (
    MAX_PAGE,
    PAGE,
    RETRY_AFTER,
    accept,
    legal,
    refuse_missing,
    submission_problem,
)
from matiere.service.schemas import (
    Change,
    SweepLanguage,
    SweepPage,
    SweepSubmission,
    SweepView,
)

# Parts of a submission beside the base scene.
OWN = (*SweepLanguage.model_fields, "stop", "priority", "deadline", "after")

T = TypeVar("T")
router = APIRouter(prefix="/v1/sweeps", tags=["sweeps"], route_class=StrictRoute)


@router.post("", status_code=202, response_model=SweepView)
def submit_sweep(
    submission: SweepSubmission,
    response: Response,
    engine: EngineDep,
    in_flight: InFlightDep,
    key: KeyDep,
    owner: OwnerDep,
) -> SweepView:
    """Queue one job per cell, all or none. The cells are durable when this answers."""
    pins, language = submission.pins(), submission.language()
    with in_flight.hold(key):
        refuse_missing(engine, pins)
        try:
            sweep = engine.submit_sweep(
                submission.base,
                language.pop("axes", []),
                mode=submission.mode,
                stop=submission.stop_rule(),
                assets=pins,
                priority=submission.priority,
                label=submission.label,
                columns=submission.columns,
                deadline=submission.deadline,
                after=submission.after,
                idempotency_key=key,
                owner=owner,
                **language,
            )
        except MatiereError as error:
            raise submission_problem(error, "/base", OWN) from error
    accept(response, f"/v1/sweeps/{sweep.id}")
    return SweepView.of(sweep)


@router.get("", response_model=SweepPage)
def list_sweeps(
    engine: EngineDep,
    label: LabelIs = None,
    order: Order = None,
    cursor: Annotated[str | None, Query(max_length=500)] = None,
    limit: Annotated[int, Query(ge=1, le=MAX_PAGE)] = PAGE,
) -> SweepPage:
    """List sweeps, newest first unless `order` says else."""
    kind = deps.list_kind("sweeps", label, order)
    after = deps.decode_cursor(kind, cursor)
    sweeps = engine.list_sweeps(after=after, limit=limit + 1, label=label, order=order)
    more, sweeps = len(sweeps) > limit, sweeps[:limit]
    next_cursor = deps.encode_cursor(kind, position(sweeps[-1], order)) if more else None
    return SweepPage(sweeps=[SweepView.of(sweep) for sweep in sweeps], next_cursor=next_cursor)


@router.post("/{sweep_id}:cancel", response_model=SweepView)
def cancel_sweep(sweep_id: str, engine: EngineDep) -> SweepView:
    """Cancel every cell that has not ended; finished cells keep their results."""
    find_sweep(engine, sweep_id)
    return SweepView.of(engine.cancel_sweep(sweep_id))


@router.post("/{sweep_id}:pause", response_model=SweepView)
def pause_sweep(sweep_id: str, engine: EngineDep) -> SweepView:
    """Hold back every cell that waits or renders; all samples are kept."""
    find_sweep(engine, sweep_id)
    return SweepView.of(engine.pause_sweep(sweep_id))


@router.post("/{sweep_id}:resume", response_model=SweepView)
def resume_sweep(sweep_id: str, engine: EngineDep) -> SweepView:
    """Let every paused cell go on."""
    find_sweep(engine, sweep_id)
    return SweepView.of(engine.resume_sweep(sweep_id))


@router.post("/{sweep_id}:requeue", response_model=SweepView)
def requeue_sweep(sweep_id: str, engine: EngineDep) -> SweepView:
    """Start the next attempt of every cell that failed, expired or was cancelled."""
    find_sweep(engine, sweep_id)
    with legal():
        return SweepView.of(engine.requeue_sweep(sweep_id))


@router.patch("/{sweep_id}", response_model=SweepView)
def change_sweep(sweep_id: str, change: Change, engine: EngineDep) -> SweepView:
    """Change the priority of every cell that has not ended."""
    find_sweep(engine, sweep_id)
    return SweepView.of(engine.set_sweep_priority(sweep_id, change.priority))


@router.delete("/{sweep_id}", status_code=204)
def delete_sweep(sweep_id: str, engine: EngineDep) -> None:
    """Remove a sweep with its cells, results and night; live cells are cancelled."""
    of_sweep(sweep_id, engine.delete_sweep)


@router.get("/{sweep_id}", response_model=SweepView)
def get_sweep(sweep_id: str, response: Response, engine: EngineDep) -> SweepView:
    """Read a sweep: its axes and how many cells are in which state."""
    sweep = find_sweep(engine, sweep_id)
    if not sweep.done:
        response.headers.update(RETRY_AFTER)
    return SweepView.of(sweep)


@router.get(
    "/{sweep_id}/contact-sheet.png",
    response_class=Response,
    responses={200: {"content": {"image/png": {}}, "description": "The contact sheet"}},
    operation_id="get_sweep_contact_sheet",
)
def contact_sheet(sweep_id: str, request: Request, engine: EngineDep) -> Response:
    """All cells on one labelled sheet."""
    sweep = find_sweep(engine, sweep_id)
    try:
        artifact = engine.sweep_artifact(sweep_id)
    except NotReadyYet:
        ended = sum(n for state, n in sweep.counts.items() if JobState(state).final)
        raise Problem(
            "sweep_not_finished",
            f"{ended} of {sweep.cells} cells have ended.",
            headers=RETRY_AFTER,
            counts=sweep.counts,
            links={"sweep": f"/v1/sweeps/{sweep_id}"},
        ) from None
    except JobNotFound:
        raise Problem("artifact_not_found", "The sweep has no contact sheet.") from None
    return deps.file_response(request, artifact, f"{sweep_id}-contact-sheet.png")


def find_sweep(engine: Engine, sweep_id: str) -> Sweep:
    """Return the sweep or raise `sweep_not_found`."""
    return of_sweep(sweep_id, engine.get_sweep)


def of_sweep(sweep_id: str, action: Callable[[str], T]) -> T:
    """Return what `action` gives; raise `sweep_not_found` for what is no id, or of no sweep."""
    try:
        if deps.is_id(sweep_id):
            return action(sweep_id)
    except JobNotFound:
        pass
    raise Problem("sweep_not_found", f"No sweep has the id {sweep_id[:80]!r}.")
