"""What time alone brings about, looked at by the scheduler thread: deadlines and limits."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from matiere.jobs import procfs
from matiere.jobs.children import Child
from matiere.jobs.film_work import FilmWork
from matiere.jobs.store import control, films

if TYPE_CHECKING:
    from matiere.jobs.scheduler import Scheduler

LOOK_S = 0.5  # between two looks at the deadlines
CHILDREN_SHARE = 0.75  # of the memory, for all children together
MIB = 2**20


class Warden:
    """Keeps the deadlines of jobs and the limits of children."""

    def __init__(self, scheduler: Scheduler) -> None:
        """Watch the jobs and children of `scheduler`."""
        self._scheduler = scheduler
        self._looked = 0.0
        #: What all children may use together.
        self.all_bytes = int(CHILDREN_SHARE * procfs.usable_memory())

    @property
    def data_limit(self) -> int:
        """RLIMIT_DATA of a child: its allocations fail there, so that it can say so itself."""
        return self._scheduler.options.child_memory_bytes or self.all_bytes

    def look(self, now: float) -> None:
        """End what is over its time or memory; `now` is monotonic, deadlines are wall clock."""
        self._limits(now)
        if now - self._looked < LOOK_S:
            return
        self._looked = now
        db = self._scheduler.db
        for job_id, film_id in db.read(lambda c: control.due(c, time.time())):
            if db.write(control.expire_job, job_id):
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
        s.films[film_id].late[job_id] = control.DEADLINE
        s.wake()

    # -- limits ---------------------------------------------------------------------------------
    def _limits(self, now: float) -> None:
        options = self._scheduler.options
        slots = (*self._scheduler.slots, self._scheduler.utility.slot)
        alive = [s.child for s in slots if s.child and not s.child.killed and not s.child.remote]
        sizes = {child: procfs.rss_bytes(child.pid) for child in alive}
        kills = procfs.oom_kills()
        for child, size in sizes.items():
            limit = options.child_memory_bytes
            if limit and size > limit:
                words = f"it used {size // MIB} MiB of memory; a child may use {limit // MIB} MiB"
                child.kill(cause=("memory_limit", words))
            elif self._works_too_long(child, now):
                words = f"it worked on one claim for more than {options.claim_limit_s:g} s"
                child.kill(cause=("time_limit", words))
            else:
                child.oom_kills = kills
        if sum(sizes.values()) > self.all_bytes:
            largest = max(alive, key=lambda child: sizes[child])
            words = (
                f"all children together used more than {self.all_bytes // MIB} MiB, this one "
                f"{sizes[largest] // MIB} MiB; fewer --children leave more for each"
            )
            largest.kill(cause=("memory_limit", words))

    def _works_too_long(self, child: Child, now: float) -> bool:
        """Tell whether the claim at work, the oldest that the child holds, is over its time."""
        first = next(iter(child.inflight), None)
        if first != child.working:
            child.working, child.working_since = first, now
        return first is not None and now - child.working_since > (
            self._scheduler.options.claim_limit_s
        )
