"""What an operator watches: the part of `Engine` that says what it measured and what is now."""

from __future__ import annotations

import shutil
import time
from abc import ABC
from dataclasses import dataclass
from pathlib import Path

from matiere.jobs import procfs
from matiere.jobs.measure import Measures
from matiere.jobs.scheduler import Scheduler
from matiere.jobs.store import gauges
from matiere.jobs.store.database import Database


@dataclass(frozen=True)
class Gauge:
    """What is now; ages in seconds."""

    jobs: dict[str, int]  # that have not ended, by state
    queue: list[tuple[int, int, float]]  # priority, jobs that wait, age of the oldest
    cells: int  # of sweeps, without a job yet
    children: list[tuple[str, bool, int, int]]  # name, ready, claims held, resident bytes
    utility_waiting: int  # merges, images, sheets, nights, questions
    store_bytes: int
    disk_free_bytes: int
    disk_low: bool
    draining: bool
    scheduling: bool
    counters: dict[str, int]


class Gauges(ABC):
    """Measurements."""

    _db: Database
    _scheduler: Scheduler
    data_dir: Path

    @property
    def measures(self) -> Measures:
        """What this process has measured since it began."""
        return self._db.measures

    def gauge(self) -> Gauge:
        """Look at what is now: a few counts along indexes, /proc, the free disk."""
        jobs, queue, cells = self._db.read(gauges.look)
        s, now = self._scheduler, time.time()
        children = []
        for slot in (*s.slots, s.utility.slot):
            child = slot.child
            rss = procfs.rss_bytes(child.pid) if child else 0
            held = len(child.inflight) if child else 0
            children.append((slot.name, bool(child and child.ready), held, rss))
        return Gauge(
            jobs=jobs,
            queue=[(priority, count, max(0.0, now - since)) for priority, count, since in queue],
            cells=cells,
            children=children,
            utility_waiting=s.utility.length,
            store_bytes=self._db.size(),
            disk_free_bytes=shutil.disk_usage(self.data_dir).free,
            disk_low=s.health.disk_low,
            draining=s.health.draining,
            scheduling=s.term.running,
            counters=dict(s.health.counters),
        )
