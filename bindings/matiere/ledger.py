"""The bias ledger: what no interval of the replicates can see, each with its count or size.

An interval tells how far the image may be from what its samples estimate. Samples that are cut,
dropped or absorbed change what they estimate, alike in every replicate; these are booked here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matiere.film import Film


# Of a stop by target_error: tests/bench/stopping_bias.py, table in docs/error.md.
STOPPING_BIAS = 0.001


@dataclass(frozen=True, slots=True)
class Entry:
    """One possible bias of a film."""

    name: str
    active: bool  # it was asked for, or it happened
    biased: bool  # it moves the mean of the image
    count: int | None  # how often it happened; None = not counted
    share: float | None  # count over samples
    relative_bias: float | None  # bound on its share of the mean radiance; None = not measured
    text: str


# Counted events that change the mean, by the names of the rejection table and of the counters.
_DROPPED = {
    "non_finite_sample": "directions or weights that are not finite were taken as no light",
    "non_finite_eval": "material values that are not finite were taken as no light",
    "non_finite_emission": "light radiance that is not finite was taken as no light",
    "non_finite_radiance": "path sums that are not finite were taken as black samples",
    "side_mismatch": "directions above the shading normal's horizon but below the surface's were "
    "absorbed: smoothed normals darken a coarse mesh at its edges",
}
_COUNTED = {
    "depth_guard": "paths were cut after 10,000 scattering events on surfaces or 16 million inside "
    "media",
    "interior_overflow": "entries into a ninth nested medium were taken as none",
    "unmatched_exits": "exits from a medium that was never entered, or none from one that scatters (open or "
    "inside-out meshes)",
}
_STOPPED = {
    "target_error": "the render stopped at the first look whose interval met the target, which "
    "favours looks that are a little too optimistic",
    "callback": "the callback decided when to stop; if it looked at the image or its error, that "
    "favours what it liked",
}


def ledger(film: Film) -> list[dict[str, Any]]:
    """Return every possible bias of a film as plain JSON values, the active ones first."""
    counters = film.core.counters
    entries = [
        *_asked_for(film),
        *_counted(counters, film.core.counters["samples"]),
        *_stopping(film.info.reason),
    ]
    return [asdict(entry) for entry in sorted(entries, key=lambda entry: not entry.active)]


def outside(rows: list[dict[str, Any]]) -> list[str]:
    """Return the active biases in sentences."""
    return [_sentence(row) for row in rows if row["active"]]


def _sentence(row: Mapping[str, Any]) -> str:
    amount = "" if not row["count"] else f"{row['count']} times ({100 * row['share']:.2g} % of "
    amount += "the samples): " if amount else ""
    size = row["relative_bias"]
    measured = "; size not measured" if size is None else f"; below {100 * size:.2g} % of the mean"
    return f"{row['name']}: {amount}{row['text']}{measured if row['biased'] else ''}"


def _asked_for(film: Film) -> list[Entry]:
    depth = film.info.max_depth
    if depth is None:
        cut = "there is no depth limit: Russian roulette ends paths without bias"
    else:
        events = "scattering event" if depth == 1 else "scattering events"
        cut = f"biased: light that takes more than {depth} {events} is missing"
    return [
        Entry("max_depth", depth is not None, depth is not None, None, None, None, cut),
        Entry("clamp", False, False, 0, 0.0, 0.0, "no sample is ever clamped"),
        Entry("threshold", False, False, 0, 0.0, 0.0, "no path is cut for being dim"),
    ]


def _counted(counters: Mapping[str, Any], samples: int) -> list[Entry]:
    counts = dict.fromkeys([*_DROPPED, *_COUNTED], 0)
    for row in counters["rejected"]:
        if row["cause"] in counts:
            counts[row["cause"]] += row["count"]
    for key in _COUNTED:
        counts[key] = counters[key]
    text = _DROPPED | _COUNTED
    found = []
    for name, n in counts.items():
        share = n / samples if samples else 0.0
        found.append(Entry(name, n > 0, n > 0, n, share, None if n else 0.0, text[name]))
    return found


def _stopping(reason: str) -> list[Entry]:
    active = reason in _STOPPED
    words = _STOPPED.get(reason, "the end of the render did not depend on the image")
    size = STOPPING_BIAS if reason == "target_error" else None if active else 0.0
    return [Entry("stopping", active, active, None, None, size, words)]
