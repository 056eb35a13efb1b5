"""Who may do what: a rule for every route, keys, and the owner of the data directory.

`RULES` is the whole policy. `create_app` refuses to make an application with a route that has no
rule here, so a new route cannot be forgotten. Keys are asked for when the service listens beyond
loopback, or once a key was ever made; administration always needs one. The owner of the data
directory needs none: the service writes a token into `server.json`, which only that user can read,
and the commands of `matiere` send it. A browser sends the key as the password of HTTP Basic.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import hmac
import secrets
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

from starlette.concurrency import run_in_threadpool
from starlette.routing import compile_path

from matiere.jobs.engine import Engine
from matiere.jobs.keys import SCOPES, Key, match
from matiere.service.errors import Problem

PUBLIC, READ, SUBMIT, ADMIN = "public", "read", "submit", "admin"
FRESH_S = 2.0  # another service on the same database may have changed a key

RULES: dict[str, str] = {
    "GET /healthz": PUBLIC,
    "GET /readyz": PUBLIC,
    # the page
    "GET /": READ,
    "GET /jobs": READ,
    "GET /jobs/{job_id}": READ,
    "GET /jobs/{job_id}/live": READ,
    "GET /materials": READ,
    "GET /materials/{kind}": READ,
    "GET /nights": READ,
    "GET /submit": READ,
    "GET /sweeps": READ,
    "GET /sweeps/{sweep_id}": READ,
    "GET /sweeps/{sweep_id}/live": READ,
    "GET /sweeps/{sweep_id}/compare": READ,
    "GET /workers": READ,
    "GET /workers/live": READ,
    "GET /static/{digest}/{name:path}": PUBLIC,
    # the API
    "GET /metrics": READ,
    "GET /v1/openapi.json": READ,
    "GET /v1/status": READ,
    "GET /v1/storage": READ,
    "POST /v1/storage:collect": SUBMIT,
    "GET /v1/events": READ,
    "GET /v1/materials": READ,
    "GET /v1/schema": READ,
    "GET /v1/ball.png": READ,
    "POST /v1/checks": SUBMIT,
    "POST /v1/compare": SUBMIT,
    "POST /v1/jobs": SUBMIT,
    "GET /v1/jobs": READ,
    "GET /v1/jobs/{job_id}": READ,
    "PATCH /v1/jobs/{job_id}": SUBMIT,
    "DELETE /v1/jobs/{job_id}": SUBMIT,
    "POST /v1/jobs/{job_id}:cancel": SUBMIT,
    "POST /v1/jobs/{job_id}:pause": SUBMIT,
    "POST /v1/jobs/{job_id}:resume": SUBMIT,
    "POST /v1/jobs/{job_id}:requeue": SUBMIT,
    "POST /v1/jobs/{job_id}:pin": SUBMIT,
    "POST /v1/jobs/{job_id}:unpin": SUBMIT,
    "GET /v1/jobs/{job_id}/events": READ,
    "GET /v1/jobs/{job_id}/log": READ,
    "GET /v1/jobs/{job_id}/attempts": READ,
    "GET /v1/jobs/{job_id}/image.png": READ,
    "GET /v1/jobs/{job_id}/image.jpg": READ,
    "GET /v1/jobs/{job_id}/thumbnail.jpg": READ,
    "GET /v1/jobs/{job_id}/preview": READ,
    "GET /v1/jobs/{job_id}/difference": READ,
    "GET /v1/jobs/{job_id}/difference.png": READ,
    "GET /v1/jobs/{job_id}/image.exr": READ,
    "GET /v1/jobs/{job_id}/report": READ,
    "GET /v1/jobs/{job_id}/error-plot.svg": READ,
    "POST /v1/sweeps": SUBMIT,
    "GET /v1/sweeps": READ,
    "GET /v1/sweeps/{sweep_id}": READ,
    "PATCH /v1/sweeps/{sweep_id}": SUBMIT,
    "DELETE /v1/sweeps/{sweep_id}": SUBMIT,
    "POST /v1/sweeps/{sweep_id}:cancel": SUBMIT,
    "POST /v1/sweeps/{sweep_id}:pause": SUBMIT,
    "POST /v1/sweeps/{sweep_id}:resume": SUBMIT,
    "POST /v1/sweeps/{sweep_id}:requeue": SUBMIT,
    "POST /v1/sweeps/{sweep_id}:pin": SUBMIT,
    "POST /v1/sweeps/{sweep_id}:unpin": SUBMIT,
    "GET /v1/sweeps/{sweep_id}/events": READ,
    "GET /v1/sweeps/{sweep_id}/contact-sheet.png": READ,
    "GET /v1/sweeps/{sweep_id}/cells/{cell}/difference.png": READ,
    "GET /v1/sweeps/{sweep_id}/night": READ,
    "DELETE /v1/sweeps/{sweep_id}/night": SUBMIT,
    "GET /v1/sweeps/{sweep_id}/night/{page}": READ,
    "POST /v1/assets:missing": READ,
    "PUT /v1/assets/{sha256}": SUBMIT,
    "HEAD /v1/assets/{sha256}": READ,
    "GET /v1/webhooks": ADMIN,
    "POST /v1/webhooks": ADMIN,
    "DELETE /v1/webhooks/{webhook_id}": ADMIN,
    "GET /v1/keys": ADMIN,
    "POST /v1/keys": ADMIN,
    "DELETE /v1/keys/{key_id}": ADMIN,
    "POST /v1/keys/{key_id}:rotate": ADMIN,
}


class Identity(NamedTuple):
    """Who asks: a key (its id), the owner of the data directory, or anybody."""

    key_id: str | None
    scope: str


_STRICTNESS = (PUBLIC, *SCOPES)
NOBODY = Identity(None, PUBLIC)  # where nobody is asked
OWNER = Identity(None, ADMIN)
ANYBODY = Identity(None, SUBMIT)  # where no keys are asked for


class Gate:
    """Decides every request before anything else looks at it."""

    def __init__(self, engine: Callable[[], Engine], *, always: bool) -> None:
        """Guard the queue that `engine` returns; `always`: ask for keys even when there is none."""
        self._engine, self._always = engine, always
        self.owner_token = secrets.token_urlsafe(32)
        self._keys: dict[str, Key] = {}
        self._read_at: float | None = None
        self._changes = 0  # how often `forget` was called
        self._reading = asyncio.Lock()
        self._rules = [
            (method, compile_path(path)[0], scope)
            for (method, path), scope in ((name.split(" ", 1), RULES[name]) for name in RULES)
        ]

    def forget(self) -> None:
        """Read the keys again before the next request."""
        self._changes += 1
        self._read_at = None

    async def admit(self, method: str, path: str, headers: Mapping[bytes, list[bytes]]) -> Identity:
        """Return who asks, or raise `Problem` 401 or 403."""
        needed = self.rule(method, path)
        if needed == PUBLIC:
            return NOBODY
        await self._refresh()
        given = _credential(headers)
        if given is not None and hmac.compare_digest(given.encode(), self.owner_token.encode()):
            return OWNER
        key = match(given, self._keys) if given is not None else None
        if key is None or not key.valid(time.time()):
            if not self._asks and needed != ADMIN:
                return ANYBODY
            if given is None:
                who = "Administration needs" if not self._asks else "This service asks for"
                raise Problem("key_missing", f"{who} an API key.")
            why = "has ended" if key is not None else "is not one of this service"
            raise Problem("key_invalid", f"The API key {why}.")
        if not key.allows(needed):
            raise Problem(
                "scope_missing",
                f"This needs a key of scope {needed}; the scope of {key.id} is {key.scope}.",
            )
        return Identity(key.id, key.scope)

    async def holds(self, identity: Identity) -> bool:
        """Tell whether somebody who was admitted may still read on (a stream of events)."""
        await self._refresh()
        if identity.key_id is None:
            return identity == OWNER or not self._asks
        key = self._keys.get(identity.key_id)
        return key is not None and key.valid(time.time())

    def rule(self, method: str, path: str) -> str:
        """Return the scope a request needs: the strictest of all rules that fit its address.

        What is no route needs `read` to be told so.
        """
        method = "GET" if method == "HEAD" and not path.startswith("/v1/assets/") else method
        found = [scope for verb, at, scope in self._rules if verb == method and at.match(path)]
        return max(found, key=_STRICTNESS.index, default=READ)

    @property
    def _asks(self) -> bool:
        return self._always or bool(self._keys)  # of all keys, those that ended too

    async def _refresh(self) -> None:
        if self._read_at is not None and time.monotonic() - self._read_at < FRESH_S:
            return
        async with self._reading:
            if self._read_at is not None and time.monotonic() - self._read_at < FRESH_S:
                return
            begun, changes = time.monotonic(), self._changes
            known = await run_in_threadpool(lambda: self._engine().keys.list())
            self._keys = {key.id: key for key in known}
            self._read_at = begun if changes == self._changes else None


def unruled(routes: Iterable[Any]) -> list[str]:
    """Return every route (`METHOD path`) below `routes` that has no rule."""
    found = []
    for route in routes:
        if (inner := getattr(route, "original_router", None)) is not None:
            found += unruled(inner.routes)
            continue
        methods = set(getattr(route, "methods", None) or ())
        if "GET" in methods:
            methods.discard("HEAD")
        found += [
            name for method in sorted(methods) if (name := f"{method} {route.path}") not in RULES
        ]
    return found


def _credential(headers: Mapping[bytes, list[bytes]]) -> str | None:
    """Return the key of `Authorization: Bearer <key>`, or the password of Basic."""
    given = headers.get(b"authorization", [])
    if not given:
        return None
    scheme, _, value = given[0].decode("latin-1").partition(" ")
    if len(given) > 1 or scheme.lower() not in ("bearer", "basic"):
        return ""
    if scheme.lower() == "bearer":
        return value.strip()
    try:
        return base64.b64decode(value.strip(), validate=True).decode().partition(":")[2]
    except (binascii.Error, ValueError):
        return ""


assert set(RULES.values()) <= set(_STRICTNESS)
