"""Render seconds that the cells of a sweep share: what is asked for, and who gets the next.

All cells are to reach one target error. The next samples go to the cell whose error is furthest
above it; a cell that even all seconds left would not bring there waits until the others have what
they need. So whatever can be finished is, and near the end the worst cell is made better. Which
cell gets how many samples depends on time; what a cell looks like with so many does not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from matiere.errors import Fault, RenderError
from matiere.jobs.job import JsonDict

STOP_KEYS = ("spp", "seconds", "target_error")
KEYS = ("seconds", "target_error")
LONGEST_S = 10 * 366 * 86400.0
MOST_AHEAD = 4.0  # times its samples that a cell gets before its error is looked at again
CAUTION = 0.8  # of what its error asks for: the estimate may be too high


@dataclass(frozen=True)
class Wish:
    """A cell that has not reached the target of its sweep."""

    film_id: int
    geometry_key: str
    width: int
    height: int
    replicates: int
    spp: int  # merged
    seconds: float  # of its film so far
    pixel_samples: int
    share: float | None  # of the samples to the target that are done; None: not known


def parse_budget(raw: Any) -> tuple[JsonDict | None, list[Fault]]:
    """Check the `budget` of a sweep; return it, or faults."""
    if not isinstance(raw, Mapping):
        why = "budget is an object with 'seconds' and 'target_error'"
        return None, [Fault("/budget", "wrong_type", why)]
    faults = [
        Fault(f"/budget/{key}", "unknown_key", f"a budget has {' and '.join(KEYS)}, no {key!r}")
        for key in sorted(set(raw) - set(KEYS))
    ]
    faults += [
        Fault(f"/budget/{key}", "missing_key", f"a budget has {' and '.join(KEYS)}")
        for key in KEYS
        if key not in raw
    ]
    seconds, target = raw.get("seconds", 1.0), raw.get("target_error", {"relmse": 1.0})
    number = isinstance(seconds, int | float) and not isinstance(seconds, bool)
    if not number or not 0.0 < seconds <= LONGEST_S:
        why = f"seconds is a positive number, at most ten years, not {seconds!r}"
        faults.append(Fault("/budget/seconds", "out_of_range", why))
    try:
        target = _target(target)
    except RenderError as error:
        at = (error.pointer or "").replace("/render", "/budget", 1) or "/budget/target_error"
        faults.append(Fault(at, error.code, error.message))
    return (None, faults) if faults else ({"seconds": seconds, "target_error": target}, [])


def _target(raw: Any) -> JsonDict:
    from matiere import target

    if not isinstance(raw, Mapping):
        why = f"target_error is an object such as {{'relmse': 0.001}}, not {raw!r}"
        raise RenderError(why, code="wrong_type", pointer="/render/target_error")
    return target.check(raw)


def need_s(wish: Wish) -> float:
    """Return the render seconds that a cell still needs, as its error falls with its samples."""
    if not wish.share:
        return math.inf
    return max(1.0 / wish.share - 1.0, 0.0) * wish.seconds


def in_turn(wishes: Sequence[Wish], left_s: float) -> list[Wish]:
    """Return cells in the order in which they are to get samples."""

    def place(wish: Wish) -> tuple[int, float, int]:
        if wish.spp == 0:
            return 0, 0.0, wish.film_id  # nothing is known of it yet
        if wish.share is None:
            return 3, float(wish.spp), wish.film_id  # its error cannot be estimated (a black image)
        return 1 if need_s(wish) <= left_s else 2, wish.share, wish.film_id

    return sorted(wishes, key=place)


def ahead(wish: Wish) -> float:
    """Return to how many times its samples a cell may go before the next look at its error."""
    if not wish.share:
        return 1.0
    return min(max(CAUTION / wish.share, 1.0), MOST_AHEAD)
