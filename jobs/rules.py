"""How long results and films are kept."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Rules:
    """How long things stay; `film_bytes` None: the lesser of 50 GB and half the free disk."""

    result_days: float = 30.0
    film_bytes: int | None = None
    grace_hours: float = 24.0
    min_free_bytes: int = 2 * 10**9  # below so much free disk no new work is begun
    events_kept: int = 500_000  # for clients that resume
