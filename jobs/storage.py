"""What is kept and for how long: usage, retention, garbage collection, pins.

A `Storage` works on an open store, in a service or in a command of its own. The collector runs in
the process that schedules, in short transactions, so that submissions never wait for it.
"""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import logging
import os
import shutil
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from matiere.jobs import procfs, quota
from matiere.jobs.datadir import DataDir
from matiere.jobs.errors import Busy, JobsError
from matiere.jobs.job import JsonDict
from matiere.jobs.rules import Rules
from matiere.jobs.store import events, files, garbage, removal
from matiere.jobs.store.database import Database
from matiere.jobs.uploads import Uploads

log = logging.getLogger("matiere.jobs.storage")

DAY_S = 86400.0
MOST_FILM_BYTES = 50 * 10**9
SLICE = 200  # rows or files of one transaction
EVENT_SLICE = 5000
FORGOTTEN = 5000  # films that are looked at together
COLLECT_EVERY_S = 600.0
TRIM_EVERY_S = 20.0
RECENT_S = 60.0  # a film of use a moment ago is never evicted
HOLD_WAIT_S = 30.0


@dataclass
class Collected:
    """What a collection removed, or would remove."""

    dry_run: bool = False
    jobs: int = 0
    sweeps: int = 0
    films: int = 0
    film_bytes: int = 0
    files: int = 0
    file_bytes: int = 0

    @property
    def anything(self) -> bool:
        """Tell whether there was anything to remove."""
        return bool(self.jobs or self.sweeps or self.films or self.files)


class Storage:
    """Usage, retention and garbage of one data directory and its store."""

    def __init__(
        self,
        data: DataDir,
        database: Database,
        rules: Rules,
        clock: Callable[[], float] = time.time,
    ) -> None:
        """Serve an open store; `clock` gives Unix seconds."""
        self._data, self._db, self.rules, self._clock = data, database, rules, clock
        self._busy, self._unlinking = threading.Lock(), threading.Lock()
        self.alone = False  # no scheduler beside: films are in nobody's hands

    # -- usage --------------------------------------------------------------------------------
    def usage(self) -> JsonDict:
        """Return bytes and files by what they are for, the limits, and the free disk."""
        root = self._data.root
        free = shutil.disk_usage(root).free
        return {
            "data_dir": str(root),
            "store_bytes": self._db.size(),
            "artifacts": self._db.read(garbage.usage),
            "asset_bytes": _tree_bytes(self._data.assets),
            "log_bytes": _tree_bytes(self._data.logs),
            "film_limit_bytes": self.film_limit(),
            "disk_free_bytes": free,
            "disk_low": free < self.rules.min_free_bytes,
            "result_days": self.rules.result_days,
        }

    def film_limit(self) -> int:
        """Return the bytes that films may take: what is set, or 50 GB or half the free disk."""
        if self.rules.film_bytes is not None:
            return self.rules.film_bytes
        held = self._db.read(garbage.film_bytes)
        return min(MOST_FILM_BYTES, (shutil.disk_usage(self._data.root).free + held) // 2)

    def pin(self, name: str, pinned: bool) -> str:
        """Keep a job or a sweep whatever its age (or no more); return which it is."""
        return self._db.write(lambda c: garbage.pin(c, name, pinned))

    def check_room(self, films: Iterable[tuple[int, int, int]], times: float = 1.0) -> None:
        """Raise if the disk has no room for films as `quota.disk_need` takes them."""

        def evictable() -> int:
            return sum(film.size for film in self._db.read(lambda c: garbage.cold_films(c, 10**6)))

        quota.check_disk(self._data.root, quota.disk_need(films, times), evictable)

    # -- collecting ---------------------------------------------------------------------------
    def collect(self, *, dry_run: bool = False) -> Collected:
        """Remove old results, films beyond the limit and files nobody names; tell what went.

        Raises `Busy` while another collection runs.
        """
        if not self._busy.acquire(blocking=False):
            raise Busy("a collection is running", code="busy")
        try:
            if not dry_run and not (self._db.leads or self._db.lead()):
                raise Busy("another service on this database schedules and collects", code="busy")
            return self._foresee() if dry_run else self._collect()
        finally:
            self._busy.release()

    def _before(self) -> tuple[float, float]:
        now = self._clock()
        return now - self.rules.result_days * DAY_S, now - self.rules.grace_hours * 3600.0

    def _foresee(self) -> Collected:
        old, unnamed = self._before()
        found = Collected(dry_run=True)
        everything = 10**9
        found.jobs = len(self._db.read(lambda c: garbage.old_jobs(c, old, everything)))
        found.sweeps = len(self._db.read(lambda c: garbage.old_sweeps(c, old, everything)))
        for film in self._beyond_limit():
            found.films += 1
            found.film_bytes += film.size
        found.files, found.file_bytes = self._db.read(lambda c: garbage.unnamed_files(c, unnamed))
        return found

    def _collect(self) -> Collected:
        old, unnamed = self._before()
        found = Collected()
        while names := self._db.read(lambda c: garbage.old_jobs(c, old, SLICE)):
            found.jobs += self._db.write(garbage.remove_jobs, names, old)
        for name in self._db.read(lambda c: garbage.old_sweeps(c, old, 10**6)):
            gone = 0
            while self._db.write(garbage.remove_cells, name, old, SLICE):
                gone = 1
            found.sweeps += gone
        while self.alone and self.remove_hidden():
            pass
        if self.alone:
            self.drop_forgotten(())
        while self._db.write(removal.forget_deletions, unnamed, EVENT_SLICE):
            pass
        while self._db.write(events.prune, self.rules.events_kept, EVENT_SLICE):
            pass
        while self._db.write(garbage.remove_past_work, old, SLICE):
            pass
        for film in self._beyond_limit():
            if self._db.write(garbage.evict_films, [film.id]):
                found.films += 1
                found.film_bytes += film.size
        while self._db.write(lambda c: garbage.remove_empty_films(c, SLICE)):
            pass
        found.files, found.file_bytes = self._db.read(lambda c: garbage.unnamed_files(c, unnamed))
        while self._db.write(lambda c: garbage.mark_unnamed(c, unnamed, SLICE)):
            pass
        self.unlink()
        Uploads(self._data, 0).sweep(self._clock())
        self._db.compact(waited_for=not self.alone)
        if found.anything:
            log.info("collected %s", asdict(found))
        return found

    def remove_hidden(self) -> bool:
        """Remove some rows of a deleted sweep; tell whether there were any."""
        there = self._db.read(removal.hidden) is not None
        return there and self._db.write(removal.remove_hidden, SLICE)

    def drop_forgotten(self, busy: Collection[int]) -> bool:
        """Drop films whose jobs were all deleted, but for `busy`; tell whether some are left."""
        while found := self._db.read(removal.forgotten_films, FORGOTTEN + len(busy)):
            idle = [film_id for film_id, held in found.items() if film_id not in busy and not held]
            for start in range(0, len(idle), SLICE):
                self._db.write(removal.drop_forgotten, idle[start : start + SLICE])
            if len(idle) < len(found):
                return True
        return False

    def _beyond_limit(self) -> list[garbage.ColdFilm]:
        """Return the films to evict, the longest unused first."""
        excess = self._db.read(garbage.film_bytes) - self.film_limit()
        chosen: list[garbage.ColdFilm] = []
        if excess <= 0:
            return chosen
        latest = self._clock() - RECENT_S
        for film in self._db.read(lambda c: garbage.cold_films(c, 10**6)):
            if excess <= 0 or film.used > latest:
                break
            chosen.append(film)
            excess -= film.size
        return chosen

    def unlink(self) -> int:
        """Unlink files that are marked, unless a backup holds them; return how many."""
        count = 0
        with self._unlinking, holding(self._data.root, exclusive=True) as held:
            if not held:
                return 0
            remove = self._data.artifacts.remove_all
            while gone := self._db.write(lambda c: garbage.unlink_marked(c, remove, SLICE)):
                count += gone
        return count

    def strangers_before(self, begun: float) -> float:
        """Return the time before which a file that no row knows is nobody's.

        That is when this process began, as it is alone; where other services may share the
        artifacts, their children may be writing: a file gets the grace of the collector.
        """
        return begun - (self.rules.grace_hours * 3600.0 if self._db.shared else 0.0)

    def remove_strangers(self, before: float, stopped: Callable[[], bool]) -> int:
        """Unlink files older than `before` that no row knows: their makers were killed."""
        folder, count = self._data.artifacts, 0
        old = folder.written_before(before)
        while not stopped() and (batch := list(itertools.islice(old, SLICE))):
            if not self._db.read(files.unknown, batch):
                continue

            with self._unlinking, holding(self._data.root, exclusive=True) as held:
                count += (
                    self._db.write(garbage.unlink_unknown, folder.remove_all, batch) if held else 0
                )
        return count


@contextlib.contextmanager
def open_storage(
    root: Path, rules: Rules, *, database_url: str | None = None, artifacts_url: str | None = None
) -> Iterator[Storage]:
    """Give the storage of a data directory that no service has open, without any child.

    Raises DataDirLocked, and JobsError where nothing is served from.
    """
    if database_url is None and not (root / "store.sqlite").is_file():
        raise JobsError(f"{root} is no data directory of matiere: it has no store.sqlite")
    data = DataDir.open(root, artifacts_url)
    try:
        database = Database(None if database_url else data.store, database_url)
        try:
            database.has_file = data.artifacts.has
            storage = Storage(data, database, rules)
            storage.alone = True
            yield storage
        finally:
            database.close()
    finally:
        data.close()


@contextlib.contextmanager
def holding(root: Path, *, exclusive: bool) -> Iterator[bool]:
    """Keep files from being unlinked (shared: a backup), or be the one that unlinks (exclusive).

    Gives whether the lock was had: who unlinks does not wait, a backup waits for half a minute.
    The kernel drops the lock of a process that dies.
    """
    fd = os.open(root / "hold", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    end = time.monotonic() + (0.0 if exclusive else HOLD_WAIT_S)
    try:
        while True:
            try:
                fcntl.flock(fd, (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH) | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() > end:
                    yield False
                    return
                time.sleep(0.05)
            else:
                yield True
                return
    finally:
        os.close(fd)


def _tree_bytes(folder: Path) -> int:
    """Return the bytes of all files below a folder; hard links of one file count once."""
    seen: dict[tuple[int, int], int] = {}
    for place, _, names in os.walk(folder):
        for name in names:
            with contextlib.suppress(OSError):
                facts = Path(place, name).lstat()
                seen[facts.st_dev, facts.st_ino] = facts.st_size
    return sum(seen.values())


class Janitor(threading.Thread):
    """Collects now and then in the process that schedules, and at once when the disk is low."""

    def __init__(self, storage: Storage, leads: Callable[[], bool]) -> None:
        """Prepare; `leads` tells whether this process schedules."""
        super().__init__(name="matiere-janitor", daemon=True)
        self._storage, self._leads = storage, leads
        self._wanted, self._ended = threading.Event(), threading.Event()
        self._begun = time.time()

    def hurry(self) -> None:
        """Collect now: the disk is low."""
        self._wanted.set()

    def end(self) -> None:
        """Stop after the transaction at hand."""
        self._ended.set()
        self._wanted.set()

    def run(self) -> None:
        """Remove what killed children left, then collect again and again."""
        if self._leads():
            before = self._storage.strangers_before(self._begun)
            self._try(lambda: self._storage.remove_strangers(before, self._ended.is_set))
        collected = time.monotonic()
        while not self._ended.is_set():
            wanted = self._wanted.wait(TRIM_EVERY_S)
            self._wanted.clear()
            procfs.give_back_memory()
            due = wanted or time.monotonic() - collected > COLLECT_EVERY_S
            if due and not self._ended.is_set() and self._leads():
                self._try(self._storage.collect)
                collected = time.monotonic()
                self._ended.wait(1.0)  # a disk that stays low asks again and again

    def _try(self, action: Callable[[], object]) -> None:
        try:
            action()
        except (JobsError, OSError):
            if not self._ended.is_set():
                log.warning("could not collect; trying again later", exc_info=True)
