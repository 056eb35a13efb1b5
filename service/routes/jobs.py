"""Jobs: submit, list, read, cancel, fetch the results."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Annotated, Any, TypeVar

from fastapi import APIRouter, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from matiere.errors import MatiereError
from matiere.jobs.engine import Engine
from matiere.jobs.errors import AssetMissing, IllegalTransition, JobNotFound, NotReadyYet
from matiere.jobs.job import Job, JobState
from matiere.jobs.store.views import position
from matiere.service import deps
from matiere.service.deps import EngineDep, InFlightDep, KeyDep, LabelIs, Order, OwnerDep
from matiere.service.errors import Problem, pointer, problem_of
from matiere.service.jsonbody import StrictRoute
from matiere.service.schemas import JOB_FILES, Change, JobPage, JobSubmission, JobView

router = APIRouter(prefix="/v1/jobs", tags=["jobs"], route_class=StrictRoute)

OWN = ("stop", "priority", "deadline", "after")  # parts of a submission beside the scene
T = TypeVar("T")
RETRY_AFTER = {"Retry-After": "2"}
PAGE = 100
MAX_PAGE = 1000


@router.post("", status_code=202, response_model=JobView)
def submit_job(
    submission: JobSubmission,
    response: Response,
    engine: EngineDep,
    in_flight: InFlightDep,
    key: KeyDep,
    owner: OwnerDep,
) -> JobView:
    """Queue one scene. The job is durable when this answers; a cached film answers 202 too."""
    pins = submission.pins()
    with in_flight.hold(key):
        refuse_missing(engine, pins)
        try:
            job = engine.submit_job(
                submission.scene,
                stop=submission.stop_rule(),
                assets=pins,
                priority=submission.priority,
                label=submission.label,
                deadline=submission.deadline,
                after=submission.after,
                idempotency_key=key,
                owner=owner,
            )
        except MatiereError as error:
            raise submission_problem(error, "/scene", OWN) from error
    accept(response, f"/v1/jobs/{job.id}")
    return JobView.of(job)


@router.get("", response_model=JobPage)
def list_jobs(
    engine: EngineDep,
    state: JobState | None = None,
    sweep: Annotated[
        str | None, Query(description="only the cells of this sweep; none: only single jobs")
    ] = None,
    label: LabelIs = None,
    order: Order = None,
    cursor: Annotated[str | None, Query(max_length=500)] = None,
    limit: Annotated[int, Query(ge=1, le=MAX_PAGE)] = PAGE,
) -> JobPage:
    """List jobs, newest first unless `order` says else; the cells of a sweep by cell index."""
    if sweep is not None and not deps.is_id(sweep):
        raise Problem("sweep_not_found", "No sweep has this id.")
    kind = deps.list_kind("jobs", state, sweep, label, order)
    after = deps.decode_cursor(kind, cursor)
    jobs = engine.list_jobs(
        state=state, sweep_id=sweep, after=after, limit=limit + 1, label=label, order=order
    )
    more, jobs = len(jobs) > limit, jobs[:limit]
    next_cursor = deps.encode_cursor(kind, position(jobs[-1], order)) if more else None
    return JobPage(jobs=[JobView.of(job) for job in jobs], next_cursor=next_cursor)


@router.post("/{job_id}:cancel", response_model=JobView)
def cancel_job(job_id: str, engine: EngineDep) -> JobView:
    """Cancel a job that has not ended; one that has ended is answered as it is."""
    find_job(engine, job_id)
    return JobView.of(engine.cancel_job(job_id))


@router.post("/{job_id}:pause", response_model=JobView)
def pause_job(job_id: str, engine: EngineDep) -> JobView:
    """Hold a job back; its samples are kept. One whose samples are complete ends all the same."""
    find_job(engine, job_id)
    with legal():
        return JobView.of(engine.pause_job(job_id))


@router.post("/{job_id}:resume", response_model=JobView)
def resume_job(job_id: str, engine: EngineDep) -> JobView:
    """Let a paused job go on, in its old place in the queue."""
    find_job(engine, job_id)
    with legal():
        return JobView.of(engine.resume_job(job_id))


@router.post("/{job_id}:requeue", response_model=JobView)
def requeue_job(job_id: str, engine: EngineDep) -> JobView:
    """Start the next attempt of a job that failed, expired or was cancelled."""
    find_job(engine, job_id)
    with legal():
        return JobView.of(engine.requeue_job(job_id))


@router.patch("/{job_id}", response_model=JobView)
def change_job(job_id: str, change: Change, engine: EngineDep) -> JobView:
    """Change the priority of a job that has not ended; the time it has waited still counts."""
    find_job(engine, job_id)
    return JobView.of(engine.set_priority(job_id, change.priority))


@router.delete("/{job_id}", status_code=204)
def delete_job(job_id: str, engine: EngineDep) -> None:
    """Remove a job with its results; a live one is cancelled. Cells go with their sweep."""
    of_job(job_id, engine.delete_job)


@contextlib.contextmanager
def legal() -> Iterator[None]:
    """Raise `illegal_transition` for a step that the state does not allow."""
    try:
        yield
    except IllegalTransition as error:
        raise Problem("illegal_transition", f"{error}.") from None


@router.get("/{job_id}", response_model=JobView)
async def get_job(job_id: str, response: Response, engine: EngineDep) -> JobView:
    """Read a job: state, samples, error with its interval, links to its files."""
    job = engine.recent_job(job_id)  # most who poll cost neither a reading nor a thread
    if job is None:
        job = await run_in_threadpool(find_job, engine, job_id)
    if not job.state.final:
        response.headers.update(RETRY_AFTER)
    return JobView.of(job)


def job_file(request: Request, engine: Engine, job_id: str, kind: str) -> Response:
    """Send a stored file of a job that has ended with a result."""
    job = find_job(engine, job_id)
    cut_short = job.state in (JobState.EXPIRED, JobState.UNFINISHED)
    kept = cut_short and kind in job.artifacts
    if job.state.final and job.state is not JobState.SUCCEEDED and not kept:
        reason = f": {job.error.message}" if job.error else ""
        raise Problem("job_not_succeeded", f"The job ended as {job.state}{reason}", state=job.state)
    try:
        artifact = engine.artifact(job_id, kind)
    except NotReadyYet:
        raise not_finished(job) from None
    except JobNotFound:
        raise Problem("artifact_not_found", f"The job has no {kind}.") from None
    return deps.file_response(request, artifact, f"{job_id}-{kind}")


def not_finished(job: Job, detail: str = "") -> Problem:
    """Return `job_not_finished`, with the links that help to wait."""
    links = JobView.of(job).links
    helpful = {name: links[name] for name in ("preview", "events", "log") if name in links}
    return Problem(
        "job_not_finished",
        detail or f"The job is {job.state}, {100 * job.progress:.0f} % done.",
        headers=RETRY_AFTER,
        state=job.state,
        progress=job.progress,
        links={"job": links["self"], **helpful},
    )


_MEDIA: dict[str, str] = {
    "thumbnail.jpg": "image/jpeg",
    "image.exr": "image/x-exr",
    "report.json": "application/json",
    "error.svg": "image/svg+xml",
}


def _serve(kind: str, summary: str) -> None:
    """Add the route of one kind of file."""
    name, last = JOB_FILES[kind]
    answer: dict[int | str, dict[str, Any]] = {
        200: {"content": {_MEDIA[kind]: {}}, "description": summary},
        304: {"description": "The client's copy (If-None-Match) is the current one"},
    }

    def handler(job_id: str, request: Request, engine: EngineDep) -> Response:
        return job_file(request, engine, job_id, kind)

    router.add_api_route(
        f"/{{job_id}}/{last}",
        handler,
        methods=["GET"],
        name=name,
        summary=summary,
        response_class=Response,
        responses=answer,
        operation_id=f"get_job_{name}",
    )


_serve("thumbnail.jpg", "The tonemapped image, at most 192 pixels wide and high")
_serve("image.exr", "The linear image with its standard error, as OpenEXR")
_serve("report.json", "Error against run time, samples, rejected samples, versions")
_serve("error.svg", "Plot of the error against run time")


def find_job(engine: Engine, job_id: str) -> Job:
    """Return the job or raise `job_not_found`."""
    return of_job(job_id, engine.get_job)


def of_job(job_id: str, action: Callable[[str], T]) -> T:
    """Return what `action` gives; raise `job_not_found` for what is no id, or of no job."""
    try:
        if deps.is_id(job_id):
            return action(job_id)
    except JobNotFound:
        pass
    raise Problem("job_not_found", f"No job has the id {job_id[:80]!r}.")


def accept(response: Response, location: str) -> None:
    """Set the headers of a 202."""
    response.headers["Location"] = location
    response.headers.update(RETRY_AFTER)


def refuse_missing(engine: Engine, pins: dict[str, str]) -> None:
    """Raise `asset_missing`, listing every pinned asset that the server lacks."""
    lacking = set(engine.missing_assets(pins.values())) if pins else set()
    names = [name for name, digest in pins.items() if digest in lacking]
    if names:
        raise Problem(
            "asset_missing",
            f"{len(names)} of {len(pins)} assets must be uploaded first: {', '.join(names[:5])}"
            + (" ..." if len(names) > 5 else ""),
            errors=[
                {
                    "pointer": pointer(("assets", name)),
                    "code": "asset_missing",
                    "message": f"the server has no asset {pins[name]}",
                }
                for name in names
            ],
            missing=[{"name": name, "sha256": pins[name]} for name in names],
        )


def submission_problem(error: MatiereError, prefix: str, own: tuple[str, ...]) -> Exception:
    """Translate an error of the queue: its pointers are into the scene, save those in `own`."""
    if isinstance(error, AssetMissing) or getattr(error, "errors", None) or error.pointer:
        return problem_of(error, prefix, own)
    return error
