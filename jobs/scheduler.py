"""The scheduler thread: hands chunks to children, takes their reports, decides what comes next.

It owns every child process. Truth is the database: what this thread keeps in memory can be lost at
any moment and is read back by the next instance.
"""

from __future__ import annotations

import contextlib
import logging
import queue
import shutil
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from matiere.jobs import cgroups
from matiere.jobs.artifacts import Artifacts
from matiere.jobs.batching import Batching
from matiere.jobs.budgets import Budgets
from matiere.jobs.children import LEASE_S, Child, ChildOptions, Message
from matiere.jobs.cluster.member import Driver
from matiere.jobs.datadir import DataDir
from matiere.jobs.errors import DiskFull, StoreError
from matiere.jobs.film_work import FilmWork
from matiere.jobs.job import JobError, JsonDict
from matiere.jobs.questions import PICTURES, Questions
from matiere.jobs.slots import Health, Held, Options, Slot
from matiere.jobs.storage import Storage
from matiere.jobs.store import events, files, films, jobs
from matiere.jobs.store.database import Database
from matiere.jobs.store.files import Blob
from matiere.jobs.store.films import Claim, Loss, Report
from matiere.jobs.telemetry import Telemetry
from matiere.jobs.term import Term
from matiere.jobs.utility_queue import Question, UtilityQueue
from matiere.jobs.warden import Warden

log = logging.getLogger("matiere.jobs.scheduler")

TICK_S = 0.2
CLAIM_S = 1.0  # aimed render time of one claim
LEAST_CLAIM_S = 0.1  # the tail of a film is shared out, but not in smaller pieces
FIRST_CLAIM_SAMPLES = 60_000.0  # before anything was measured
PIPELINE = 2  # claims a child may hold: one at work, one waiting
MOST_CHUNKS = 4096  # of one claim
MOST_WINDOW = 64  # renderers for which four films each are looked at
MAX_TRIES = 3
MAX_LOSSES = 20
PRESS_S = 0.01  # between looks at a child that was told to cancel
RESTART_WAIT_S = (0.0, 0.0, 0.5, 1.0, 2.0, 5.0, 15.0)


class Scheduler(Questions, threading.Thread):
    """Runs until `stop`; `wake` makes it look at the database again."""

    def __init__(
        self, database: Database, data: DataDir, options: Options, work: Any, term: Term
    ) -> None:
        """Prepare; `start` begins."""
        super().__init__(name="matiere-scheduler", daemon=True)
        self.db, self.data, self.options, self.work = database, data, options, work
        self.inbox: queue.SimpleQueue[Message | Question | None] = queue.SimpleQueue()
        self.health = Health()
        self.telemetry = Telemetry(database.measures)
        self.term = term
        self.storage = Storage(data, database, options.rules)
        self.on_low_disk: Callable[[], None] | None = None
        self.films: dict[int, FilmWork] = {}
        self.slots = [Slot(f"child-{i + 1}") for i in range(options.children)]
        if options.cluster is not None:
            self.slots = [Slot("ray")]
        self.utility = UtilityQueue(self, Slot("utility"))
        self._warden = Warden(self)
        self._groups = cgroups.take(self._warden.all_bytes)
        self.batching, self.budgets = Batching(self), Budgets(self)
        self._examining = threading.Lock()  # held while a material is checked
        self._comparing = threading.Lock()  # held while nights are compared
        self._drawing = threading.BoundedSemaphore(PICTURES)
        self._unsaved: list[Message] = []  # reports that met a full disk
        self.rates: dict[str, float] = {}  # geometry key -> samples per second of one child
        self._stopping = False
        self._pressing = False  # a child was told to cancel and has not said that it did
        self._dirty = True  # the database changed: read queue and films again
        self._garbage = True
        self._checked = 0.0

    # -- called from other threads --------------------------------------------------------------
    def wake(self) -> None:
        """Say that jobs were submitted or cancelled."""
        self._dirty = True
        self.inbox.put(None)

    def stop(self) -> None:
        """End the thread and its children."""
        self._stopping = True
        self.inbox.put(None)

    def idle(self) -> bool:
        """Tell whether no child holds work."""
        return not any(s.child and s.child.inflight for s in self.slots) and not self.utility.busy

    # -- the loop -------------------------------------------------------------------------------
    def run(self) -> None:
        """Loop; an error in one step is logged and the next round goes on."""
        wait = TICK_S
        while not self._stopping:
            try:
                self._round()
                self.health.fault, wait = "", TICK_S
            except DiskFull as error:
                self.pause_for_disk(str(error))
            except StoreError:
                log.exception("the job database refused a step; trying again")
                time.sleep(TICK_S)
            except Exception as error:
                log.exception("a scheduling step failed; trying again")
                self.health.fault = f"{type(error).__name__}: {error}"
                self._dirty = True
                time.sleep(wait)
                wait = min(2.0 * wait, 5.0)
        self._end_children()

    def _round(self) -> None:
        self._receive()
        now = time.monotonic()
        leads = self.term.renew(self, now)
        self._keep_children(now, leads)
        self._check_disk(now)
        if not leads:  # only questions
            self.utility.dispatch(now)
            return
        self._warden.look(now)
        if self._dirty or self.budgets.due(now):
            self._dirty = False
            self._read_queue(now)
        if self._garbage and not self.disk_paused(now):
            self._garbage = False
            self._collect()
        for film in list(self.films.values()):
            if film.merge_due(now):
                film.merging = True
                self.utility.add_merge(film)
        if not self.health.draining:
            self.utility.dispatch(now)
            if not self.health.disk_low and not self.disk_paused(now):
                self._hand_out(now)

    def _receive(self) -> None:
        waiting, self._unsaved = self._unsaved, []
        with contextlib.suppress(queue.Empty):
            item = self.inbox.get(timeout=PRESS_S if self._pressing else TICK_S)
            while True:
                if isinstance(item, Question):
                    self.utility.add_question(item)
                elif item is not None:
                    waiting.append(item)
                item = self.inbox.get_nowait()
        for place, message in enumerate(waiting):
            try:
                self._take(message)
            except StoreError:
                self._unsaved = waiting[place:]  # a report is kept until it is stored
                raise

    def _take(self, message: Message) -> None:
        child, body = message.child, message.body
        if body["op"] in ("hello", "nodes"):
            if news := child.greet(body):
                self.db.write(events.emit_news, news)
            self.health.stuck = child.trouble
        elif child is self.utility.slot.child:
            self.utility.handle(body)
        elif body["op"] == "exit":
            if child.alive:  # else it was given up before
                self._child_ended(child, body["code"])
        elif (held := child.inflight.get(body["token"])) is None:
            if body["op"] == "done" and body.get("digest"):  # of a child that was given up
                self._refuse(body["token"], Blob(body["digest"], body["size"]))
        elif body["op"] == "reading":
            held.phase = "reading" if body["on"] else "working"
        elif body["op"] == "begun":
            held.begun, held.phase = body["film"], "working"
        else:
            handler = {"done": self._done, "failed": self._failed, "cancelled": self._cancelled,
                       "returned": self._returned}  # fmt: skip
            handler[body["op"]](child, held, body)
            child.inflight.pop(held.token, None)

    def _refuse(self, token: int, blob: Blob) -> None:
        self.db.write(lambda c: films.refuse(c, token, blob))
        self.health.counters["reports_superseded"] += 1
        self._garbage = True

    # -- reports of render children -------------------------------------------------------------
    def _done(self, child: Child, held: Held, body: JsonDict) -> None:
        if held.kind != "chunks":
            self._slot_of(child).failures = 0
            taken = self.batching.rendered if held.kind == "batch" else self.batching.expanded
            taken(held, body)
            return
        blob = Blob(body["digest"], body["size"])
        if not self.folder.has(blob.digest, blob.size):
            self._give_back(held, Loss(held.token, held.film_id, "lost", "file_missing"))
            return
        told = body.get("printed", "")
        report = Report(held.token, held.film_id, blob, body["seconds"], held.samples, told)
        try:
            accepted = self.db.write(lambda c: films.complete(c, report))
        except files.FileGone:
            self._give_back(held, Loss(held.token, held.film_id, "lost", "file_missing"))
            return
        self.health.counters["claims_done" if accepted else "reports_superseded"] += 1
        self._garbage |= not accepted
        film = self.films.get(held.film_id)
        self._slot_of(child).failures = 0
        self._dirty |= self.budgets.concern(film)
        if film is None or not accepted:
            return
        self.health.counters["chunks_rendered"] += len(held.chunks)
        self.telemetry.rendered(held, film, body, child.name)
        for index in held.chunks:
            film.claimed.pop(index, None)
            film.done[index] = held.token
        film.files[held.token] = blob
        film.seconds += body["seconds"]
        film.pixel_samples += held.samples
        rate = held.samples / max(body["render_s"], 1e-4)
        known = self.rates.get(film.row.geometry_key, rate)
        self.rates[film.row.geometry_key] = 0.5 * (rate + known)

    def _failed(self, child: Child, held: Held, body: JsonDict) -> None:
        kind, message = body["error"], body["message"]
        self.health.counters[f"failed_{kind}"] += 1
        if held.kind != "chunks":
            self._batch_failed(child, held, body)
            return
        if kind == "disk_full":
            self._give_back(held, Loss(held.token, held.film_id, "void", kind, message))
            self.pause_for_disk(message)
            return
        tail = "" if body["permanent"] else child.log_tail()
        loss = Loss(held.token, held.film_id, "failed", kind, message, tail)
        self._give_back(held, loss)
        error = JobError(kind, message, body["pointer"], tail)
        if body["permanent"]:
            self.fail_film(held.film_id, error)
        else:
            self._fail_if_hopeless(held, error)

    def _batch_failed(self, child: Child, held: Held, body: JsonDict) -> None:
        kind, message = body["error"], body["message"]
        if kind == "disk_full":
            self.batching.lost(held, "void", JobError(kind, message))
            self.pause_for_disk(message)
        else:
            tail = "" if body["permanent"] else child.log_tail()
            self.batching.lost(held, "failed", JobError(kind, message, body["pointer"], tail))

    def _cancelled(self, child: Child, held: Held, body: JsonDict) -> None:
        if held.kind != "chunks":
            self.batching.lost(held, "cancelled")
            return
        self._give_back(held, Loss(held.token, held.film_id, "cancelled"))

    def _returned(self, child: Child, held: Held, body: JsonDict) -> None:
        held.begun = body["begun"]
        error = JobError(body["error"], body["message"], "", body["log_tail"])
        self._unfinished(held, body["state"], error)

    def _unfinished(self, held: Held, state: str, error: JobError) -> None:
        """Take back a claim that was not rendered; "lost" and "failed" count against its film."""
        counts = state in ("lost", "failed")
        if held.kind != "chunks":
            self.batching.lost(held, state, error if counts else None)
            return
        kept = (error.code, error.message, error.log_tail)
        self._give_back(held, Loss(held.token, held.film_id, state, *kept))
        if counts:
            self._fail_if_hopeless(held, error)

    def _give_back(self, held: Held, loss: Loss) -> None:
        self.db.write(lambda c: films.give_back(c, loss))
        film = self.films.get(held.film_id)
        self.telemetry.lost(held, loss, [job.id for job in film.jobs] if film else ())
        if film is not None:
            film.put_back(held.chunks)
            counted = {"failed": film.tries, "lost": film.losses}.get(loss.state, {})
            for index in held.chunks:
                counted[index] = counted.get(index, 0) + 1

    def _fail_if_hopeless(self, held: Held, error: JobError) -> None:
        film = self.films.get(held.film_id)
        if film is None:
            return
        tries = max(film.tries.get(i, 0) for i in held.chunks)
        losses = max(film.losses.get(i, 0) for i in held.chunks)
        if tries >= MAX_TRIES or losses >= MAX_LOSSES:
            times = max(tries, losses)
            why = f"gave up after {times} attempts: {error.message}"
            self.fail_film(held.film_id, replace(error, message=why))

    def fail_film(self, film_id: int, error: JobError) -> None:
        """End every job that waits for a film as failed."""
        failed = self.db.write(lambda c: jobs.fail_film(c, film_id, error))
        log.warning("film %d failed (%s): %s", film_id, error.code, error.message)
        self.health.counters["jobs_failed"] += len(failed)
        if (film := self.films.get(film_id)) is not None:  # asked for again, it starts afresh
            film.tries.clear()
            film.losses.clear()
        self._dirty = True
        self.utility.sweeps_may_have_ended()

    # -- children -------------------------------------------------------------------------------
    @property
    def hands(self) -> int:
        """Claims that are rendered at once, at least 1."""
        return max(1, sum(slot.child.capacity for slot in self.slots if slot.child))

    @property
    def folder(self) -> Artifacts:
        """Where artifacts lie."""
        return self.data.artifacts

    def start_child(self, slot: Slot, threads: int) -> None:
        """Fill a slot with a new process (from this thread: children die with it)."""
        options = ChildOptions(
            slot.name,
            self.folder.location,
            self.data.root,
            self.data.logs,
            self.options.work,
            threads,
            self.options.children * self.options.threads,
            self._warden.data_limit,
            group=self._groups.place(slot.name, self._warden.data_limit) if self._groups else None,
        )
        if slot is self.utility.slot or self.options.cluster is None:
            slot.child = Child(options, self.inbox)
        else:
            slot.child = Driver(options, self.options.cluster, self.inbox)
        self.health.counters["children_started"] += 1

    def _keep_children(self, now: float, leads: bool) -> None:
        self._pressing = False
        for slot in (*(self.slots if leads else ()), self.utility.slot):
            if slot.child is not None and slot.child.escaped(now):
                self.give_up(slot)
            if slot.child is None and now >= slot.not_before:
                self.start_child(slot, self.options.threads)
            elif slot.child is not None:
                slot.child.tick(now)
                self._pressing |= slot.child.press(now)

    def give_up(self, slot: Slot) -> None:
        """Go on without a killed child that the kernel keeps: its token fences what it reports."""
        if slot is self.utility.slot:
            self.utility.handle({"op": "exit", "code": None})
        elif slot.child is not None:
            self._child_ended(slot.child, None)

    def _slot_of(self, child: Child) -> Slot:
        return next(slot for slot in self.slots if slot.child is child)

    def retire(self, slot: Slot, kind: str) -> None:
        """Empty a slot after its child ended; wait longer each time it fails without success.

        One that worked and was killed from outside has not failed: the next begins at once.
        """
        child = slot.child
        slot.failures += not (kind == "lost" and child and child.ready and not child.remote)
        if child is not None:
            child.alive = False
        wait = RESTART_WAIT_S[min(slot.failures, len(RESTART_WAIT_S) - 1)]
        slot.child, slot.not_before = None, time.monotonic() + wait

    def _child_ended(self, child: Child, code: int | None) -> None:
        kind, words = child.exit_class(code)
        tail = child.log_tail()
        log.warning("%s (pid %d) %s", child.name, child.pid, words)
        self.health.counters["children_lost"] += 1
        self.db.measures.child_ends[kind] += 1
        for place, held in enumerate(list(child.inflight.values())):
            begun = place < child.capacity and held.cancelled is None
            state = ("lost" if kind == "lost" else "failed") if begun else "void"
            self._unfinished(held, state, JobError(kind, words, "", tail))
        child.inflight.clear()
        if not child.ready:
            self.health.stuck = f"{child.name} does not start ({words}); see {self.data.logs}"
        self.retire(self._slot_of(child), kind)

    def step_down(self) -> None:
        """Forget all work: another process may have it by now."""
        for slot in (*self.slots, self.utility.slot):
            if slot.child is not None:
                slot.child.inflight.clear()
                slot.child.kill()
                slot.child.wait(5.0)
        self.films.clear()
        self._unsaved.clear()
        self.utility.forget()
        self._dirty = self._garbage = True

    def _end_children(self) -> None:
        running = [s.child for s in (*self.slots, self.utility.slot) if s.child is not None]
        for child in running:
            child.close()
        for child in running:
            if not child.wait(2.0):
                child.kill()
                child.wait(5.0)

    # -- disk -----------------------------------------------------------------------------------
    def pause_for_disk(self, why: str) -> None:
        """Stop handing out work for a moment; nothing is lost meanwhile."""
        log.warning("disk full, waiting: %s", why)
        self.health.disk_full_until = time.monotonic() + 2.0

    def disk_paused(self, now: float) -> bool:
        """Tell whether a write met a full disk a moment ago."""
        return now < self.health.disk_full_until

    def _check_disk(self, now: float) -> None:
        if now - self._checked > 1.0:
            self._checked = now
            free = shutil.disk_usage(self.data.root).free
            self.health.disk_low = free < self.options.min_free_bytes
            if self.health.disk_low and self.on_low_disk is not None:
                self.on_low_disk()

    def _collect(self) -> None:
        """Remove a slice of what was deleted, drop its films, unlink files marked for it."""
        try:
            more = self.storage.remove_hidden()
            self._garbage = self.storage.drop_forgotten(set(self.films)) or more
            if self.db.read(lambda c: files.pending_deletions(c, 1)):
                self.storage.unlink()
        except OSError as error:
            self._garbage = True
            self.pause_for_disk(f"files cannot be deleted: {error}")

    def garbage(self) -> None:
        """Say that files may have lost their last reference."""
        self._garbage = True

    # -- work -----------------------------------------------------------------------------------
    def _read_queue(self, now: float) -> None:
        """Fill the window with the most urgent films and learn who waits for them."""
        most = 2 + 4 * min(self.hands, MOST_WINDOW)
        wanted = self.db.read(lambda c: films.next_films(c, most))
        for film_id in wanted + self.budgets.read_queue(now, most):
            if film_id not in self.films:
                row = self.db.read(films.load_film, film_id)
                self.films[film_id] = FilmWork(row, self.work, now)
        waiting = self.db.read(lambda c: films.waiting_by_film(c, list(self.films)))
        idle = [film_id for film_id, found in waiting.items() if not found]
        resting = self.db.read(lambda c: films.resting(c, idle)) if idle else set()
        for film in list(self.films.values()):
            film.jobs = waiting[film.id]
            if film.id in resting:
                self._rest(film)
            elif not film.jobs:
                self._abandon(film)
        self.utility.read_queue()
        self.batching.read_queue()

    def dirty(self) -> None:
        """Say that the database changed (from this thread)."""
        self._dirty = True

    def _rest(self, film: FilmWork) -> None:
        """All who wait for a film are paused: what is being rendered ends, and all is kept."""
        if self._busy(film):
            self._dirty = True
        else:
            del self.films[film.id]

    def _busy(self, film: FilmWork) -> bool:
        held = (h for s in self.slots if s.child for h in s.child.inflight.values())
        return film.merging or any(h.film_id == film.id for h in held)

    def _abandon(self, film: FilmWork) -> None:
        """Nobody waits for a film any more: stop its renders, drop what is not merged."""
        now = time.monotonic()
        for slot in self.slots:
            for held in list(slot.child.inflight.values()) if slot.child else []:
                if held.film_id == film.id and held.cancelled is None and slot.child:
                    held.cancelled, self._pressing = now, True
                    slot.child.send("cancel", token=held.token)
        if self._busy(film):
            self._dirty = True  # look again when the last report is in
            return
        self.db.write(lambda c: films.drop_unmerged(c, film.id))
        self._garbage = True
        del self.films[film.id]

    def _hand_out(self, now: float) -> None:
        for depth in range(1, PIPELINE + 1):
            for child in [slot.child for slot in self.slots if slot.child and slot.child.ready]:
                for _ in range(depth * child.capacity - len(child.inflight)):
                    if not self._hand_to(child, now):
                        return

    def _hand_to(self, child: Child, now: float) -> bool:
        """Give a child something to do; false if there is nothing."""
        if (sweep := self.batching.expansion_due()) is not None:
            held: Held | None = self.batching.expand(child, sweep, now)
        else:
            film, small = self._choose(child), self.batching.rank()
            if film is None and small is None:
                return False
            if small is None or (film and (-film.urgency, film.jobs[0].id) < small):
                assert film is not None
                self._claim(child, film, now)
                return True
            held = self.batching.claim(child, now)
        if held is not None:
            child.inflight[held.token] = held
        return True

    def _choose(self, child: Child) -> FilmWork | None:
        elsewhere = {
            held.film_id
            for slot in self.slots
            if slot.child is not None and slot.child is not child
            for held in slot.child.inflight.values()
        }

        def rank(film: FilmWork) -> tuple[int, int, int, str]:
            if film.id in elsewhere:
                tier = 3
            elif film.key in child.seen:
                tier = 0
            else:
                tier = 1 if film.row.geometry_key == child.geometry else 2
            return (-film.urgency, self.budgets.turn(film), tier, film.jobs[0].id)

        ready = [f for f in self.films.values() if f.jobs and f.available()]
        ready = [film for film in ready if self.budgets.admits(film)]
        return min(ready, key=rank, default=None)

    def _claim(self, child: Child, film: FilmWork, now: float) -> None:
        rate = self.rates.get(film.row.geometry_key)
        aim = self.budgets.first_samples(film, FIRST_CLAIM_SAMPLES)
        aim = aim if rate is None else rate * self._claim_seconds(film)
        left = film.horizon() - film.prefix_chunks - len(film.done) - len(film.claimed)
        most = MOST_CHUNKS
        if sum(1 for f in self.films.values() if f.available()) <= 1:  # share the tail
            share = -(-left // (2 * self.hands))
            worthwhile = int(LEAST_CLAIM_S * (rate or 0.0) / film.samples(film.prefix_chunks))
            most = max(self.options.threads, share, worthwhile)
        chunks = film.take(aim, min(most, MOST_CHUNKS))
        if not chunks:
            return
        begun = time.monotonic()
        claim = Claim(film.id, chunks, self.term.instance_id, child.pid, LEASE_S)
        try:
            token = self.db.write(lambda c: films.claim(c, claim))
        except BaseException:
            film.put_back(chunks)
            raise
        if token is None:  # cancelled a moment ago
            film.put_back(chunks)
            self._dirty = True
            return
        for index in chunks:
            film.claimed[index] = token
        samples = sum(film.samples(i) for i in chunks)
        child.inflight[token] = Held(token, film.id, chunks, samples, now)
        self.telemetry.claimed(child.inflight[token], child.name, begun)
        child.geometry = film.row.geometry_key
        child.seen[film.key] = None
        while len(child.seen) > 4:
            child.seen.popitem(last=False)
        row = film.row
        child.send("render", token=token, film_key=film.key, scene=row.scene, assets=row.assets,
                   replicates=row.replicates, chunks=chunks,
                   indices=[film.course.chunk(position) for position in chunks])  # fmt: skip

    def _claim_seconds(self, film: FilmWork) -> float:
        """Return the aimed length of a claim: shorter where a time limit is near."""
        limits = [float(job.stop["seconds"]) for job in film.jobs if job.stop.get("seconds")]
        longest = max(0.05, min(CLAIM_S, 0.1 * max(limits))) if limits else CLAIM_S
        return self.budgets.claim_s(film, longest)
