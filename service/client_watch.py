"""Following a job or a sweep: a stream of events that lives through lost connections.

It reads Server-Sent Events and connects again with the number of the last event received, so that
nothing is missing and nothing comes twice. Where no stream gets through (a proxy that holds answers
back, too many streams at once) it reads the same events page by page.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import httpx

from matiere.service.client_views import (
    ENDED,
    JobStatus,
    ServiceError,
    ServiceEvent,
    SweepStatus,
    Unreachable,
    refusal,
)

if TYPE_CHECKING:
    from matiere.service.client import Client

SILENCE_S = 40.0  # the service says something every 15 s
RETRY_S = (0.1, 2.0)  # first and longest pause before the next connection
POLL_S = (0.1, 2.0)  # first and longest pause between two pages
BEYOND = 10**17  # a number outside the history: the answer tells the newest
JSON = {"Accept": "application/json"}
Status = JobStatus | SweepStatus
Said = Callable[[str], None]


class _NoStream(Exception):
    """Events have to be read page by page."""


class Follower:
    """One reading of the events of one job or sweep."""

    def __init__(
        self, client: Client, status: Status, *, after: int | None, on_lost: Said | None
    ) -> None:
        """Follow what `status` describes, from the event after number `after`, or from now on."""
        self._client, self._status, self._after, self._on_lost = client, status, after, on_lost
        self._path = status.links["events"]
        self._heard = time.monotonic()  # when the service last said anything
        self._lost = False

    def events(self) -> Iterator[ServiceEvent]:
        """Yield events until the job or sweep has ended."""
        if self._after is not None and self._status.ended:
            yield from self._pages(to_end=False)
            return
        pause, longest = RETRY_S
        while True:
            before = self._after
            try:
                for event in self._stream():
                    yield event
                    if self._is_last(event):
                        return
            except _NoStream:
                yield from self._pages(to_end=True)
                return
            except httpx.TransportError as error:
                self._check_patience(error)
            if self._after != before:
                pause = RETRY_S[0]
            time.sleep(pause)
            pause = min(2 * pause, longest)

    def _is_last(self, event: ServiceEvent) -> bool:
        if event.status is not None:
            return event.status.ended
        if isinstance(self._status, SweepStatus):
            return event.kind == "sweep_finished"
        return event.kind in ENDED

    # -- the stream ---------------------------------------------------------------------------
    def _stream(self) -> Iterator[ServiceEvent]:
        headers = {"Accept": "text/event-stream"}
        if self._after is not None:
            headers["Last-Event-ID"] = str(self._after)
        timeout = httpx.Timeout(SILENCE_S, connect=5.0)
        silent = True
        try:
            with self._client._http.stream(
                "GET", self._path, headers=headers, timeout=timeout
            ) as answer:
                if answer.status_code >= 400:
                    answer.read()
                    self._refused(answer)
                    return
                if not answer.headers.get("content-type", "").startswith("text/event-stream"):
                    raise _NoStream
                for fields in parsed(answer.iter_bytes()):
                    silent = False
                    self._heard, self._lost = time.monotonic(), False
                    if event := self._event(fields):
                        yield event
        except httpx.ReadTimeout:
            if silent:
                raise _NoStream from None
            raise

    def _refused(self, answer: httpx.Response) -> None:
        """Return to connect again; raise to go another way, or where nothing helps."""
        error = refusal(answer)
        if error.status != 503:
            raise error
        if error.code == "busy":
            raise _NoStream
        self._check_patience(error)
        time.sleep(min(float(answer.headers.get("retry-after", RETRY_S[0])), RETRY_S[1]))

    def _event(self, fields: dict[str, str]) -> ServiceEvent | None:
        if "id" not in fields or "data" not in fields:
            return None  # a comment that keeps the connection open, or the time to wait
        number, facts = int(fields["id"]), json.loads(fields["data"])
        self._after = number
        if name := fields.get("event"):
            return self._snapshot(name, number, type(self._status).model_validate(facts))
        return ServiceEvent.model_validate(facts)

    def _snapshot(self, name: str, number: int, status: Status) -> ServiceEvent:
        self._status = status
        is_sweep = isinstance(status, SweepStatus)
        about = {"sweep_id" if is_sweep else "job_id": status.id}
        return ServiceEvent(seq=number, kind=name, status=status, **about)

    def _check_patience(self, error: Exception) -> None:
        if not self._lost and self._on_lost is not None:
            self._on_lost(str(error))
        self._lost = True
        if time.monotonic() - self._heard > self._client.patience_s:
            raise Unreachable(f"no service answers at {self._client.url} ({error})") from None

    # -- pages ----------------------------------------------------------------------------------
    def _pages(self, *, to_end: bool) -> Iterator[ServiceEvent]:
        """Yield events page by page, until the last one (or only those that there are)."""
        pause = POLL_S[0]
        while True:
            name = "snapshot" if self._after is None else "reset"
            after = BEYOND if self._after is None else self._after
            params = {"after": str(after)}
            page = self._client._request("GET", self._path, params=params, headers=JSON).json()
            if page["reset"]:
                self._after = page["last"]
                event = self._snapshot(name, page["last"], self._now())
                yield event
                if self._is_last(event):
                    return
            for facts in page["events"]:
                event = ServiceEvent.model_validate(facts)
                self._after = event.seq
                yield event
                if to_end and self._is_last(event):
                    return
            if page["events"]:
                pause = POLL_S[0]
                continue
            if not to_end:
                return
            self._after = page["last"]
            time.sleep(pause)
            pause = min(1.5 * pause, POLL_S[1])

    def _now(self) -> Status:
        if isinstance(self._status, SweepStatus):
            return self._client.sweep(self._status.id)
        return self._client.job(self._status.id)


def parsed(pieces: Iterator[bytes]) -> Iterator[dict[str, str]]:
    """Yield the fields of each block of a stream, comments as an empty one.

    Lines end at LF alone: the service sends no CR, and U+2028 in a text ends no line.
    """
    rest = b""
    fields: dict[str, str] = {}
    for piece in pieces:
        *lines, rest = (rest + piece).split(b"\n")
        for line in lines:
            name, _, value = line.decode().partition(":")
            if line and name:
                fields[name] = value.removeprefix(" ")
            elif name == "" and line:
                yield {}
            else:
                yield fields
                fields = {}


def find(client: Client, name: str) -> Status:
    """Return the job, or else the sweep, of this id."""
    try:
        return client.job(name)
    except ServiceError as error:
        if error.code != "job_not_found":
            raise
    try:
        return client.sweep(name)
    except ServiceError as error:
        if error.code != "sweep_not_found":
            raise
    problem: dict[str, Any] = {"code": "not_found", "detail": f"no job or sweep has the id {name}"}
    raise ServiceError(problem, 404)
