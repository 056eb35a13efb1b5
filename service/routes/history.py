"""What was done for a job: its log as text, and the claims of render processes one by one."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Query, Response
from pydantic import BaseModel, Field
from starlette.responses import PlainTextResponse

from matiere.jobs.store.history import Attempt
from matiere.service import deps
from matiere.service.deps import EngineDep
from matiere.service.jsonbody import StrictRoute
from matiere.service.routes.jobs import MAX_PAGE, PAGE, of_job

router = APIRouter(prefix="/v1/jobs", tags=["jobs"], route_class=StrictRoute)

LOG_BYTES, MOST_LOG_BYTES = 2**16, 2**20


class AttemptView(BaseModel):
    """What a render process was given to do, and what came of it."""

    token: int = Field(description="rises with every claim, never used twice")
    state: str = Field(
        description="running, done (rendered), merged, failed, lost (killed from outside), void"
        " (given back unbegun) or cancelled"
    )
    films: int = Field(description="1, or how many small films of sweeps it was for")
    chunks: int = Field(description="of the film; 0 for small films, which are rendered whole")
    pid: int = Field(description="process that rendered, or that handed the work to a cluster")
    service: str = Field(description="run of the service that gave it out")
    started: datetime
    ended: datetime | None
    seconds: float | None = Field(description="of rendering, as stop rules count them")
    error_class: str | None = Field(description="how it ended, if not well: signal, lost, ...")
    message: str | None
    printed: str = Field(description="the end of what the process printed meanwhile")

    @classmethod
    def of(cls, attempt: Attempt) -> AttemptView:
        """Show `attempt`."""
        facts = {**vars(attempt), "started": datetime.fromtimestamp(attempt.started, UTC)}
        if attempt.ended is not None:
            facts["ended"] = datetime.fromtimestamp(attempt.ended, UTC)
        return cls(service=facts.pop("instance_id"), **facts)


class AttemptPage(BaseModel):
    """One page of claims."""

    attempts: list[AttemptView]
    next_cursor: str | None = Field(description="null on the last page")


@router.get("/{job_id}/attempts", response_model=AttemptPage)
def get_attempts(
    job_id: str,
    engine: EngineDep,
    cursor: Annotated[str | None, Query(max_length=500)] = None,
    limit: Annotated[int, Query(ge=1, le=MAX_PAGE)] = PAGE,
) -> AttemptPage:
    """List what render processes were given to do of the job's film while it lived, in order."""
    kind = f"attempts:{job_id[:64]}"
    after = int(deps.decode_cursor(kind, cursor) or 0)
    found = of_job(job_id, lambda name: engine.attempts(name, after=after, limit=limit + 1))
    more, found = len(found) > limit, found[:limit]
    next_cursor = deps.encode_cursor(kind, str(found[-1].token)) if more else None
    return AttemptPage(attempts=[AttemptView.of(one) for one in found], next_cursor=next_cursor)


@router.get(
    "/{job_id}/log",
    response_class=PlainTextResponse,
    responses={200: {"content": {"text/plain": {}}, "description": "The log"}},
)
def get_log(
    job_id: str,
    engine: EngineDep,
    most: Annotated[
        int, Query(alias="bytes", ge=1, le=MOST_LOG_BYTES, description="at most, from the end")
    ] = LOG_BYTES,
) -> Response:
    """What happened to a job, line by line, and what render processes printed meanwhile."""
    text = of_job(job_id, lambda name: engine.log(name, most))
    return PlainTextResponse(text, headers={"Cache-Control": "no-store"})
