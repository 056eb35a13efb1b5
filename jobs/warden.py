"""What time alone brings about, looked at by the scheduler thread: deadlines and limits."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from matiere.jobs.film_work import FilmWork
from matiere.jobs.store import control, films

if TYPE_CHECKING:
    from matiere.jobs.scheduler import Scheduler

LOOK_S = 0.5  # between two looks at the deadlines


class Warden:
    """Keeps the deadlines of jobs."""

    def __init__(self, scheduler: Scheduler) -> None:
        """Watch the jobs of `scheduler`."""
        self._scheduler = scheduler
        self._looked = 0.0

    def look(self, now: float) -> None:
        """End jobs that are late; `now` is monotonic, deadlines are of the wall clock."""
        if now - self._looked < LOOK_S:
            return
        self._looked = now
        db = self._scheduler.db
        for job_id, film_id in db.read(lambda c: control.due(c, time.time())):
            if db.write(lambda c, i=job_id: control.expire_job(c, i)):  # type: ignore[misc]
                self._scheduler.health.counters["jobs_expired"] += 1
                self._scheduler.wake()
                self._scheduler.utility.sweeps_may_have_ended()
            else:
                self._end_with_round(job_id, film_id, now)

    def _end_with_round(self, job_id: str, film_id: int, now: float) -> None:
        s = self._scheduler
        if film_id not in s.films:
            row = s.db.read(lambda c: films.load_film(c, film_id))
            s.films[film_id] = FilmWork(row, s.work, now)
        s.films[film_id].late.add(job_id)
        s.wake()
