"""What is counted in memory for whoever operates a service: histograms, and events by kind.

No library here: the HTTP service writes these in the text form of Prometheus.
"""

from __future__ import annotations

import bisect
import itertools
import threading
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

FAST_S = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5)
SLOW_S = (0.005, 0.025, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 300.0, 900.0)


class Histogram:
    """How often a value fell below each bound; any thread may observe."""

    def __init__(self, bounds: Sequence[float]) -> None:
        """Count below `bounds`, which rise."""
        self.bounds = tuple(bounds)
        self._counts = [0] * (len(self.bounds) + 1)
        self._sum = 0.0
        self._lock = threading.Lock()

    def observe(self, value: float, times: int = 1) -> None:
        """Count a value, `times` times over."""
        place = bisect.bisect_left(self.bounds, value)
        with self._lock:
            self._counts[place] += times
            self._sum += value * times

    def read(self) -> tuple[list[tuple[float, int]], float]:
        """Return (bound, values at most that large) up to infinity, and the sum of all values."""
        with self._lock:
            counts, total = list(self._counts), self._sum
        bounds = (*self.bounds, float("inf"))
        return list(zip(bounds, itertools.accumulate(counts), strict=True)), total


@dataclass
class Measures:
    """What one process has measured since it began."""

    writes: Histogram = field(default_factory=lambda: Histogram(FAST_S))  # wait and transaction
    claims: Histogram = field(default_factory=lambda: Histogram(FAST_S))  # recording one claim
    chunks: Histogram = field(default_factory=lambda: Histogram(SLOW_S))  # rendering one chunk
    merges: Histogram = field(default_factory=lambda: Histogram(SLOW_S))
    images: Histogram = field(default_factory=lambda: Histogram(SLOW_S))
    # Committed events by kind; "cached" counts jobs that a stored film answers.
    events: Counter[str] = field(default_factory=Counter)
    samples: int = 0  # of pixels, in accepted reports
    render_s: float = 0.0  # of render children, for these
    ended: Counter[str] = field(default_factory=Counter)  # claims without a result, by class
    child_ends: Counter[str] = field(default_factory=Counter)  # children, by class
