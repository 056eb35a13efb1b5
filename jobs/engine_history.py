"""The part of `Engine` that tells what was done for a job: its claims, and its log."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from matiere.jobs.job import Event, Job
from matiere.jobs.store import events, history, views
from matiere.jobs.store.history import Attempt

if TYPE_CHECKING:
    from matiere.jobs.store.database import Database

LINES = 2000  # newest events and claims that a log tells


class EngineHistory:
    """Methods of `Engine`."""

    _db: Database

    def attempts(
        self, job_id: str, *, after: int = 0, limit: int = 100, newest: bool = False
    ) -> list[Attempt]:
        """Return claims of a job's film with tokens above `after`, in order, or the `newest`.

        Those of cells that are rendered together are told as long as their file is kept. Raises
        `JobNotFound`.
        """
        return self._db.read(
            lambda c: history.attempts(c, job_id, after=after, limit=limit, newest=newest)
        )

    def log(self, job_id: str, most_bytes: int) -> str:
        """Return the end of a job's log, whole lines of at most `most_bytes`.

        It tells what happened, in order, and what render processes printed meanwhile. Raises
        `JobNotFound`.
        """

        def read(c: Any) -> tuple[Job, list[Event], list[Attempt]]:
            job = views.get_job(c, job_id)
            told = events.read_history(c, job_id, LINES)
            return job, told, history.attempts(c, job_id, limit=LINES, newest=True)

        job, told, attempts = self._db.read(read)
        entries = [(event.time, _of_event(event)) for event in told]
        entries += [entry for attempt in attempts for entry in _of_attempt(attempt)]
        if job.error is not None and job.error.log_tail and not any(a.printed for a in attempts):
            entries.append((job.finished or 0.0, ["last lines of its process:",
                                                  *_quoted(job.error.log_tail)]))  # fmt: skip
        entries.sort(key=lambda entry: entry[0])
        return _tail(
            [f"{_moment(at)} {lines[0]}\n" + "".join(f"    {line}\n" for line in lines[1:])
             for at, lines in entries],
            most_bytes,
        )  # fmt: skip


def _of_event(event: Event) -> list[str]:
    data = event.data.items()
    facts = {key: value for key, value in data if value not in (None, "") and value is not False}
    message = facts.pop("message", None)
    line = " ".join([event.kind, *(f"{key}={_short(value)}" for key, value in facts.items())])
    return [f"{line}: {message}" if message else line]


def _of_attempt(attempt: Attempt) -> list[tuple[float, list[str]]]:
    what = f"{attempt.chunks} chunks" if attempt.chunks else f"{attempt.films} films together"
    name = f"claim {attempt.token}"
    begun = (attempt.started, [f"{name} begun: {what}, process {attempt.pid}"])
    if attempt.ended is None:
        return [begun]
    line = f"{name} {attempt.state} after {attempt.ended - attempt.started:.2f} s"
    if attempt.error_class:
        line += f" ({attempt.error_class}): {attempt.message or ''}".rstrip(": ")
    return [begun, (attempt.ended, [line, *_quoted(attempt.printed)])]


def _quoted(printed: str) -> list[str]:
    """Return printed lines without what a terminal would obey."""
    return [
        "| " + "".join(c if c.isprintable() else " " for c in line) for line in printed.splitlines()
    ]


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _moment(at: float) -> str:
    return datetime.fromtimestamp(at, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _tail(entries: list[str], most: int) -> str:
    """Return the last of the entries that fit, or the end of the last one."""
    kept: list[str] = []
    room = most
    for text in reversed(entries):
        room -= len(text.encode())
        if room < 0:
            break
        kept.append(text)
    if not kept and entries:
        return entries[-1].encode()[-most:].decode(errors="ignore")
    return "".join(reversed(kept))
