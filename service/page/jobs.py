"""Views of jobs: the list, one job, what of it changes while it renders, and the submission."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Query, Response
from starlette.responses import RedirectResponse

from matiere.errors import MatiereError
from matiere.jobs.engine import Engine
from matiere.jobs.errors import JobNotFound
from matiere.jobs.job import Event, JobState
from matiere.jobs.store.history import Attempt
from matiere.service.deps import EngineDep
from matiere.service.page import examples, words
from matiere.service.page.plot import Forecast, Look, error_plot, looks_of
from matiere.service.page.site import PageRoute, html
from matiere.service.routes import jobs as api
from matiere.service.schemas import JobView

router = APIRouter(route_class=PageRoute, include_in_schema=False)

PER_PAGE = 40
NO_SWEEP = "none"  # as `GET /v1/jobs?sweep=none`: jobs that are no cells
EVENTS = 400
ATTEMPTS = 30  # newest claims that are shown
# Views of the built-in configuration for the display that files are made for.
SHOWN_VIEWS = (
    "ACES 2.0 - SDR 100 nits (Rec.709)", "Un-tone-mapped", "Video (colorimetric)", "Raw",
)  # fmt: skip
MOST_REPORT_BYTES = 32 * 2**20
Cursor = Annotated[str | None, Query(max_length=500)]


@router.get("/")
def list_jobs(engine: EngineDep, state: JobState | None = None, cursor: Cursor = None) -> Response:
    """Show jobs, newest first."""
    page = api.list_jobs(engine, state=state, sweep=NO_SWEEP, cursor=cursor, limit=PER_PAGE)
    counts = engine.status()["jobs"]
    live = any(not job.state.final for job in page.jobs)
    return html(
        "jobs.html", "/", page=page, state=state, counts=counts, live=live, states=list(JobState)
    )


@router.get("/jobs")
def jobs() -> Response:
    """Lead to the list."""
    return RedirectResponse("/", 308)


@router.get("/jobs/{job_id}")
def job_view(job_id: str, engine: EngineDep) -> Response:
    """Show a job: picture, error, what was left out, log, files."""
    job = JobView.of(api.find_job(engine, job_id))
    return html("job.html", "/", **_facts(engine, job), **_scene(engine, job_id))


@router.get("/jobs/{job_id}/live")
def job_live(job_id: str, engine: EngineDep) -> Response:
    """Show what of a job changes while it renders, for the script to put in place."""
    job = JobView.of(api.find_job(engine, job_id))
    return html("_job_live.html", "/", **_facts(engine, job))


@router.get("/submit")
def submit(
    engine: EngineDep,
    example: Annotated[str | None, Query(max_length=100)] = None,
    job: Annotated[str | None, Query(max_length=64)] = None,
) -> Response:
    """Show the editor with an example, or with the scene of an earlier job."""
    shelf = examples.shelf()
    chosen = shelf.get(example or "") or next(iter(shelf.values()))
    text, label, source = chosen.text, "", chosen.name
    if job is not None:
        found = api.find_job(engine, job)
        if (scene := engine.job_scene(job)) is not None:
            text, label, source = examples.layout(scene), found.label, ""
    return html(
        "submit.html", "/submit", shelf=shelf.values(), text=text, label=label, source=source
    )


def _scene(engine: Engine, job_id: str) -> dict[str, Any]:
    scene = engine.job_scene(job_id)
    materials = scene.get("materials", {}) if scene else {}
    tested = {
        name: material
        for name, material in materials.items()
        if "texture" not in json.dumps(material)
    }
    return {"has_scene": scene is not None, "materials": materials, "tested": tested}


def _facts(engine: Engine, job: JobView) -> dict[str, Any]:
    """Return what the views of a job show, from its row, its events and its report."""
    events = engine.history(job.id, EVENTS)
    report = _report(engine, job)
    looks = looks_of(report["log"]) if report else _looks(events)
    forecast = _forecast(job, looks)
    target = (job.stop.get("target_error") or {}).get("relmse")
    return {
        "job": job,
        "report": report,
        "error": report["error"] if report else None,
        "plot": error_plot(looks, target, forecast),
        "looks": looks,
        "forecast": forecast,
        "left": _left(job, forecast),
        "attempts": _attempts(engine, job.id),
        "history": events,
        "picture": _picture(job),
        "output_exposure": _output(engine, job).get("exposure", 0.0),
        "shown_views": [] if _output(engine, job).get("config") else SHOWN_VIEWS,
    }


def _output(engine: Engine, job: JobView) -> dict[str, Any]:
    return dict((engine.job_scene(job.id) or {}).get("output", {}))


def _attempts(engine: Engine, job_id: str) -> list[Attempt]:
    """Return the newest claims; none of a job that was deleted a moment ago."""
    with contextlib.suppress(JobNotFound):
        return engine.attempts(job_id, limit=ATTEMPTS, newest=True)
    return []


def _looks(events: list[Event]) -> list[Look]:
    return looks_of([event.data for event in events if event.kind == "look"])


def _forecast(job: JobView, looks: list[Look]) -> Forecast | None:
    """Return where a running job is expected to meet its error target."""
    if job.target_seconds is None or not looks or job.target_seconds <= looks[-1].seconds:
        return None
    last = looks[-1]
    return Forecast(job.target_seconds, last.relmse * last.seconds / job.target_seconds)


def _left(job: JobView, forecast: Forecast | None) -> float | None:
    """Return how many seconds of rendering are left, as far as anybody can tell."""
    if job.state.final or not 0 < job.progress < 1 or job.seconds <= 0:
        return None
    left = job.seconds * (1 - job.progress) / job.progress
    return min(left, max(forecast.seconds - job.seconds, 0.0)) if forecast else left


def _report(engine: Engine, job: JobView) -> Mapping[str, Any] | None:
    """Return the report of an ended job, if it is there."""
    if not job.state.final or "report" not in job.links:
        return None
    try:
        artifact = engine.artifact(job.id, "report.json")
        if artifact.path and artifact.size <= MOST_REPORT_BYTES:
            return dict(json.loads(Path(artifact.path).read_bytes()))
        return dict(json.loads(b"".join(engine.stream(artifact))))
    except (MatiereError, OSError, ValueError):
        return None  # the view says less; the link tells why


def _picture(job: JobView) -> dict[str, Any] | None:
    """Return the address of the picture as it stands, and what it shows."""
    if job.state.final:
        if "image_png" not in job.links:
            return None
        return {"url": job.links["image_png"], "alt": f"Rendered image of {words.name_of(job)}"}
    if job.spp and "preview" in job.links:
        url = f"{job.links['preview']}?v={job.spp}"
        return {"url": url, "alt": f"Preview of {words.name_of(job)} at {job.spp} spp"}
    return None
