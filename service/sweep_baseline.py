"""How the cells of a sweep differ from its baseline: mean luminance, with what noise leaves open.

Cells of one seed see the same random numbers, replicate by replicate, so the noise that two cells
share cancels in the difference of their replicates; Student's t over these differences gives the
interval. A change of the image that leaves its mean alone is not seen here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

CONFIDENCE = 0.95
Change = tuple[float, float, float]  # percent of the baseline's mean luminance: estimate, interval


def changes(reports: Mapping[int, Mapping[str, Any]], baseline: int | None) -> dict[int, Change]:
    """Return the change of every cell whose report can be paired with the baseline's."""
    base = None if baseline is None else _replicates(reports.get(baseline, {}))
    if base is None:
        return {}
    found = {}
    for cell, report in reports.items():
        mine = _replicates(report)
        alike = report.get("seeds") == reports[baseline or 0].get("seeds")
        if alike and cell != baseline and mine is not None and len(mine) == len(base):
            found[cell] = _change(base, mine)
    return found


def _replicates(report: Mapping[str, Any]) -> list[float] | None:
    """Return the mean luminance of every replicate; None where they are not independent."""
    values = (report.get("image") or {}).get("replicate_luminance")
    if not values or len(values) < 2 or sum(values) <= 0.0 or report.get("adaptive"):
        return None
    return list(values)


def _change(base: list[float], mine: list[float]) -> Change:
    from matiere import _core

    n = len(base)
    mean = sum(base) / n
    ratio = sum(mine) / sum(base)
    # The ratio of two means to first order (delta method): residuals of mine - ratio * base.
    rest = [b - ratio * a for a, b in zip(base, mine, strict=True)]
    error = math.sqrt(sum(r * r for r in rest) / (n * (n - 1))) / mean
    half = float(_core.student_quantile(0.5 * (1.0 - CONFIDENCE), n - 1)) * error
    return (100.0 * (ratio - 1.0), 100.0 * (ratio - 1.0 - half), 100.0 * (ratio - 1.0 + half))
