"""Assets: meshes, textures and light maps, stored under the SHA-256 of their bytes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from anyio import from_thread
from fastapi import APIRouter, Request, Response
from starlette.types import Message

from matiere.service.deps import EngineDep
from matiere.service.errors import Problem
from matiere.service.schemas import AssetView

router = APIRouter(prefix="/v1/assets", tags=["assets"])

_DIGEST = re.compile(r"[0-9a-f]{64}")
_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}


class _ClientLeft(Exception):
    """The client closed the connection before the body was complete."""


@router.put(
    "/{sha256}",
    status_code=201,
    response_model=AssetView,
    responses={200: {"model": AssetView, "description": "The server held it already"}},
    openapi_extra=_BODY,
)
def put_asset(sha256: str, request: Request, response: Response, engine: EngineDep) -> AssetView:
    """Store the body if its SHA-256 is the one in the address; 201 when new, 200 when held."""
    if not _DIGEST.fullmatch(sha256):
        raise Problem(
            "not_found", "An asset's address is its SHA-256: 64 lower-case hexadecimal digits."
        )
    try:
        created = engine.put_asset(sha256, _body(request))
    except _ClientLeft:
        raise Problem("bad_request", "The body ended early.") from None
    if not created:
        response.status_code = 200
    return AssetView(sha256=sha256, created=created)


@router.head("/{sha256}", responses={404: {"description": "The server lacks this asset"}})
def head_asset(sha256: str, engine: EngineDep) -> Response:
    """Tell whether the server holds an asset."""
    held = _DIGEST.fullmatch(sha256) is not None and not engine.missing_assets([sha256])
    if not held:
        raise Problem("not_found", "The server has no such asset.")
    return Response(status_code=200)


def _body(request: Request) -> Iterator[bytes]:
    """Yield the body piece by piece, in the worker thread that stores it."""

    async def receive() -> Message:
        return await request.receive()

    more = True
    while more:
        message = from_thread.run(receive)
        if message["type"] == "http.disconnect":
            raise _ClientLeft
        if piece := message.get("body", b""):
            yield piece
        more = message.get("more_body", False)
