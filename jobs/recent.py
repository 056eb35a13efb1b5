"""Values that were read since the last commit, so that many who poll cost one reading."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future
from typing import Generic, TypeVar

T = TypeVar("T")
MOST = 1024
FRESH_S = 0.5  # ages and priorities rise without a commit


class Recent(Generic[T]):
    """A cache that every commit empties; `version` is a number that every commit raises.

    Where other processes write too there is no such number: give no `version`, nothing is kept.
    """

    def __init__(self, version: Callable[[], int] | None) -> None:
        """Start empty."""
        self._version = version
        self._values: OrderedDict[str, tuple[float, T]] = OrderedDict()
        self._of = -1  # the version that all values are of
        self._flights: dict[tuple[int, str], Future[T]] = {}  # readings that others wait for
        self._lock = threading.Lock()

    def peek(self, key: str) -> T | None:
        """Return the value of `key` if it is known, without reading or waiting."""
        if self._version is None:
            return None
        version, now = self._version(), time.monotonic()
        with self._lock:
            at, value = self._values.get(key, (0.0, None))
            return value if self._of == version and now - at < FRESH_S else None

    def get(self, key: str, read: Callable[[], T]) -> T:
        """Return the value of `key`, by `read` unless it is known; what `read` raises is raised."""
        if self._version is None:
            return read()
        version, now = self._version(), time.monotonic()  # before reading: a commit may follow
        with self._lock:
            if self._of == version and key in self._values:
                at, value = self._values[key]
                if now - at < FRESH_S:
                    return value
            flight = self._flights.get((version, key))
            if flight is None:
                mine = self._flights[version, key] = Future()
        if flight is not None:
            return flight.result()
        try:
            value = read()
        except BaseException as error:
            mine.set_exception(error)
            raise
        else:
            mine.set_result(value)
            self._keep(version, key, (now, value))
            return value
        finally:
            with self._lock:
                del self._flights[version, key]

    def _keep(self, version: int, key: str, entry: tuple[float, T]) -> None:
        with self._lock:
            if version > self._of:
                self._values.clear()
                self._of = version
            if version == self._of:
                self._values[key] = entry
                self._values.move_to_end(key)
                if len(self._values) > MOST:
                    self._values.popitem(last=False)
