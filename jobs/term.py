"""Which process schedules. On SQLite the one that owns the folder; on PostgreSQL the one that holds
the lease, while the others answer HTTP, check files and wait for their turn.
"""

from __future__ import annotations

import logging
import os
from typing import TYPE_CHECKING

from uuid6 import uuid7

from matiere.jobs.job import JsonDict
from matiere.jobs.store import events, films

if TYPE_CHECKING:
    from matiere.jobs.scheduler import Scheduler
    from matiere.jobs.store.database import Database

log = logging.getLogger("matiere.jobs.term")
ASK_EVERY_S = 1.0  # for the lease, and whether other processes changed the queue


class Term:
    """The time during which this process schedules; claims carry its `instance_id`."""

    def __init__(self, database: Database) -> None:
        """Take the lease if nobody holds it."""
        self._db = database
        self.instance_id = ""
        self.found: JsonDict = {"claims_voided": 0, "chunks_voided": 0, "chunks_present": 0}
        self._seq = 0
        self._looked = 0.0
        self._begin()

    @property
    def running(self) -> bool:
        """Tell whether this process schedules now."""
        return bool(self.instance_id) and self._db.leads

    def _begin(self) -> bool:
        if not self._db.lead():
            return False
        name = str(uuid7())
        self.found = self._db.write(lambda c: films.void_dead(c, name, os.getpid()))
        self.instance_id = name
        return True

    def renew(self, scheduler: Scheduler, now: float) -> bool:
        """Tell whether to schedule this round; step down after a lost lease, ask for a free one."""
        if self.running:
            if self._db.shared and now - self._looked > ASK_EVERY_S:
                self._looked = now
                newest = self._db.read(events.newest)
                if newest != self._seq:
                    self._seq = newest
                    scheduler.garbage()
                    scheduler.wake()
            return True
        if self.instance_id:
            log.warning("the database connection was lost: stopping work until the lease is back")
            self.instance_id = ""
            scheduler.step_down()
        if now - self._looked > ASK_EVERY_S:
            self._looked = now
            if self._begin():
                log.info("this process schedules now: %s", self.found)
                scheduler.wake()
                return True
        return False

    def end(self) -> None:
        """Record an end in order and let another process schedule."""
        if self.running:
            name = self.instance_id
            self._db.write(lambda c: films.end_instance(c, name))
            self.instance_id = ""
            self._db.follow()
