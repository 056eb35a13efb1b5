"""Figures and states as the page writes them: with units, in plain words."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

MINUTE, HOUR, DAY = 60.0, 3600.0, 86400.0

STATES: Mapping[str, str] = {
    "queued": "waits for its turn",
    "running": "is being rendered",
    "paused": "held back; its samples are kept",
    "succeeded": "done",
    "unfinished": "left above the target error by the budget of its sweep",
    "failed": "ended without an image",
    "cancelled": "stopped on request",
    "expired": "stopped by its deadline",
}

EVENTS: Mapping[str, str] = {
    "queued": "queued",
    "running": "rendering began",
    "succeeded": "done",
    "unfinished": "the budget of its sweep was spent",
    "failed": "failed",
    "cancelled": "cancelled",
    "expired": "stopped by its deadline",
    "paused": "paused",
    "resumed": "resumed",
    "priority": "priority changed",
}


def number(value: float | None, digits: int = 3) -> str:
    """Return a figure with some significant digits; a dash where it is unknown."""
    if value is None:
        return "unknown"
    if isinstance(value, int):
        return f"{value:,}"
    return _plain(f"{value:.{digits}g}")


def _plain(text: str) -> str:
    """Return 6.6e-05 as 6.6e-5."""
    mantissa, mark, exponent = text.partition("e")
    return f"{mantissa}e{int(exponent)}" if mark else text


def interval(pair: Sequence[float] | None) -> str:
    """Return an interval in words, or nothing."""
    return "" if pair is None else f"{number(pair[0])} to {number(pair[1])}"


def seconds(value: float | None) -> str:
    """Return a duration as people say it."""
    if value is None:
        return "unknown"
    if value < 10:
        return f"{value:.2g} s" if value < 1 else f"{value:.1f} s"
    if value < 2 * MINUTE:
        return f"{value:.0f} s"
    if value < 2 * HOUR:
        minutes, rest = divmod(round(value), 60)
        return f"{minutes} min {rest} s" if minutes < 10 else f"{value / MINUTE:.0f} min"
    return f"{value / HOUR:.0f} h" if value < 2 * DAY else f"{value / DAY:.0f} days"


def size(count: float) -> str:
    """Return bytes in decimal units."""
    for unit in ("B", "kB", "MB", "GB"):
        if count < 1000:
            return f"{count:.3g} {unit}" if unit != "B" else f"{count:.0f} B"
        count /= 1000
    return f"{count:.3g} TB"


def moment(when: datetime | float | None) -> str:
    """Return a moment in UTC, to the second."""
    if when is None:
        return ""
    at = when if isinstance(when, datetime) else datetime.fromtimestamp(when, UTC)
    return at.strftime("%Y-%m-%d %H:%M:%S UTC")


def ago(when: datetime | float | None) -> str:
    """Return how long ago a moment was."""
    if when is None:
        return ""
    then = when.timestamp() if isinstance(when, datetime) else when
    passed = time.time() - then
    if abs(passed) < 5:
        return "just now"
    units = ((2 * DAY, DAY, "days"), (HOUR, HOUR, "h"), (MINUTE, MINUTE, "min"), (0, 1.0, "s"))
    size, name = next((size, name) for least, size, name in units if abs(passed) >= least)
    told = f"{int(abs(passed) / size)} {name}"  # nobody counts the seconds of a minute ago
    return f"{told} ago" if passed >= 0 else f"in {told}"


def stop_rule(stop: Mapping[str, Any]) -> str:
    """Return when a job ends, in words."""
    parts = []
    if stop.get("spp"):
        parts.append(f"{stop['spp']:,} samples per pixel")
    if stop.get("seconds"):
        parts.append(f"{seconds(stop['seconds'])} of rendering")
    if target := stop.get("target_error"):
        parts.append(target_error(target))
    return " or ".join(parts) if parts else "the samples of the scene"


def target_error(target: Mapping[str, Any]) -> str:
    """Return an error target in words."""
    kind, value = next(iter(target.items()))
    if kind == "relmse":
        return f"relMSE {number(value)}"
    if kind == "rmse_percent":
        return f"RMSE {number(value)} % of the mean"
    steps = value.get("code_values", 1)
    share = value.get("pixels_percent", 95)
    return f"{share:g} % of the pixels within {steps:g} code value{'s' if steps != 1 else ''}"


def parameters(values: Mapping[str, Any]) -> str:
    """Return the values of a sweep cell in a line."""
    texts = (f"{key} {short(value)}" for key, value in values.items())
    return ", ".join(texts)


def short(value: Any) -> str:
    """Return a JSON value in a few characters."""
    if isinstance(value, bool) or value is None:
        return str(value).lower() if value is not None else "none"
    if isinstance(value, int | float):
        return number(value, 4)
    if isinstance(value, Mapping):
        named = value.get("label") or value.get("type") or value.get("metal")
        return str(named) if named else f"{len(value)} values"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "(" + ", ".join(short(item) for item in value) + ")"
    return str(value)


def name_of(job: Any) -> str:
    """Return what a person would call a job."""
    if job.label:
        return str(job.label)
    if job.parameters:
        return parameters(job.parameters)
    return f"Job {job.id[-6:]}"


def reason(stop_reason: str | None) -> str:
    """Return why a job ended."""
    words = {
        "spp": "the samples asked for are done",
        "seconds": "the render time asked for is used",
        "target_error": "the error target is reached",
        "deadline": "its deadline came",
        "budget": "the render time that its sweep shares is used",
    }
    return words.get(stop_reason or "", stop_reason or "")
