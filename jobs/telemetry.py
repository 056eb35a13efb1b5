"""What the scheduler tells of its work: measured, logged with ids, and as spans of a trace.

`tracing.record` does nothing until `tracing.enable` was called, which imports OpenTelemetry.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from matiere.jobs import tracing
from matiere.jobs.measure import Measures

if TYPE_CHECKING:
    from matiere.jobs.film_work import FilmWork
    from matiere.jobs.slots import Held
    from matiere.jobs.store.films import Loss

log = logging.getLogger("matiere.jobs.work")
MOST_IDS = 8  # of jobs that one line names


class Telemetry:
    """Lives in the scheduler thread."""

    def __init__(self, measures: Measures) -> None:
        """Add to `measures`."""
        self._m = measures

    def claimed(self, held: Held, child: str, begun: float) -> None:
        """Tell of a claim that was recorded and given to a child."""
        self._m.claims.observe(time.monotonic() - begun)
        if log.isEnabledFor(logging.DEBUG):
            log.debug("attempt %d given to %s", held.token, child, extra=_ids(held, (), child))

    def rendered(self, held: Held, film: FilmWork, body: dict[str, Any], child: str) -> None:
        """Tell of chunks that were rendered and accepted."""
        jobs, count = [job.id for job in film.jobs], max(1, len(held.chunks))
        self._count(held, body["render_s"], count)
        _rendered(held, jobs, child, body)

    def rendered_films(self, held: Held, body: dict[str, Any]) -> None:
        """Tell of a batch of small films that was rendered and accepted."""
        jobs = [job.id for film in held.detail.values() for job in film.jobs]
        count = sum(film["rendered_chunks"] for film in body["films"])
        self._count(held, body["render_s"], max(1, count))
        _rendered(held, jobs, "", body)

    def _count(self, held: Held, seconds: float, chunks: int) -> None:
        self._m.chunks.observe(seconds / chunks, chunks)
        self._m.samples += held.samples
        self._m.render_s += seconds

    def lost(self, held: Held, loss: Loss, jobs: Sequence[str]) -> None:
        """Tell of a claim that ended without a result."""
        counts = loss.state in ("failed", "lost")
        kind = loss.error_class or loss.state if counts else loss.state
        self._m.ended[kind] += 1
        level = logging.INFO if loss.state in ("cancelled", "void") else logging.WARNING
        words = f": {loss.message}" if loss.message else ""
        log.log(
            level,
            "attempt %d ended as %s (%s)%s", held.token, loss.state, kind, words,
            extra=_ids(held, jobs, ""),
        )  # fmt: skip
        for job in jobs[:1]:
            tracing.record("claim", job, time.monotonic() - held.sent, error=kind,
                           attempt=held.token)  # fmt: skip

    def films_lost(self, held: Held, state: str, kind: str) -> None:
        """Tell of a batch of small films that ended without a result."""
        self._m.ended[kind or state] += 1
        jobs = [job.id for film in (held.detail or {}).values() for job in film.jobs]
        log.info("attempt %d of %d small films ended as %s", held.token, len(held.detail or {}),
                 state, extra=_ids(held, jobs, ""))  # fmt: skip

    def utility(self, name: str, jobs: Sequence[str], seconds: float) -> None:
        """Tell of what the utility child did: a `merge`, or `images`."""
        if name not in ("merge", "images"):
            return
        (self._m.merges if name == "merge" else self._m.images).observe(seconds)
        log.debug("%s took %.3f s", name, seconds, extra={"job": list(jobs[:MOST_IDS])})
        for job in jobs[:1]:
            tracing.record(name, job, seconds)


def _rendered(held: Held, jobs: Sequence[str], child: str, body: dict[str, Any]) -> None:
    seconds = time.monotonic() - held.sent
    if log.isEnabledFor(logging.INFO):
        log.info("attempt %d rendered in %.3f s", held.token, body["render_s"],
                 extra=_ids(held, jobs, child))  # fmt: skip
    for job in jobs[:1]:
        tracing.record("claim", job, seconds, attempt=held.token, render_s=body["render_s"])


def _ids(held: Held, jobs: Sequence[str], child: str) -> dict[str, Any]:
    """Return what a line of the log names: jobs, attempt, chunks as [first, last], child."""
    found: dict[str, Any] = {"attempt": held.token}
    if jobs:
        found["job"] = list(jobs[:MOST_IDS])
    if held.chunks:
        found["chunk"] = [held.chunks[0], held.chunks[-1]]
        found["film"] = held.film_id
    if child:
        found["child"] = child
    return found
