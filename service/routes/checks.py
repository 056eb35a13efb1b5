"""Stability reports of materials, made while the client waits."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter

from matiere.errors import MatiereError
from matiere.jobs.errors import Busy
from matiere.service.deps import EngineDep
from matiere.service.errors import Problem, problem_of
from matiere.service.jsonbody import StrictRoute
from matiere.service.routes.jobs import refuse_missing
from matiere.service.schemas import CheckReport, CheckSubmission

router = APIRouter(prefix="/v1/checks", tags=["reference"], route_class=StrictRoute)


@router.post("", response_model=CheckReport, response_model_exclude_unset=True)
def check_material(submission: CheckSubmission, engine: EngineDep) -> dict[str, Any]:
    """Test a material at its exact parameters; answers in about a second, one at a time."""
    refuse_missing(engine, submission.pins())
    try:
        return engine.check_material(
            submission.material,
            seed=submission.seed,
            plots=submission.plots,
            assets=submission.pins(),
        )
    except Busy as error:
        raise Problem("too_many_checks", error.message, headers={"Retry-After": "2"}) from None
    except MatiereError as error:
        if getattr(error, "errors", None) or error.pointer:
            raise problem_of(error, "/material") from error
        raise
