"""What happened, in order: the part of `Engine` that tells events and waits for changes.

Events are numbered inside the transaction that makes the change, and write transactions follow one
another, so they become visible in the order of their numbers: who has read up to N and asks for
more than N misses nothing and reads nothing twice.
"""

from __future__ import annotations

import threading
import time
from abc import ABC
from collections.abc import Callable
from typing import Any, TypeVar

from matiere.jobs.job import Event, Job, Sweep
from matiere.jobs.store import events, views
from matiere.jobs.store.database import Database

T = TypeVar("T")
POLL_S = 0.05
SHARED_POLL_S = 0.5


class Feed(ABC):
    """Events, and waiting for them."""

    _db: Database
    _closed: bool

    def _follow(self) -> None:
        """Prepare; call it before the first commit."""
        self._version = 0
        self._changed = threading.Condition()
        self._watchers: tuple[Callable[[], None], ...] = ()

    def events(
        self,
        after: int = 0,
        *,
        job_id: str | None = None,
        sweep_id: str | None = None,
        limit: int = 500,
        wait_s: float = 0.0,
    ) -> list[Event]:
        """Return events with `seq > after`, waiting up to `wait_s` for the first."""
        end = time.monotonic() + wait_s
        while True:
            version = self._version
            found = self._db.read(lambda c: events.read_events(c, after, job_id, sweep_id, limit))
            left = end - time.monotonic()
            if found or left <= 0 or self._closed:
                return found
            self._await_change(version, left)

    def history(self, job_id: str, limit: int = 400) -> list[Event]:
        """Return the newest events of a job, oldest first, without `progress`."""
        return self._db.read(lambda c: events.read_history(c, job_id, limit))

    def event_range(self) -> tuple[int, int]:
        """Return the numbers of the oldest and the newest event that are kept; 0, 0 if none is."""
        return self._db.read(events.kept)

    def snapshot(
        self, *, job_id: str | None = None, sweep_id: str | None = None
    ) -> tuple[int, Job | Sweep | dict[str, int]]:
        """Return the number of the newest event, and a job or sweep as it stands after it.

        Without an id: the number of jobs in every state. Raises `JobNotFound`.
        """

        def read(c: Any) -> tuple[int, Job | Sweep | dict[str, int]]:
            newest = events.kept(c)[1]
            if job_id is not None:
                return newest, views.get_job(c, job_id)
            if sweep_id is not None:
                return newest, views.get_sweep(c, sweep_id)
            return newest, views.counts(c)

        return self._db.read(read)

    def watch(self, callback: Callable[[], None]) -> Callable[[], None]:
        """Call `callback` after every commit of this process; return what ends that.

        It runs in the writer thread: it must be short and raise nothing.
        """
        with self._changed:
            self._watchers = (*self._watchers, callback)

        def end() -> None:
            with self._changed:
                self._watchers = tuple(w for w in self._watchers if w is not callback)

        return end

    # -- inside -------------------------------------------------------------------------------
    def _notify(self) -> None:
        with self._changed:
            self._version += 1
            self._changed.notify_all()
            watchers = self._watchers
        for callback in watchers:
            callback()

    def _await_change(self, version: int, timeout_s: float) -> None:
        if self._db.shared:  # another process may make the change
            timeout_s = min(timeout_s, SHARED_POLL_S)
        with self._changed:
            self._changed.wait_for(lambda: self._version != version, timeout_s)

    def _wait(self, get: Callable[[], T], done: Callable[[T], bool], timeout_s: float | None) -> T:
        end = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            version = self._version
            value = get()
            left = 1.0 if end is None else end - time.monotonic()
            if done(value) or left <= 0 or self._closed:
                return value
            self._await_change(version, min(1.0, left))
            time.sleep(min(POLL_S, left))  # a busy queue commits often
