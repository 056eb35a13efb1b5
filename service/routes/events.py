"""What happens to jobs and sweeps, as it happens (Server-Sent Events) or page by page (JSON)."""

from __future__ import annotations

from collections.abc import AsyncGenerator
from contextlib import aclosing
from typing import Annotated, Any, cast

from fastapi import APIRouter, Header, Query, Request, Response
from fastapi.sse import EventSourceResponse
from starlette.concurrency import run_in_threadpool

from matiere.jobs.engine import Engine
from matiere.jobs.errors import JobNotFound
from matiere.jobs.job import Job, Sweep
from matiere.service import deps
from matiere.service.access import Gate
from matiere.service.broadcast import Broadcaster, Topic, named
from matiere.service.errors import Problem
from matiere.service.schemas import EventPage, EventView, JobView, SweepView

router = APIRouter(prefix="/v1", tags=["events"])

PAGE, MAX_PAGE = 500, 1000
_HEADERS = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
_ANSWER: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "A stream of events; with `Accept: application/json` one page of them",
        "content": {
            "text/event-stream": {"schema": {"type": "string"}},
            "application/json": {"schema": EventPage.model_json_schema()},
        },
    }
}
LastId = Annotated[
    str | None,
    Header(alias="Last-Event-ID", description="number of the last event that was received"),
]
After = Annotated[
    int | None, Query(ge=0, description="as Last-Event-ID; 0 begins with the oldest event kept")
]
Limit = Annotated[int, Query(ge=1, le=MAX_PAGE, description="of a page of JSON")]


@router.get("/events", responses=_ANSWER, response_class=Response, operation_id="get_events")
async def all_events(
    request: Request, last: LastId = None, after: After = None, limit: Limit = PAGE
) -> Response:
    """What happens to all jobs and sweeps; begins with the number of jobs in every state."""
    return await _answer(request, Topic(), last, after, limit)


@router.get(
    "/jobs/{job_id}/events",
    responses=_ANSWER,
    response_class=Response,
    operation_id="get_job_events",
)
async def job_events(
    job_id: str, request: Request, last: LastId = None, after: After = None, limit: Limit = PAGE
) -> Response:
    """What happens to a job; begins with the job as GET shows it."""
    if not deps.is_id(job_id):
        raise Problem("job_not_found", f"No job has the id {job_id[:80]!r}.")
    return await _answer(request, Topic(job_id=job_id), last, after, limit)


@router.get(
    "/sweeps/{sweep_id}/events",
    responses=_ANSWER,
    response_class=Response,
    operation_id="get_sweep_events",
)
async def sweep_events(
    sweep_id: str, request: Request, last: LastId = None, after: After = None, limit: Limit = PAGE
) -> Response:
    """What happens to a sweep and its cells; begins with the sweep as GET shows it."""
    if not deps.is_id(sweep_id):
        raise Problem("sweep_not_found", f"No sweep has the id {sweep_id[:80]!r}.")
    return await _answer(request, Topic(sweep_id=sweep_id), last, after, limit)


async def _answer(
    request: Request, topic: Topic, last: str | None, after: int | None, limit: int
) -> Response:
    engine = deps.engine_of(request)
    start = _start(last, after)
    try:
        number, facts, stale = await run_in_threadpool(_where, engine, topic, start)
    except JobNotFound:
        kind = "sweep" if topic.sweep_id else "job"
        raise Problem(f"{kind}_not_found", f"No {kind} has this id.") from None
    if "application/json" in request.headers.get("accept", ""):
        return await run_in_threadpool(_page, engine, topic, (start, number, stale), limit)
    broadcaster = cast(Broadcaster, request.app.state.broadcaster)
    if broadcaster.full:
        raise Problem("busy", "Too many streams of events are open.", headers={"Retry-After": "5"})
    if start is None or stale:
        first = named("reset" if stale else "snapshot", number, facts)
        stream = broadcaster.stream(topic, number, first)
    else:
        stream = broadcaster.stream(topic, start)
    return EventSourceResponse(_while_admitted(request, stream), headers=_HEADERS)


async def _while_admitted(request: Request, stream: AsyncGenerator[bytes]) -> AsyncGenerator[bytes]:
    """Go on until the key of the request ends."""
    gate, identity = cast(Gate, request.app.state.gate), request.state.identity
    async with aclosing(stream):
        async for text in stream:
            if not await gate.holds(identity):
                return
            yield text


def _start(last: str | None, after: int | None) -> int | None:
    if last is None or last == "":
        return after
    if not (last.isascii() and last.isdigit() and len(last) <= 18):
        raise Problem("invalid_cursor", "The Last-Event-ID is not one this service gave out.")
    return int(last)  # a browser that connects again knows better than the address


def _where(engine: Engine, topic: Topic, start: int | None) -> tuple[int, Any, bool]:
    """Return the newest number, what stands then, and whether `start` is outside the history."""
    oldest, newest = engine.event_range()
    stale = start is not None and start != 0 and not oldest - 1 <= start <= newest
    number, facts = engine.snapshot(job_id=topic.job_id, sweep_id=topic.sweep_id)
    return number, _shown(facts), stale


def _shown(facts: Job | Sweep | dict[str, int]) -> Any:
    if isinstance(facts, Job):
        return JobView.of(facts).model_dump(mode="json")
    if isinstance(facts, Sweep):
        return SweepView.of(facts).model_dump(mode="json")
    return {"jobs": facts}


def _page(
    engine: Engine, topic: Topic, place: tuple[int | None, int, bool], limit: int
) -> Response:
    start, newest, stale = place
    after = newest if stale else start or 0
    found = engine.events(after, job_id=topic.job_id, sweep_id=topic.sweep_id, limit=limit)
    last = found[-1].seq if found else max(after, newest)
    page = EventPage(events=[EventView.of(one) for one in found], last=last, reset=stale)
    return Response(page.model_dump_json(), headers=_HEADERS, media_type="application/json")
