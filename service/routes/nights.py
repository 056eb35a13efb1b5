"""Nights: the signatures of a sweep's cells, and two of them compared."""

from __future__ import annotations

from typing import Any, Literal

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from matiere.errors import MatiereError
from matiere.jobs.engine import Engine
from matiere.jobs.errors import Busy, JobNotFound, JobsError, NotReadyYet
from matiere.jobs.job import Artifact, JsonDict
from matiere.jobs.night_options import MAX_LISTED
from matiere.service import deps
from matiere.service.deps import EngineDep
from matiere.service.errors import Problem, problem_of
from matiere.service.jsonbody import StrictRoute
from matiere.service.routes.jobs import RETRY_AFTER
from matiere.service.routes.sweeps import find_sweep, of_sweep

router = APIRouter(prefix="/v1", tags=["nights"], route_class=StrictRoute)


class NightView(BaseModel):
    """A night: its pages hold the signatures of all cells, in order."""

    sweep_id: str
    name: str
    created: float = Field(description="Unix seconds")
    cells: int
    pages: list[str] = Field(description="URLs of packed files; `matiere night` reads them")


class NightComparison(BaseModel):
    """Two sweeps to compare, cell by cell."""

    model_config = ConfigDict(extra="forbid", strict=True)

    a: str = Field(description="id of the earlier sweep")
    b: str = Field(description="id of the later sweep")
    significance: float = Field(0.05, gt=0, lt=0.5, description="chance of any false alarm, or"
                                " with bh and by the expected share of false alarms")  # fmt: skip
    method: Literal["holm", "bh", "by"] = "holm"
    power: float = Field(0.8, ge=0.5, lt=1, description="of the smallest detectable change")
    listed: int = Field(100, ge=0, le=MAX_LISTED, description="changes that are described")

    def options(self) -> JsonDict:
        """Return what is not the sweeps."""
        return self.model_dump(exclude={"a", "b"})


@router.get("/sweeps/{sweep_id}/night", response_model=NightView)
def get_night(sweep_id: str, engine: EngineDep) -> NightView:
    """List the pages of a finished sweep's night."""
    head, pages = _night(engine, sweep_id)
    links = [f"/v1/sweeps/{sweep_id}/night/{number}" for number in range(len(pages))]
    return NightView(**head, pages=links)


@router.delete("/sweeps/{sweep_id}/night", status_code=204)
def delete_night(sweep_id: str, engine: EngineDep) -> None:
    """Remove a night: it is what its sweep left, so the sweep goes with its cells and results."""
    of_sweep(sweep_id, engine.delete_sweep)


@router.get(
    "/sweeps/{sweep_id}/night/{page}",
    response_class=Response,
    responses={200: {"content": {"application/octet-stream": {}}, "description": "One page"}},
    operation_id="get_night_page",
)
def night_page(sweep_id: str, page: int, request: Request, engine: EngineDep) -> Response:
    """One page of a night: cells and their signatures, packed."""
    _, pages = _night(engine, sweep_id)
    if not 0 <= page < len(pages):
        raise Problem("artifact_not_found", f"The night has {len(pages)} pages, numbered from 0.")
    return deps.file_response(request, pages[page], f"{sweep_id}-{page}.night")


@router.post("/compare", response_model=dict[str, Any])
def compare_sweeps(submission: NightComparison, engine: EngineDep) -> JsonDict:
    """Tell which cells of sweep b differ from sweep a by more than noise; one at a time."""
    for name in ("a", "b"):
        _night(engine, getattr(submission, name))
    try:
        return engine.compare_sweeps(submission.a, submission.b, submission.options())
    except Busy as error:
        raise Problem("too_many_comparisons", error.message, headers={"Retry-After": "5"}) from None
    except JobsError:
        raise
    except MatiereError as error:
        raise problem_of(error, "") from error


def _night(engine: Engine, sweep_id: str) -> tuple[JsonDict, list[Artifact]]:
    sweep = find_sweep(engine, sweep_id)
    try:
        return engine.night(sweep_id)
    except NotReadyYet as error:
        raise Problem(
            "sweep_not_finished", f"{error}.", headers=RETRY_AFTER, counts=sweep.counts,
            links={"sweep": f"/v1/sweeps/{sweep_id}"},
        ) from None  # fmt: skip
    except JobNotFound as error:
        raise Problem("artifact_not_found", f"{error}.") from None
