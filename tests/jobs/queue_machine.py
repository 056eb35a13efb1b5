"""T6: a state machine over the rows of the queue, against a model that fits on a page.

Whatever the order of submissions, steering, claims, reports, crashes, kills and restarts: no job
changes state but along the table, a cancelled job never succeeds unless it is requeued, and after
every step the audit of the store is clean and counters equal sums.
"""

from __future__ import annotations

import atexit
import functools
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from matiere.jobs.errors import IllegalTransition
from matiere.jobs.job import JobError
from matiere.jobs.store import control, films, jobs, tables, views
from matiere.jobs.store.audit import audit
from matiere.jobs.store.database import Database
from matiere.jobs.store.files import Blob
from matiere.jobs.store.films import Claim, Loss, Merged, Report
from matiere.jobs.store.garbage import unlink_marked

FILMS = 2  # of one tile; chunk k holds sample k of 8 x 8 pixels
LAST = 4  # samples per pixel at most
PIXELS = 64
LEGAL = {
    "queued": {"running", "paused", "succeeded", "failed", "cancelled", "expired"},
    "running": {"paused", "succeeded", "failed", "cancelled", "expired"},
    "paused": {"queued", "cancelled", "expired"},
    "failed": {"queued"}, "cancelled": {"queued"}, "expired": {"queued"}, "succeeded": set(),
}  # fmt: skip
ENDED = {"succeeded", "failed", "cancelled", "expired"}
SHM = Path("/dev/shm")


@dataclass
class Job:
    """What the model knows of a job."""

    film: int
    spp: int
    needs: tuple[str, ...]
    state: str = "queued"
    complete: bool = False  # its samples are there; images are missing
    late: bool = False  # it was completed by its deadline
    attempt: int = 1
    by_need: bool = False  # cancelled because of a job it waits for
    changes: list[str] = field(default_factory=list)


@functools.cache
def _empty_store() -> Path:
    """Return a store without rows: making the tables takes longer than a run."""
    folder = Path(tempfile.mkdtemp(dir=SHM if SHM.is_dir() else None))
    atexit.register(shutil.rmtree, folder)
    Database(folder / "store.sqlite").close()
    return folder / "store.sqlite"


class QueueMachine(RuleBasedStateMachine):
    """Steps that people, children and time take, in any order."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp(dir=SHM if SHM.is_dir() else None))
        shutil.copy2(_empty_store(), self.folder / "store.sqlite")
        self.db = Database(self.folder / "store.sqlite")
        self.model: dict[str, Job] = {}
        self.tokens: dict[int, int] = {}  # every attempt ever made -> film
        self.instance = 0
        self.blobs = 0
        self.late_reports = 0
        self.restart()

    def teardown(self) -> None:
        """Forget the store."""
        self.db.close()
        shutil.rmtree(self.folder)

    # -- helpers --------------------------------------------------------------------------------
    def _write(self, action: Callable[..., Any], *arguments: Any) -> Any:
        return self.db.write(lambda c: action(c, *arguments))

    def _blob(self) -> Blob:
        self.blobs += 1
        return Blob(f"{self.blobs:064x}", 1)

    def _pick(self, data: st.DataObject) -> str:
        return data.draw(st.sampled_from(sorted(self.model)))

    def _wants(self, job: Job) -> bool:
        unmet = any(self.model[n].state != "succeeded" for n in job.needs)
        return job.state in ("queued", "running") and not job.complete and not unmet

    def _end(self, job_id: str, state: str, by_need: bool = False) -> None:
        job = self.model[job_id]
        job.state, job.by_need, job.complete = state, by_need, False
        if state == "succeeded":
            for waiter in (j for i, j in self.model.items() if job_id in j.needs):
                self._copied(waiter)
            return
        for other, waiter in list(self.model.items()):
            if job_id in waiter.needs and waiter.state not in ENDED:
                self._end(other, "cancelled", True)

    def _copied(self, job: Job) -> None:
        """A job that may begin ends at once if an earlier one had the same film and stop rule."""
        if job.state != "queued" or not self._wants(job):
            return
        twins = (j for j in self.model.values() if j is not job and j.state == "succeeded")
        if any((j.film, j.spp) == (job.film, job.spp) for j in twins):
            self._end(next(i for i, j in self.model.items() if j is job), "succeeded")

    # -- people ---------------------------------------------------------------------------------
    @rule(film=st.integers(0, FILMS - 1), spp=st.integers(1, LAST), data=st.data(),
          priority=st.integers(0, 100))  # fmt: skip
    def submit(self, film: int, spp: int, data: st.DataObject, priority: int) -> None:
        known = sorted(self.model)
        after = data.draw(st.lists(st.sampled_from(known), max_size=2)) if known else []
        spec = jobs.FilmSpec(f"{film}" * 64, "g", {}, {}, 8, 8, 2)
        made = jobs.JobSpec(spec, {"spp": spp}, spp, {}, priority, "", after=tuple(after))
        job_id = self._write(jobs.submit_job, made)
        stored = self.db.read(lambda c: films.film_of(c, job_id))
        job = self.model[job_id] = Job(stored, spp, tuple(set(after)))
        if any(self.model[n].state in ENDED - {"succeeded"} for n in after):
            self._end(job_id, "cancelled", True)
        self._copied(job)

    @precondition(lambda self: self.model)
    @rule(data=st.data())
    def cancel(self, data: st.DataObject) -> None:
        job_id = self._pick(data)
        if self._write(jobs.cancel_job, job_id):
            assert self.model[job_id].state not in ENDED
            self._end(job_id, "cancelled")

    @precondition(lambda self: self.model)
    @rule(data=st.data())
    def pause(self, data: st.DataObject) -> None:
        job_id = self._pick(data)
        job = self.model[job_id]
        try:
            if self._write(control.pause_job, job_id):
                assert job.state in ("queued", "running")
                job.state = "paused"
        except IllegalTransition:
            assert job.state in ENDED

    @precondition(lambda self: self.model)
    @rule(data=st.data())
    def resume(self, data: st.DataObject) -> None:
        job_id = self._pick(data)
        job = self.model[job_id]
        try:
            if self._write(control.resume_job, job_id):
                assert job.state == "paused"
                job.state = "running" if job.complete else "queued"
        except IllegalTransition:
            assert job.state in ENDED

    @precondition(lambda self: self.model)
    @rule(data=st.data())
    def requeue(self, data: st.DataObject) -> None:
        self._requeue(self._pick(data))

    def _requeue(self, job_id: str) -> None:
        job = self.model[job_id]
        try:
            found = self._write(control.requeue_job, job_id)
        except IllegalTransition:
            broken = any(self.model[n].state in ENDED - {"succeeded"} for n in self._above(job_id))
            assert job.state == "succeeded" or broken
            return
        for name in found:
            back = self.model[name]
            assert back.state in ENDED - {"succeeded"}
            assert name == job_id or back.by_need
            back.state, back.attempt, back.complete = "queued", back.attempt + 1, False
            back.late = back.by_need = False
        assert (job_id in found) == bool(found)

    def _above(self, job_id: str) -> set[str]:
        """Return all that any job which `job_id` would bring back waits for, but those."""
        back, needs = {job_id}, set(self.model[job_id].needs)
        for name in sorted(self.model):
            if self.model[name].by_need and back & set(self.model[name].needs):
                back.add(name)
                needs |= set(self.model[name].needs)
        return needs - back

    @precondition(lambda self: self.model)
    @rule(data=st.data(), priority=st.integers(0, 100))
    def prioritise(self, data: st.DataObject, priority: int) -> None:
        job_id = self._pick(data)
        changed = self._write(control.set_priority, job_id, priority)
        assert changed == (self.model[job_id].state not in ENDED)

    @precondition(lambda self: self.model)
    @rule(data=st.data())
    def expire(self, data: st.DataObject) -> None:
        job_id = self._pick(data)
        job = self.model[job_id]
        late = sa.update(tables.job).where(tables.job.c.id == job_id)
        self._write(lambda c: c.execute(late.values(deadline=time.time() - 1)))
        due = [i for i, _ in self.db.read(lambda c: control.due(c, time.time()))]
        assert (job_id in due) == (job.state not in ENDED and not job.complete)
        if job_id not in due:
            return
        unmet = any(self.model[n].state != "succeeded" for n in job.needs)
        merged = self.db.read(lambda c: films.load_film(c, job.film)).prefix_chunks
        assert self._write(control.expire_job, job_id)
        if merged and not unmet:
            job.state, job.complete, job.late = "running", True, True
        else:
            self._end(job_id, "expired")

    # -- children -------------------------------------------------------------------------------
    @rule(film=st.integers(1, FILMS), count=st.integers(1, 3))
    def claim(self, film: int, count: int) -> None:
        self._claim(film, count)

    def _claim(self, film: int, count: int) -> int | None:
        waiting = [j for j in self.model.values() if j.film == film and self._wants(j)]
        if not any(j.film == film for j in self.model.values()):
            return None
        row = self.db.read(lambda c: films.load_film(c, film))
        taken = self.db.read(
            lambda c: c.execute(
                sa.select(tables.chunk.c.idx).where(
                    tables.chunk.c.film_id == film, tables.chunk.c.state != "missing"
                )
            ).scalars().all()
        )  # fmt: skip
        free = [k for k in range(row.prefix_chunks, LAST) if k not in taken][:count]
        if not free:
            return None
        name = str(self.instance)
        token = self._write(films.claim, Claim(film, free, name, 1, 30.0))
        assert (token is not None) == bool(waiting)
        if token is not None:
            self.tokens[token] = film
            for job in waiting:
                job.state = "running"
        return token if token is None else int(token)

    @rule(film=st.integers(1, FILMS), count=st.integers(1, LAST), merging=st.booleans())
    def advance(self, film: int, count: int, merging: bool) -> None:
        """A claim is rendered without incident, and perhaps merged."""
        token = self._claim(film, count)
        if token is not None:
            held = self._attempt(token)[3]
            report = Report(token, film, self._blob(), 0.1, PIXELS * len(held))
            assert self._write(films.complete, report)
        if merging:
            self._merge(film)

    @rule(film=st.integers(1, FILMS))
    def poison(self, film: int) -> None:
        """A film kills three children, one after the other."""
        for _ in range(3):
            token = self._claim(film, 1)
            if token is not None:
                self._lose(token, "failed")

    @precondition(lambda self: self.model)
    @rule(data=st.data())
    def start_over(self, data: st.DataObject) -> None:
        """Cancel a job whose images may be in the making, and requeue it at once."""
        job_id = self._pick(data)
        if self._write(jobs.cancel_job, job_id):
            self._end(job_id, "cancelled")
        self._requeue(job_id)
        self._merge(self.model[job_id].film)
        self._develop(job_id, 1)

    def _attempt(self, token: int) -> tuple[int, int, str, list[int]]:
        film, t = self.tokens[token], tables
        state = self.db.read(
            lambda c: c.scalar(sa.select(t.attempt.c.state).where(t.attempt.c.id == token))
        )
        mine = sa.select(t.chunk.c.idx).where(t.chunk.c.token == token, t.chunk.c.film_id == film)
        held = self.db.read(lambda c: list(c.execute(mine).scalars()))
        return token, film, state, held

    @precondition(lambda self: self.tokens)
    @rule(data=st.data())
    def report(self, data: st.DataObject) -> None:
        """A child reports, perhaps one that was given up long ago."""
        token, film, state, held = self._attempt(data.draw(st.sampled_from(sorted(self.tokens))))
        report = Report(token, film, self._blob(), 0.1, PIXELS * len(held))
        accepted = self._write(films.complete, report)
        assert accepted == (state == "running")
        self.late_reports += not accepted

    @precondition(lambda self: self.tokens)
    @rule(data=st.data(), how=st.sampled_from(["failed", "lost", "void", "cancelled"]))
    def lose(self, data: st.DataObject, how: str) -> None:
        """A child crashes, is killed, or gives its claim back."""
        self._lose(data.draw(st.sampled_from(sorted(self.tokens))), how)

    def _lose(self, token: int, how: str) -> None:
        token, film, state, held = self._attempt(token)
        self._write(films.give_back, Loss(token, film, how, "signal", "crashed"))
        if state != "running":
            return
        row = self.db.read(lambda c: films.load_film(c, film))
        if max((row.tries.get(i, 0) for i in held), default=0) >= 3:
            failed = self._write(jobs.fail_film, film, JobError("signal", "three times"))
            expected = {i for i, j in self.model.items() if j.film == film and self._wants(j)}
            assert set(failed) == expected
            for job_id in failed:
                self._end(job_id, "failed")

    @rule(film=st.integers(1, FILMS))
    def merge(self, film: int) -> None:
        self._merge(film)

    def _merge(self, film: int) -> None:
        if not any(j.film == film for j in self.model.values()):
            return
        row = self.db.read(lambda c: films.load_film(c, film))
        end = row.prefix_chunks
        while end in row.done:
            end += 1
        spp, prefix = end, self._blob() if end > row.prefix_chunks else None
        facts = {"spp": spp, "seconds": 1.0, "relmse": 0.1, "lower": 0.1, "upper": 0.1}
        over = [job for job in row.jobs if job.spp_cap <= spp] if spp else []
        ended = [{"job_id": job.id, "reason": "spp", "cached": False, **facts} for job in over]
        merged = Merged(film, row.prefix_chunks, end, prefix, facts, ended, {})
        assert self._write(films.commit_merge, merged)
        assert not self._write(films.commit_merge, merged) or prefix is None
        for job in over:
            assert self._wants(self.model[job.id])
            self.model[job.id].state, self.model[job.id].complete = "running", True

    @precondition(lambda self: self.model)
    @rule(data=st.data(), behind=st.integers(0, 1))
    def develop(self, data: st.DataObject, behind: int) -> None:
        """Images arrive, perhaps those of an earlier attempt."""
        self._develop(self._pick(data), behind)

    def _develop(self, job_id: str, behind: int) -> None:
        job = self.model[job_id]
        attempt = max(1, job.attempt - behind)
        done = self._write(jobs.finish_job, job_id, {"image.png": self._blob()}, attempt)
        wanted = job.state == "running" and job.complete and attempt == job.attempt
        assert done == wanted
        if done:
            self._end(job_id, "expired" if job.late else "succeeded")

    # -- the service ----------------------------------------------------------------------------
    @rule()
    def restart(self) -> None:
        """Kill the service and start it."""
        self.instance += 1
        self._write(films.void_dead, str(self.instance), 1)

    @rule()
    def collect(self) -> None:
        for film in {j.film for j in self.model.values()}:
            self._write(films.drop_unmerged, film)
        self._write(unlink_marked, lambda digests: None, 100)

    # -- what must hold -------------------------------------------------------------------------
    @invariant()
    def the_store_agrees_with_the_model(self) -> None:
        found = {j.id: j for j in self.db.read(lambda c: views.list_jobs(c, None, None, None, 999))}
        assert set(found) == set(self.model)
        for job_id, job in self.model.items():
            assert (found[job_id].state, found[job_id].attempt) == (job.state, job.attempt), job
            assert (
                found[job_id].waiting_for
                == sum(self.model[n].state != "succeeded" for n in job.needs)
                or job.state in ENDED
            )
        counts = self.db.read(views.counts)
        states = [job.state for job in self.model.values()]
        assert {s: n for s, n in counts.items() if n} == {s: states.count(s) for s in set(states)}

    @invariant()
    def the_audit_is_clean(self) -> None:
        wrong = self.db.read(lambda c: audit(c, lambda film, index: PIXELS))
        assert wrong == [], wrong
        total = sa.select(sa.func.coalesce(sa.func.sum(tables.film.c.reports_superseded), 0))
        assert self.db.read(lambda c: c.scalar(total)) == self.late_reports

    @invariant()
    def every_change_was_legal(self) -> None:
        """The events tell each job's way; a cancelled one goes on only by a requeue."""
        kinds = {*LEGAL}
        rows = sa.select(tables.event).order_by(tables.event.c.seq)
        way: dict[str, str] = {}
        for row in self.db.read(lambda c: c.execute(rows).all()):
            if row.kind in kinds:
                before = way.get(row.job_id)
                assert before is None or row.kind in LEGAL[before], (before, row.kind)
                if before in ENDED:
                    assert '"attempt"' in row.data, "only a requeue brings an ended job back"
                way[row.job_id] = row.kind
        assert way == {i: job.state for i, job in self.model.items()}
