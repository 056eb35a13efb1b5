"""What the service measures, for Prometheus."""

from __future__ import annotations

from typing import cast

from fastapi import APIRouter, Request, Response

from matiere.service.metrics import CONTENT_TYPE, Metrics

router = APIRouter(tags=["health"])


@router.get(
    "/metrics",
    response_class=Response,
    responses={
        200: {
            "description": "Metrics in the text form of Prometheus",
            "content": {"text/plain": {"schema": {"type": "string"}}},
        }
    },
)
def metrics(request: Request) -> Response:
    """Show queue, work, children, store and requests to Prometheus."""
    found = cast(Metrics, request.app.state.metrics).text()
    return Response(found, headers={"Cache-Control": "no-store"}, media_type=CONTENT_TYPE)
