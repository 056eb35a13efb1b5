"""Pictures drawn while the client waits: previews, other views of a film, differences, balls.

The utility process draws them from stored samples; nothing is rendered again (but the ball) and
nothing is stored.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Query, Request, Response

from matiere.errors import MatiereError, SceneValidationError
from matiere.jobs.engine import Engine
from matiere.jobs.engine_pictures import PREVIEW_PX, Picture
from matiere.jobs.errors import Busy, JobNotFound, NotReadyYet
from matiere.jobs.job import Job
from matiere.service.deps import EngineDep
from matiere.service.errors import Problem, problem_of
from matiere.service.jsonbody import StrictRoute, loads
from matiere.service.routes.jobs import RETRY_AFTER, find_job, job_file, not_finished
from matiere.service.routes.sweeps import find_sweep

router = APIRouter(prefix="/v1", tags=["pictures"], route_class=StrictRoute)


def _shown(
    exposure: Annotated[
        float | None, Query(ge=-30, le=30, description="stops; default: the job's")
    ] = None,
    view: Annotated[
        str | None, Query(max_length=200, description="OpenColorIO view; default: the job's")
    ] = None,
    display: Annotated[str | None, Query(max_length=200, description="OpenColorIO display")] = None,
) -> dict[str, Any]:
    asked = {"exposure": exposure, "view": view, "display": display}
    return {key: value for key, value in asked.items() if value is not None}


ShownDep = Annotated[dict[str, Any], Depends(_shown)]
JPEG: dict[int | str, dict[str, Any]] = {
    200: {"content": {"image/jpeg": {}}, "description": "The picture"},
    304: {"description": "The client's copy (If-None-Match) is the current one"},
}
PNG = {**JPEG, 200: {"content": {"image/png": {}}, "description": "The picture"}}


@router.get(
    "/jobs/{job_id}/preview",
    response_class=Response,
    responses=JPEG,
    operation_id="get_job_preview",
)
def preview(
    job_id: str,
    request: Request,
    engine: EngineDep,
    shown: ShownDep,
    longest: Annotated[int, Query(ge=16, le=4096, description="pixels of the longer edge")] = (
        PREVIEW_PX
    ),
) -> Response:
    """The samples so far as a JPEG, at any time once there are some."""
    job = find_job(engine, job_id)
    return _send(request, _film(engine, job, shown, ".jpg", longest), fixed=False)


@router.get(
    "/jobs/{job_id}/image.jpg",
    response_class=Response,
    responses=JPEG,
    operation_id="get_job_image_jpg",
)
def image_jpg(
    job_id: str,
    request: Request,
    engine: EngineDep,
    shown: ShownDep,
) -> Response:
    """The tonemapped image as a JPEG, through the job's view or another."""
    job = _ended(engine, job_id)
    return _send(request, _film(engine, job, shown, ".jpg"), fixed=True)


@router.get(
    "/jobs/{job_id}/image.png",
    response_class=Response,
    responses=PNG,
    operation_id="get_job_image_png",
)
def image_png(
    job_id: str,
    request: Request,
    engine: EngineDep,
    shown: ShownDep,
) -> Response:
    """The tonemapped image; through another exposure or view it is drawn from the film."""
    if not shown:
        return job_file(request, engine, job_id, "image.png")
    return _send(request, _film(engine, _ended(engine, job_id), shown, ".png"), fixed=True)


@router.get("/jobs/{job_id}/difference", operation_id="get_job_difference")
def difference(
    job_id: str, engine: EngineDep, against: Annotated[str, Query(max_length=64)]
) -> dict[str, Any]:
    """How this job's film differs from an earlier one (`against`), and what of it is no noise."""
    return _compared(engine, job_id, against).report


@router.get(
    "/jobs/{job_id}/difference.png",
    response_class=Response,
    responses=PNG,
    operation_id="get_job_difference_png",
)
def difference_png(
    job_id: str, request: Request, engine: EngineDep, against: Annotated[str, Query(max_length=64)]
) -> Response:
    """The signed difference of luminance, the tiles framed that differ by more than noise."""
    return _send(request, _compared(engine, job_id, against), fixed=True)


@router.get(
    "/sweeps/{sweep_id}/cells/{cell}/difference.png",
    response_class=Response,
    responses=PNG,
    operation_id="get_cell_difference",
)
def cell_difference(
    sweep_id: str, cell: Annotated[int, Path(ge=0)], request: Request, engine: EngineDep
) -> Response:
    """How a cell differs from the sweep's baseline: luminance, with what is noise marked."""
    sweep = find_sweep(engine, sweep_id)
    try:
        made = _difference(lambda: engine.cell_difference(sweep_id, cell))
    except NotReadyYet as error:
        links = {"sweep": f"/v1/sweeps/{sweep_id}"}
        raise Problem(
            "sweep_not_finished", f"{error}.", headers=RETRY_AFTER, counts=sweep.counts, links=links
        ) from None
    return _send(request, made, fixed=True)


@router.get("/ball.png", response_class=Response, responses=PNG, operation_id="get_ball")
def ball(
    request: Request,
    engine: EngineDep,
    material: Annotated[str, Query(max_length=8000, description="a material, as JSON")],
) -> Response:
    """A small ball of a material, rendered while the client waits."""
    given = loads(material.encode())
    if not isinstance(given, dict):
        raise Problem("invalid_request", "`material` must be a JSON object with a `type`.")
    try:
        return _send(request, engine.ball_picture(given), fixed=True)
    except SceneValidationError as error:
        raise problem_of(error) from error
    except Busy as error:
        raise _busy(error) from None


def _ended(engine: Engine, job_id: str) -> Job:
    job = find_job(engine, job_id)
    if not job.state.final:
        raise not_finished(job)
    return job


def _film(
    engine: Engine, job: Job, shown: dict[str, Any], suffix: str, longest: int | None = None
) -> Picture:
    try:
        return engine.film_picture(job.id, shown=shown, suffix=suffix, longest=longest)
    except NotReadyYet as error:
        raise not_finished(job, f"{error}.") from None
    except JobNotFound as error:
        raise Problem("artifact_not_found", f"{error}.") from None
    except Busy as error:
        raise _busy(error) from None
    except MatiereError as error:
        raise problem_of(error) from error


def _compared(engine: Engine, job_id: str, against: str) -> Picture:
    for one in (job_id, against):
        _ended(engine, one)
    return _difference(lambda: engine.difference_picture(against, job_id))


def _difference(draw: Callable[[], Picture]) -> Picture:
    try:
        return draw()
    except JobNotFound as error:
        raise Problem("artifact_not_found", f"{error}.") from None
    except Busy as error:
        raise _busy(error) from None
    except MatiereError as error:
        if error.code == "film_error":
            raise Problem("not_comparable", f"{error.message}.") from error
        raise problem_of(error) from error


def _busy(error: Busy) -> Problem:
    return Problem("too_many_pictures", error.message, headers={"Retry-After": "2"})


def _send(request: Request, picture: Picture, *, fixed: bool) -> Response:
    """Send a picture, or 304; a `fixed` one never changes at its address while its film is kept."""
    etag = f'"{picture.tag}"'
    headers = {"ETag": etag, "Cache-Control": "private, max-age=86400" if fixed else "no-cache"}
    known = [tag.strip() for tag in request.headers.get("if-none-match", "").split(",")]
    if "*" in known or etag in [tag.removeprefix("W/") for tag in known]:
        return Response(status_code=304, headers=headers)
    return Response(picture.data, headers=headers, media_type=picture.media_type)
