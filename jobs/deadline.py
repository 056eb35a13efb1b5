"""Deadlines: seconds from the submission, or a moment as RFC 3339 writes it."""

from __future__ import annotations

import math
from datetime import datetime

from matiere.errors import Fault, SceneValidationError

LONGEST_S = 10 * 366 * 86400.0
POINTER = "/deadline"


def parse(value: float | str | None, now: float) -> float | None:
    """Return a deadline as Unix seconds. Raises SceneValidationError, with its pointer."""
    if value is None:
        return None
    moment = _moment(value) if isinstance(value, str) else now + float(value)
    if not math.isfinite(moment) or moment - now > LONGEST_S:
        raise _fault("out_of_range", f"{value!r} is more than ten years away")
    if moment <= now:
        raise _fault("out_of_range", f"{value!r} has passed; name a moment to come")
    return moment


def _moment(text: str) -> float:
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        moment = None
    if moment is None or moment.tzinfo is None:
        example = "2026-11-24T06:00:00Z or 2026-11-24T07:00:00+01:00"
        why = f"{text!r} is no moment with its time zone, such as {example}"
        raise _fault("bad_time", why)
    return moment.timestamp()


def _fault(code: str, why: str) -> SceneValidationError:
    return SceneValidationError([Fault(POINTER, code, f"the deadline {why}")])
