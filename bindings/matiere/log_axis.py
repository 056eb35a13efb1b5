"""A logarithmic axis of a plot: where values lie on it, and which are labelled."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

FEWEST_LABELS = 2


@dataclass(frozen=True)
class LogAxis:
    """Values from `low` to `high`, both positive, onto pixels `start` to `end`."""

    low: float
    high: float
    start: float
    end: float

    @classmethod
    def around(
        cls, values: Sequence[float], start: float, end: float, *, margin: float = 0.04
    ) -> LogAxis:
        """Return an axis that holds `values`, with this share of its length free at both ends."""
        low, high = min(values), max(values)
        pad = max((high / low) ** margin, 1.0 + margin / 2)
        if high / low < 3:  # a single look still gets readable ticks
            pad = max(pad, math.sqrt(3 * low / high))
        return cls(low / pad, high * pad, start, end)

    def at(self, value: float) -> float:
        """Return the pixel of a value."""
        share = math.log(value / self.low) / math.log(self.high / self.low)
        return self.start + share * (self.end - self.start)

    def ticks(self) -> list[tuple[float, bool]]:
        """Return (value, labelled): decades on long axes, 1, 2, 5 or every digit on short ones."""
        found = [
            (digit, digit * 10.0**exponent)
            for exponent in range(
                math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1
            )
            for digit in range(1, 10)
            if self.low <= digit * 10.0**exponent <= self.high * (1 + 1e-12)
        ]
        decades = math.log10(self.high / self.low)
        labelled: Sequence[int] = (1, 2, 5) if decades <= 2.5 else (1,)
        if sum(digit in labelled for digit, _ in found) < FEWEST_LABELS:
            labelled = range(1, 10)
        return [(value, digit in labelled) for digit, value in found]
