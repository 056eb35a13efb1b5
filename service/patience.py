"""How long a connection may take: requests that come slowly, or not at all, cost nothing.

Uvicorn waits without end for the first byte and for the rest of a header. Here a connection has a
few seconds to send a whole header, counted from its begin or from the first byte after the last
answer; then it is told so (408) and closed. Above a number of connections the next one is refused
(503) until others have gone. What is no HTTP gets a problem document too.
"""

from __future__ import annotations

import asyncio
import json
import resource
from http import HTTPStatus
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from matiere.service.errors import MEDIA_TYPE, Problem

HEADER_S = 15.0
MOST_CONNECTIONS = 4096
SPARE_FILES = 256  # descriptors that are not for connections


class PatientProtocol(H11Protocol):
    """HTTP/1.1 for clients that send what they began."""

    header_s = HEADER_S
    most_connections = MOST_CONNECTIONS
    _timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Give the first header its time; refuse what is too much."""
        super().connection_made(transport)
        if len(self.connections) > self.most_connections:
            headers = {"Retry-After": "5"}
            self._refuse(Problem("busy", "There are too many connections.", headers=headers))
        else:
            self._wait()

    def data_received(self, data: bytes) -> None:
        """Take bytes; those of a header must be complete in time."""
        super().data_received(data)
        if self._in_request():
            self._wait_no_more()
        elif self._timer is None and not self.transport.is_closing():
            self._wait()

    def on_response_complete(self) -> None:
        """Give the next header its time, if it has begun to come."""
        super().on_response_complete()
        if not self._in_request() and self.conn.trailing_data[0] and self._timer is None:
            self._wait()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._wait_no_more()
        super().connection_lost(exc)

    def send_400_response(self, msg: str) -> None:
        """Answer what is no HTTP."""
        self._refuse(Problem("bad_request", msg))

    # -- inside -------------------------------------------------------------------------------
    def _in_request(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _wait(self) -> None:
        self._timer = self.loop.call_later(self.header_s, self._too_slow)

    def _wait_no_more(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _too_slow(self) -> None:
        self._timer = None
        if not self._in_request():
            why = f"No request came within {self.header_s:g} s."
            self._refuse(Problem("request_timeout", why))

    def _refuse(self, problem: Problem) -> None:
        """Send a problem and close, or only close where an answer has begun."""
        if self.conn.our_state in (h11.IDLE, h11.SEND_RESPONSE) and not self.transport.is_closing():
            body = json.dumps(problem.document()).encode()
            head: dict[str, Any] = {"content-type": MEDIA_TYPE, "content-length": len(body),
                                    "connection": "close", "cache-control": "no-store",
                                    **(problem.headers or {})}  # fmt: skip
            phrase = HTTPStatus(problem.status_code).phrase
            lines = [f"HTTP/1.1 {problem.status_code} {phrase}"]
            lines += [f"{name}: {value}" for name, value in head.items()]
            self.transport.write("\r\n".join([*lines, "", ""]).encode() + body)
        self.transport.close()


def raise_file_limit() -> int:
    """Let this process open as many files as it may, and return how many connections it takes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MOST_CONNECTIONS + SPARE_FILES
    if hard != resource.RLIM_INFINITY:
        wanted = min(wanted, hard)
    if soft == resource.RLIM_INFINITY or soft >= wanted:
        return MOST_CONNECTIONS
    resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    return max(wanted - SPARE_FILES, wanted // 2)
