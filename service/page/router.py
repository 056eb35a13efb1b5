"""All routes of the page."""

from __future__ import annotations

from fastapi import APIRouter, Response

from matiere.service.errors import Problem
from matiere.service.page import jobs, materials, nights, sweeps, workers
from matiere.service.page.site import PageRoute, static_file

router = APIRouter(route_class=PageRoute, include_in_schema=False)
for views in (jobs, sweeps, nights, materials, workers):
    router.include_router(views.router)


@router.get("/static/{digest}/{name:path}")
def static(digest: str, name: str) -> Response:
    """Serve style, script and small pictures of the page."""
    found = static_file(name)
    if found is None:
        raise Problem("not_found", "The page has no such file.")
    return found
