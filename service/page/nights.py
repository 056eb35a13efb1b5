"""The view of nights: two runs of a sweep compared, cell by cell."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Response
from markupsafe import Markup

from matiere.service import night_page
from matiere.service.deps import EngineDep
from matiere.service.page.site import PageRoute, html
from matiere.service.routes import nights as api
from matiere.service.routes import sweeps as sweeps_api

router = APIRouter(route_class=PageRoute, include_in_schema=False)
Id = Annotated[str | None, Query(max_length=64)]


@router.get("/nights")
def nights(engine: EngineDep, a: Id = None, b: Id = None) -> Response:
    """Show two sweeps to choose, and what changed between them."""
    page = sweeps_api.list_sweeps(engine, cursor=None, limit=200)
    ended = [sweep for sweep in page.sweeps if sweep.finished is not None]
    body = None
    if a and b:
        report = api.compare_sweeps(api.NightComparison(a=a, b=b), engine)
        body = Markup("\n".join(night_page.body(report)))  # escaped where it is made
    return html("nights.html", "/nights", sweeps=ended, a=a, b=b, body=body)
