"""What a route handler asks for: the engine, the submission guard, cursors, cached files."""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Literal, cast

from fastapi import Depends, Header, Query, Request
from starlette.responses import FileResponse, Response, StreamingResponse

from matiere.jobs.engine import Engine
from matiere.jobs.job import Artifact
from matiere.service.access import Identity
from matiere.service.errors import Problem
from matiere.service.settings import Settings

MAX_KEY_LENGTH = 200
# 18 digits: `int` of much longer ones takes time
_RANGES = re.compile(
    r"bytes=\s*(\d{1,18}-\d{0,18}|-\d{1,18})(\s*,\s*(\d{1,18}-\d{0,18}|-\d{1,18}))*"
)
_RANGE = re.compile(r"(\d*)-(\d*)")
_ID = re.compile(r"[0-9A-Za-z_-]{1,64}")


class InFlight:
    """The idempotency keys of submissions that have not been answered yet."""

    def __init__(self) -> None:
        self._keys: set[str] = set()
        self._lock = threading.Lock()

    @contextmanager
    def hold(self, key: str | None) -> Iterator[None]:
        """Hold `key` while a submission runs; refuse a second holder with 409."""
        if key is None:
            yield
            return
        with self._lock:
            if key in self._keys:
                raise Problem(
                    "idempotency_in_flight",
                    f"Idempotency-Key {key!r} is in use by a request that is not answered yet.",
                    headers={"Retry-After": "1"},
                )
            self._keys.add(key)
        try:
            yield
        finally:
            with self._lock:
                self._keys.discard(key)


def is_id(text: str) -> bool:
    """Tell whether `text` could be the id of a job or a sweep (no database need be asked)."""
    return _ID.fullmatch(text) is not None


def engine_of(request: Request) -> Engine:
    """Return the job queue behind this application."""
    return cast(Engine, request.app.state.engine)


def settings_of(request: Request) -> Settings:
    """Return the settings of this application."""
    return cast(Settings, request.app.state.settings)


def in_flight_of(request: Request) -> InFlight:
    """Return the guard over running submissions."""
    return cast(InFlight, request.app.state.in_flight)


async def idempotency_key(
    key: Annotated[
        str | None,
        Header(
            alias="Idempotency-Key",
            description="Any text unique to this request. The same key with the same body gives"
            " the same answer; with another body, 422.",
        ),
    ] = None,
) -> str | None:
    """Return the checked Idempotency-Key, or None."""
    if key is None:
        return None
    if not 1 <= len(key) <= MAX_KEY_LENGTH or not (key.isascii() and key.isprintable()):
        raise Problem(
            "invalid_idempotency_key",
            f"The Idempotency-Key must be 1 to {MAX_KEY_LENGTH} printable ASCII characters.",
        )
    return key


# Coroutines: each plain function would cost a request one more turn in the pool of threads.
async def _engine(request: Request) -> Engine:
    return engine_of(request)


async def _settings(request: Request) -> Settings:
    return settings_of(request)


async def _in_flight(request: Request) -> InFlight:
    return in_flight_of(request)


async def _owner(request: Request) -> str | None:
    """Return the id of the API key that asks, if one does."""
    identity: Identity | None = request.scope.get("state", {}).get("identity")
    return identity.key_id if identity is not None else None


OwnerDep = Annotated[str | None, Depends(_owner)]
EngineDep = Annotated[Engine, Depends(_engine)]
SettingsDep = Annotated[Settings, Depends(_settings)]
InFlightDep = Annotated[InFlight, Depends(_in_flight)]
KeyDep = Annotated[str | None, Depends(idempotency_key)]


Order = Annotated[
    Literal["created", "-created", "finished", "-finished"] | None,
    Query(description="`-` turns it round: the newest first; finished lists what has ended"),
]
LabelIs = Annotated[str | None, Query(max_length=200, description="only those with this label")]


def list_kind(name: str, *filters: object) -> str:
    """Return what a cursor is good for: a list and its filters."""
    if not any(filters):
        return name
    given = json.dumps([str(one or "") for one in filters])
    return f"{name}:{hashlib.sha256(given.encode()).hexdigest()[:16]}"


def encode_cursor(kind: str, last_id: str) -> str:
    """Return an opaque cursor: the last id seen and the list (with filters) it belongs to."""
    raw = json.dumps([1, kind, last_id], separators=(",", ":")).encode()
    return base64.urlsafe_b64encode(raw).decode().rstrip("=")


def decode_cursor(kind: str, cursor: str | None) -> str | None:
    """Return the id inside `cursor`; raise `Problem` if it is damaged or of another list."""
    if cursor is None:
        return None
    try:
        raw = base64.b64decode(cursor + "=" * (-len(cursor) % 4), altchars=b"-_", validate=True)
        version, of, last_id = json.loads(raw)
    except (binascii.Error, ValueError, TypeError, RecursionError):
        raise Problem("invalid_cursor", "The cursor is damaged.") from None
    if version != 1 or not isinstance(last_id, str) or not is_id(last_id):
        raise Problem("invalid_cursor", "The cursor is damaged.")
    if of != kind:
        raise Problem("invalid_cursor", "The cursor belongs to a list with other filters.")
    return last_id


def check_range(asked: str | None, size: int) -> None:
    """Refuse a Range that is none, or that lies behind the end, as a problem."""
    if asked is None:
        return
    if not _RANGES.fullmatch(asked.strip()):
        raise Problem("bad_request", "The Range must be `bytes=first-last`.")
    for first, last in _RANGE.findall(asked):
        if first and last and int(last) < int(first):
            raise Problem("bad_request", "The Range ends before it begins.")
        if first and int(first) >= size:
            headers = {"Content-Range": f"bytes */{size}"}
            raise Problem("range_not_satisfiable", f"The file has {size} bytes.", headers=headers)


def file_response(request: Request, artifact: Artifact, filename: str) -> Response:
    """Send an immutable file, or 304 when the client holds it already."""
    etag = f'"{artifact.digest}"'
    headers = {"ETag": etag, "Cache-Control": "private, max-age=31536000, immutable"}
    known = [tag.strip() for tag in request.headers.get("if-none-match", "").split(",")]
    if "*" in known or etag in [tag.removeprefix("W/") for tag in known]:
        return Response(status_code=304, headers=headers)
    check_range(request.headers.get("range"), artifact.size)
    if not artifact.path:  # in an object store
        headers |= {"Content-Length": str(artifact.size)}
        headers |= {"Content-Disposition": f'inline; filename="{filename}"'}
        pieces = engine_of(request).stream(artifact)
        return StreamingResponse(pieces, headers=headers, media_type=artifact.media_type)
    return FileResponse(
        artifact.path,
        headers=headers,
        media_type=artifact.media_type,
        filename=filename,
        content_disposition_type="inline",
    )
