"""Checks made on every request before anything else sees it: pure ASGI, nothing buffered twice.

- `Host` must be on the allow-list, so that a web page cannot reach a loopback service through a
  DNS name of its own (DNS rebinding).
- The key, where one is asked for, must allow what is asked (`access.py`).
- A write must come from the same origin or from no browser at all (no `Origin`).
- A write with a body must say `application/json` (`application/octet-stream` for assets): the types
  an HTML form can send are refused, which together with the above stops cross-site requests.
- Bodies are counted while they arrive: a JSON body past `max_body_bytes`, an asset past
  `max_asset_bytes`, or a body that stalls is refused without being kept.
- An error that nothing foresaw is logged under an incident number and answered as a problem.
"""

from __future__ import annotations

import asyncio
import ipaddress
import socket
import time
from collections.abc import Iterable

import psutil
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from matiere.service.access import Gate
from matiere.service.errors import Problem, incident
from matiere.service.page.site import failure

READS = frozenset({"GET", "HEAD", "OPTIONS"})
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "[::1]")
MIN_BYTES_PER_S = 512  # of a body, on the average, once it has taken `body_timeout_s`
ASSET_PREFIX = "/v1/assets/"
_HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"content-security-policy", b"default-src 'none'; frame-ancestors 'none'"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-resource-policy", b"same-origin"),
)


def own_names(host: str) -> list[str]:
    """Return the names and addresses that requests for a listening address carry as `Host`."""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return [host]
    if not address.is_unspecified:
        return [f"[{host}]" if address.version == 6 else host]
    found = {socket.gethostname().lower()}
    for entries in psutil.net_if_addrs().values():
        for entry in entries:
            if entry.family == socket.AF_INET:
                found.add(entry.address)
            elif entry.family == socket.AF_INET6:
                found.add(f"[{entry.address.split('%')[0]}]")
    return sorted(found)


class SecurityMiddleware:
    """Refuse requests that no honest client sends; pass on the rest."""

    def __init__(
        self,
        app: ASGIApp,
        *,
        hosts: Iterable[str] = LOOPBACK_NAMES,
        max_body_bytes: int,
        max_asset_bytes: int,
        body_timeout_s: float,
        gate: Gate,
    ) -> None:
        self.app = app
        self.gate = gate
        self.hosts = frozenset(host.lower() for host in hosts)
        self.max_body_bytes = max_body_bytes
        self.max_asset_bytes = max_asset_bytes
        self.body_timeout_s = body_timeout_s

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one ASGI connection."""
        if scope["type"] == "lifespan":
            await self.app(scope, receive, send)
            return
        if scope["type"] != "http":  # no WebSocket is served: close it
            await send({"type": "websocket.close", "code": 1003})
            return
        send = _with_headers(send)
        headers = _headers(scope)
        try:
            is_asset = scope["path"].startswith(ASSET_PREFIX)
            limit = self.max_asset_bytes if is_asset else self.max_body_bytes
            self._check_host(headers)
            identity = await self.gate.admit(scope["method"], scope["path"], headers)
            scope = {**scope, "state": {**scope.get("state", {}), "identity": identity}}
            if scope["method"] not in READS:
                _check_origin(scope, headers)
                _check_content_type(headers, is_asset)
            _check_length(headers, limit)
            if is_asset:
                receive = self._counted(receive, limit)
            else:
                receive = _replay(await self._read(receive, limit), receive)
        except Problem as problem:
            await _refusal(problem, scope["path"], headers)(scope, receive, send)
            return
        if scope["method"] == "HEAD" and not is_asset:  # the server leaves the body out
            scope = {**scope, "method": "GET"}
        await self._run(scope, receive, send)

    async def _run(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Run the application; what it fails to handle becomes a 500 with an incident number."""
        begun = False

        async def noting(message: Message) -> None:
            nonlocal begun
            begun = True
            await send(message)

        try:
            await self.app(scope, receive, noting)
        except Exception as error:
            problem = incident(error, scope["method"], scope["path"])
            if not begun:
                await problem.response()(scope, receive, send)

    def _check_host(self, headers: dict[bytes, list[bytes]]) -> None:
        given = headers.get(b"host", [])
        if len(given) != 1:
            raise Problem("bad_request", "A request needs exactly one Host header.")
        host = given[0].decode("latin-1").lower()
        name, _, port = host.rpartition(":")
        if not port.isdigit():
            name = host
        if name not in self.hosts:
            shown = host[:100]
            raise Problem("host_not_allowed", f"This service does not answer for host {shown!r}.")

    def _counted(self, receive: Receive, limit: int) -> Receive:
        received, more, begun = 0, True, time.monotonic()

        async def counted() -> Message:
            nonlocal received, more
            if not more:  # what follows is the wait for a disconnect: it may take any time
                return await receive()
            message = await self._timed(receive)
            received += len(message.get("body", b""))
            took = time.monotonic() - begun
            if took > self.body_timeout_s and received < MIN_BYTES_PER_S * took:
                why = f"The body came at less than {MIN_BYTES_PER_S} bytes a second."
                raise Problem("request_timeout", why, headers={"Connection": "close"})
            more = message.get("more_body", False)
            if received > limit:
                raise _too_large(limit)
            return message

        return counted

    async def _read(self, receive: Receive, limit: int) -> bytes | None:
        """Return the whole body, or None when the client left."""
        counted, body, more = self._counted(receive, limit), bytearray(), True
        while more:
            message = await counted()
            if message["type"] == "http.disconnect":
                return None
            body += message.get("body", b"")
            more = message.get("more_body", False)
        return bytes(body)

    async def _timed(self, receive: Receive) -> Message:
        try:
            return await asyncio.wait_for(receive(), self.body_timeout_s)
        except TimeoutError:
            raise Problem(
                "request_timeout", f"No byte of the body came for {self.body_timeout_s:g} s."
            ) from None


def _refusal(problem: Problem, path: str, headers: dict[bytes, list[bytes]]) -> Response:
    """Return the answer to a request that went no further; a reader of the page gets a page."""
    reads = any(b"text/html" in value for value in headers.get(b"accept", []))
    response = failure(problem) if reads and not path.startswith("/v1/") else problem.response()
    if problem.status_code == 401:
        # Two lines: browsers know the second, and send what their user typed with every request
        # of the page, pictures and streams of events among them.
        for scheme in ("Bearer", "Basic"):
            response.headers.append("WWW-Authenticate", f'{scheme} realm="matiere"')
    return response


def _replay(body: bytes | None, receive: Receive) -> Receive:
    """Return a `receive` that gives `body` once and then what the connection says."""
    sent = False

    async def replay() -> Message:
        nonlocal sent
        if sent:
            return await receive()
        sent = True
        if body is None:
            return {"type": "http.disconnect"}
        return {"type": "http.request", "body": body, "more_body": False}

    return replay


def _headers(scope: Scope) -> dict[bytes, list[bytes]]:
    headers: dict[bytes, list[bytes]] = {}
    for name, value in scope["headers"]:
        headers.setdefault(name.lower(), []).append(value)
    return headers


def _check_origin(scope: Scope, headers: dict[bytes, list[bytes]]) -> None:
    own = scope.get("scheme", "http").encode() + b"://" + headers[b"host"][0].lower()
    for origin in headers.get(b"origin", []):
        if origin.lower() != own:
            shown = origin[:100].decode("latin-1")
            raise Problem("origin_not_allowed", f"The origin {shown!r} may not write here.")


def _check_content_type(headers: dict[bytes, list[bytes]], is_asset: bool) -> None:
    has_body = b"transfer-encoding" in headers or headers.get(b"content-length", [b"0"])[0] != b"0"
    given = headers.get(b"content-type", [])
    if not given and not has_body:  # `POST .../{id}:cancel` needs no body
        return
    wanted = b"application/octet-stream" if is_asset else b"application/json"
    types = [value.split(b";")[0].strip().lower() for value in given]
    if types != [wanted]:
        shown = ", ".join(value.decode("latin-1")[:60] for value in given) or "nothing"
        raise Problem(
            "content_type_not_supported",
            f"The Content-Type must be {wanted.decode()}; this request says {shown}.",
        )


def _check_length(headers: dict[bytes, list[bytes]], limit: int) -> None:
    for value in headers.get(b"content-length", []):
        if not value.isdigit():
            raise Problem("bad_request", "The Content-Length is not a number.")
        if len(value) > 18 or int(value) > limit:
            raise _too_large(limit)


def _too_large(limit: int) -> Problem:
    # The rest of the body is not read, so the connection cannot serve another request.
    headers = {"Connection": "close"}
    return Problem("body_too_large", f"The limit here is {limit:,} bytes.", headers=headers)


def _with_headers(send: Send) -> Send:
    async def with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            present = {name.lower() for name, _ in message.get("headers", [])}
            extra = [pair for pair in _HEADERS if pair[0] not in present]
            message = {**message, "headers": [*message.get("headers", []), *extra]}
        await send(message)

    return with_headers
