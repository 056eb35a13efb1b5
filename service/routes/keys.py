"""API keys: list, make, rotate, revoke. Administration; only the digest of a key is stored."""

from __future__ import annotations

from datetime import datetime
from typing import Literal, cast

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from matiere.errors import SceneValidationError
from matiere.jobs.keys import MAX_NAME, Key, KeyNotFound, Keys
from matiere.service.access import Gate
from matiere.service.deps import EngineDep
from matiere.service.errors import Problem, problem_of
from matiere.service.jsonbody import StrictRoute
from matiere.service.schemas import time_of, time_or_none

router = APIRouter(prefix="/v1/keys", tags=["keys"], route_class=StrictRoute)


class KeyRequest(BaseModel):
    """A key to make."""

    model_config = ConfigDict(
        extra="forbid", strict=True, json_schema_extra={"examples": [{"name": "ci", "days": 90}]}
    )

    name: str = Field(min_length=1, max_length=MAX_NAME, description="whose it is")
    scope: Literal["read", "submit", "admin"] = Field(
        "submit", description="each includes those before it"
    )
    days: float | None = Field(None, gt=0, le=36500, description="until it expires; null: never")


class Rotation(BaseModel):
    """How a key is replaced."""

    model_config = ConfigDict(extra="forbid", strict=True)

    days: float | None = Field(None, gt=0, le=36500, description="until the new one expires")
    overlap_hours: float = Field(24.0, ge=0, le=8760, description="until the old one ends")


class KeyView(BaseModel):
    """A key, without the secret."""

    id: str
    name: str
    scope: str
    created: datetime
    expires: datetime | None
    revoked: datetime | None

    @classmethod
    def of(cls, key: Key) -> KeyView:
        """Show `key`."""
        times = {"expires": time_or_none(key.expires), "revoked": time_or_none(key.revoked)}
        return cls(id=key.id, name=key.name, scope=key.scope, created=time_of(key.created), **times)


class NewKey(KeyView):
    """A key just made."""

    key: str = Field(description="the key itself: it is shown this once")


class KeyList(BaseModel):
    """All keys."""

    keys: list[KeyView]


@router.get("", response_model=KeyList)
def list_keys(engine: EngineDep) -> KeyList:
    """List all keys, those that have ended too."""
    return KeyList(keys=[KeyView.of(key) for key in engine.keys.list()])


@router.post("", status_code=201, response_model=NewKey)
def create_key(
    wanted: KeyRequest, request: Request, response: Response, engine: EngineDep
) -> NewKey:
    """Make a key; once there is one, every request needs one."""
    try:
        made = engine.keys.create(wanted.name, wanted.scope, wanted.days)
    except SceneValidationError as error:
        raise problem_of(error) from None
    return _answer(request, response, made)


@router.post("/{key_id}:rotate", status_code=201, response_model=NewKey)
def rotate_key(
    key_id: str,
    request: Request,
    response: Response,
    engine: EngineDep,
    rotation: Rotation | None = None,
) -> NewKey:
    """Make the successor of a key; the old one ends after `overlap_hours`."""
    _known(engine.keys, key_id)
    wanted = rotation or Rotation(days=None, overlap_hours=24.0)
    try:
        made = engine.keys.rotate(key_id, days=wanted.days, overlap_hours=wanted.overlap_hours)
    except SceneValidationError as error:
        raise Problem("illegal_transition", f"{error}.") from None
    return _answer(request, response, made)


@router.delete("/{key_id}", response_model=KeyView)
def revoke_key(key_id: str, request: Request, engine: EngineDep) -> KeyView:
    """End a key at once."""
    _known(engine.keys, key_id)
    key = engine.keys.revoke(key_id)
    cast(Gate, request.app.state.gate).forget()
    return KeyView.of(key)


def _known(keys: Keys, key_id: str) -> None:
    try:
        keys.get(key_id)
    except KeyNotFound:
        raise Problem("key_not_found", f"No key has the id {key_id[:80]!r}.") from None


def _answer(request: Request, response: Response, made: tuple[Key, str]) -> NewKey:
    key, text = made
    cast(Gate, request.app.state.gate).forget()
    response.headers["Location"] = f"/v1/keys/{key.id}"
    response.headers["Cache-Control"] = "no-store"
    return NewKey(**KeyView.of(key).model_dump(), key=text)
