"""The bias ledger: what no interval of the replicates can see, each with its count or size.

An interval tells how far the image may be from what its samples estimate. Samples that are cut,
dropped or absorbed change what they estimate, alike in every replicate; these are booked here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
    relative_bias: float | None  # share of the mean radiance, or a bound on it; None = not measured
    text: str
    standard_error: float | None = None  # of relative_bias, where that is an estimate
    radiance: tuple[float, ...] | None = None  # what is missing, mean over all pixels, W/m^2/sr
    radiance_error: tuple[float, ...] | None = None  # its standard error


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
    "unmatched_exits": "exits from a medium that was never entered, or none from one that scatters "
    "(open or inside-out meshes)",
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
        _hidden(film),
    ]
    return [asdict(entry) for entry in sorted(entries, key=lambda entry: not entry.active)]


def outside(rows: list[dict[str, Any]]) -> list[str]:
    """Return the active biases in sentences."""
    return [_sentence(row) for row in rows if row["active"]]


def _sentence(row: Mapping[str, Any]) -> str:
    amount = "" if not row["count"] else f"{row['count']} times ({100 * row['share']:.2g} % of "
    amount += "the samples): " if amount else ""
    size = row["relative_bias"]
    if size is None:
        measured = "; size not measured"
    elif row["standard_error"] is None:
        measured = f"; below {100 * size:.2g} % of the mean"
    else:
        measured = f"; {100 * size:.2g} % of the mean is missing, standard error "
        measured += f"{100 * row['standard_error']:.2g} %"
    return f"{row['name']}: {amount}{row['text']}{measured if row['biased'] else ''}"


def _asked_for(film: Film) -> list[Entry]:
    depth, threshold = film.info.max_depth, film.info.threshold
    deep = "there is no depth limit: Russian roulette ends paths without bias"
    if depth is not None:
        events = "scattering event" if depth == 1 else "scattering events"
        deep = f"biased: light that takes more than {depth} {events} is missing"
    dim = "no path is cut for being dim"
    if threshold is not None:
        dim = f"biased: what paths would bring whose throughput fell below {threshold:g} is missing"
    return [
        _cut(film, "max_depth", depth is not None, deep),
        Entry("clamp", False, False, 0, 0.0, 0.0, "no sample is ever clamped"),
        _cut(film, "threshold", threshold is not None, dim),
    ]


def _cut(film: Film, name: str, asked: bool, text: str) -> Entry:
    """Return what paths that were followed beyond a limit say about it."""
    if not asked:
        return Entry(name, False, False, 0, 0.0, 0.0, text)
    cut, samples = film.core.cut_energy(name), film.core.counters["samples"]
    share = cut["paths"] / samples if samples else 0.0
    mean = float(film.mean[..., :3].mean())
    known = cut["followed"] > 0 and mean > 0
    return Entry(
        name,
        True,
        True,
        cut["paths"],
        share,
        sum(cut["radiance"]) / 3 / mean if known else None if cut["paths"] else 0.0,
        text,
        _together(cut["standard_error"]) / mean if known else None,
        tuple(cut["radiance"]),
        tuple(cut["standard_error"]),
    )


def _together(errors: Sequence[float]) -> float:
    """Return the standard error of the channels' mean: they rise and fall together at worst."""
    return sum(errors) / 3


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


def _hidden(film: Film) -> Entry:
    from matiere import light_layer

    text = light_layer.missing(film)
    there = "every path that carries light can be found"
    return Entry(
        "hidden_light", bool(text), bool(text), None, None, None if text else 0.0, text or there
    )
