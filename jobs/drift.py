"""Speed and error of two nights: ratios of the cells that both rendered, with their spread."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from matiere.jobs.job import JsonDict

HALF_95 = 0.98  # ranks around the median that hold it with 95 %: n / 2 -+ 0.98 sqrt(n)


def drift(pairs: Sequence[tuple[JsonDict, JsonDict]]) -> JsonDict:
    """Return how seconds and relMSE of the later night relate to the earlier one's, cell by cell.

    Seconds only of cells that both nights rendered themselves; relMSE at equal samples; both
    together as `efficiency`, 1 / (relMSE x seconds). Nothing here is a test: machines are noisy.
    """
    fresh = [(a, b) for a, b in pairs if not (a.get("cached") or b.get("cached"))]
    seconds = [(a["seconds"], b["seconds"]) for a, b in fresh]
    errors = [(a["relmse"], b["relmse"]) for a, b in pairs if a["spp"] == b["spp"]]
    work = [(_cost(b), _cost(a)) for a, b in fresh]
    return {
        "speed": {
            "seconds_a": float(sum(a for a, _ in seconds)),
            "seconds_b": float(sum(b for _, b in seconds)),
            **_ratio(seconds),
        },
        "error": _ratio(errors),
        "efficiency": _ratio(work),
    }


def _cost(row: JsonDict) -> float | None:
    return row["relmse"] * row["seconds"] if row["relmse"] and row["seconds"] else None


def _ratio(pairs: Sequence[tuple[Any, Any]]) -> JsonDict:
    """Return the median of b / a with its 95 % interval, and how many cells tell it."""
    ratios = np.sort([b / a for a, b in pairs if a and b and a > 0 and b > 0])
    count = len(ratios)
    if not count:
        return {"cells": 0, "median_ratio": None, "lower": None, "upper": None}
    reach = HALF_95 * np.sqrt(count)
    low, high = int(np.floor(count / 2 - reach)), int(np.ceil(count / 2 + reach)) - 1
    inside = low >= 0 and high < count  # fewer than six cells tell no interval
    return {
        "cells": count,
        "median_ratio": float(np.median(ratios)),
        "lower": float(ratios[low]) if inside and count > 5 else None,
        "upper": float(ratios[high]) if inside and count > 5 else None,
    }
