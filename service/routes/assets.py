"""Assets: meshes, textures and light maps, stored under the SHA-256 of their bytes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import partial
from typing import Annotated, Any, NamedTuple

from anyio import from_thread, to_thread
from fastapi import APIRouter, Header, Request, Response
from pydantic import BaseModel, ConfigDict, Field
from starlette.types import Message

from matiere.jobs.engine import Engine
from matiere.jobs.errors import UploadBusy, WrongOffset
from matiere.service.deps import EngineDep, SettingsDep
from matiere.service.errors import Problem
from matiere.service.jsonbody import StrictRoute
from matiere.service.schemas import AssetView, Digest

router = APIRouter(tags=["assets"], route_class=StrictRoute)

OFFSET = "Upload-Offset"
MOST_ASKED = 10_000
_DIGEST = re.compile(r"[0-9a-f]{64}")
_RANGE = re.compile(r"bytes (\d{1,15})-(\d{1,15})/(\d{1,15})")
_BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}


class _ClientLeft(Exception):
    """The client closed the connection before the body was complete."""


class Part(NamedTuple):
    """What a Content-Range says: which bytes of how many."""

    first: int
    last: int
    total: int


class AssetsAsked(BaseModel):
    """Assets that a client is about to use."""

    model_config = ConfigDict(extra="forbid", strict=True)

    sha256: list[Digest] = Field(max_length=MOST_ASKED)


class AssetsMissing(BaseModel):
    """Those of them that must be uploaded first."""

    missing: list[str] = Field(description="SHA-256, each once, in the order asked")


@router.post("/v1/assets:missing", response_model=AssetsMissing)
def missing_assets(asked: AssetsAsked, engine: EngineDep) -> AssetsMissing:
    """Tell which assets the server lacks, before they are uploaded or named in a submission."""
    digests = [value.removeprefix("sha256:") for value in asked.sha256]
    return AssetsMissing(missing=engine.missing_assets(digests))


@router.put(
    "/v1/assets/{sha256}",
    status_code=201,
    response_model=AssetView,
    responses={
        200: {"model": AssetView, "description": "The server held it already"},
        202: {
            "model": AssetView,
            "description": "A part was kept; Upload-Offset says where to go on",
            "headers": {OFFSET: {"schema": {"type": "integer"}}},
        },
    },
    openapi_extra=_BODY,
)
async def put_asset(
    sha256: str,
    request: Request,
    response: Response,
    engine: EngineDep,
    settings: SettingsDep,
    content_range: Annotated[
        str | None,
        Header(
            alias="Content-Range",
            description="`bytes FIRST-LAST/TOTAL`: these bytes of the asset; FIRST is what HEAD"
            " says as Upload-Offset",
        ),
    ] = None,
) -> AssetView:
    """Store the body if its SHA-256 is the one in the address; 201 when new, 200 when held."""
    if not _DIGEST.fullmatch(sha256):
        raise Problem(
            "not_found", "An asset's address is its SHA-256: 64 lower-case hexadecimal digits."
        )
    part = _part(request, content_range, settings.max_asset_bytes)
    limiter = request.app.state.uploads  # threads of their own: slow ones hold up nobody else
    if limiter.available_tokens < 1:
        why = "As many uploads are under way as are taken at once."
        headers = {"Retry-After": "2", "Connection": "close"}
        raise Problem("busy", why, headers=headers)
    work = partial(_store, engine, sha256, part, request)
    response.status_code, offset = await to_thread.run_sync(work, limiter=limiter)
    if response.status_code == 202:
        response.headers[OFFSET] = str(offset)
    return AssetView(sha256=sha256, created=response.status_code == 201)


def _store(engine: Engine, sha256: str, part: Part | None, request: Request) -> tuple[int, int]:
    """Keep the body; return the status of the answer and how many bytes are there of a part."""
    was_there = not engine.missing_assets([sha256])
    offset = 0
    try:
        if part is None:
            was_there = not engine.put_asset(sha256, _body(request))
        else:
            offset = engine.uploads.append(sha256, _body(request), part.first, part.total)
    except _ClientLeft:
        raise Problem("bad_request", "The body ended early.") from None
    except Problem as problem:
        if problem.code == "body_too_large":
            engine.uploads.forget(sha256)
        raise
    except WrongOffset as error:
        headers = {OFFSET: str(error.offset), "Connection": "close"}
        raise Problem("wrong_offset", f"{error}.", headers=headers) from None
    except UploadBusy as error:
        headers = {"Retry-After": "2", "Connection": "close"}
        raise Problem("upload_busy", f"{error}.", headers=headers) from None
    if part is not None and offset < part.total:
        return 202, offset
    return (200 if was_there else 201), offset


@router.head(
    "/v1/assets/{sha256}",
    responses={
        404: {
            "description": "The server lacks this asset; Upload-Offset says how much of it is kept",
            "headers": {OFFSET: {"schema": {"type": "integer"}}},
        }
    },
)
def head_asset(sha256: str, engine: EngineDep) -> Response:
    """Tell whether the server holds an asset, and how much of one that is being uploaded."""
    if _DIGEST.fullmatch(sha256) is None:
        raise Problem("not_found", "The server has no such asset.")
    if engine.missing_assets([sha256]):
        headers = {OFFSET: str(engine.uploads.offset(sha256))}
        raise Problem("not_found", "The server has no such asset.", headers=headers)
    return Response(status_code=200)


def _part(request: Request, given: str | None, most: int) -> Part | None:
    """Return what a Content-Range says. Raises `bad_request` and `body_too_large`."""
    if given is None:
        return None
    found = _RANGE.fullmatch(given.strip())
    if found is None:
        raise Problem("bad_request", "The Content-Range must be `bytes FIRST-LAST/TOTAL`.")
    part = Part(*map(int, found.groups()))
    if not part.first <= part.last < part.total:
        raise Problem("bad_request", "The Content-Range does not lie inside its total.")
    length = request.headers.get("content-length")
    if length is not None and length != str(part.last - part.first + 1):
        raise Problem("bad_request", "The Content-Range has not as many bytes as the body.")
    if part.total > most:
        raise Problem("body_too_large", f"The limit here is {most:,} bytes.")
    return part


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
