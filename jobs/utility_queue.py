"""Work for the utility child: questions, merges, images of ended jobs, contact sheets.

Questions are asked by somebody who waits: are the files of a scene good, how stable is a material?
All else follows from the database (jobs whose samples are complete, sweeps whose cells
have ended), so a restart finds them again. One task runs at a time; one that kills its child, or
takes too long, is tried again a few times.
"""

from __future__ import annotations

import heapq
import itertools
import logging
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

from matiere.jobs.errors import JobNotFound
from matiere.jobs.film_work import FilmWork
from matiere.jobs.job import Job, JobError, JobState, JsonDict
from matiere.jobs.store import files, films, jobs, nights, views
from matiere.jobs.store.files import Blob
from matiere.jobs.store.films import Merged

if TYPE_CHECKING:
    from matiere.jobs.scheduler import Scheduler
    from matiere.jobs.slots import Slot

log = logging.getLogger("matiere.jobs.utility")

DRAW, DIFFERENCE, DEVELOP, STABILITY, CHECK = -4, -3, -2, -1, 0
COMPARE, MERGE, IMAGES, NIGHT, SHEET = 1, 2, 3, 4, 5
NAMES = {
    DRAW: "draw", DIFFERENCE: "draw",
    DEVELOP: "images", STABILITY: "stability", CHECK: "check", COMPARE: "compare", MERGE: "merge",
    IMAGES: "images", NIGHT: "night", SHEET: "sheet",
}  # fmt: skip
WORDS = {
    DIFFERENCE: "draw a difference",
    DRAW: "draw a picture",
    DEVELOP: "make its images",
    STABILITY: "check a material",
    CHECK: "read its files",
    COMPARE: "compare the nights",
    MERGE: "merge its chunks",
    IMAGES: "make its images",
    NIGHT: "write its night",
    SHEET: "draw its contact sheet",
}
MAX_TRIES = 3
SHEET_CELLS = 400  # more than a sheet shows at a glance: the client makes pages of them
LIMIT_S = {
    DRAW: 5.0, DIFFERENCE: 60.0,
    DEVELOP: 30.0, STABILITY: 5.0, CHECK: 30.0, COMPARE: 600.0, MERGE: 3600.0, IMAGES: 900.0,
    NIGHT: 900.0, SHEET: 900.0,
}  # fmt: skip


@dataclass(frozen=True)
class Question:
    """A request that somebody waits for.

    CHECK: of a scene's files, STABILITY: of a material, COMPARE: of two nights, DEVELOP: of the
    images of an ended cell, DRAW: of a picture (`drawing`), DIFFERENCE: of one of two films.

    The answer has `faults`, a list that is empty when all went well, and what the child reported.
    """

    kind: int
    request: JsonDict
    answer: Future[JsonDict] = field(default_factory=Future)

    def reply(self, faults: list[JsonDict], **report: Any) -> None:
        """Answer, if anybody still waits."""
        if self.answer.set_running_or_notify_cancel():
            self.answer.set_result({"faults": faults, **report})

    def wanted(self) -> JsonDict | None:
        """Return the request, or None when nobody waits any more."""
        return None if self.answer.cancelled() else self.request


@dataclass
class Task:
    """One request to the utility child."""

    kind: int
    key: int | str  # film, job or sweep
    request: Callable[[], JsonDict | None]  # None: no longer wanted
    tries: int = 0
    old_chunks: int = 0  # merges: the prefix the request starts from
    question: Question | None = None  # who asked
    seen: tuple[str, ...] = ()  # merges: jobs whose stop rules the request holds
    attempt: int | None = None  # images: the attempt of the job they are of


def _asked(task: Task) -> JsonDict | None:
    """Return what to ask for; None when nobody wants it, or its job or sweep was deleted."""
    try:
        return task.request()
    except JobNotFound:
        return None


class UtilityQueue:
    """Tasks of the utility child, in the scheduler thread."""

    def __init__(self, scheduler: Scheduler, slot: Slot) -> None:
        """Serve `scheduler` with the child in `slot`."""
        self.slot = slot
        self._scheduler = scheduler
        self._heap: list[tuple[int, int, Task]] = []
        self._order = itertools.count()
        self._tokens = itertools.count(1)
        self._known: set[tuple[int, int | str]] = set()
        self._current: tuple[int, Task] | None = None
        self._started, self._over_limit = 0.0, False

    @property
    def busy(self) -> bool:
        """Tell whether the child is at work."""
        return self._current is not None

    @property
    def length(self) -> int:
        """Tasks that wait."""
        return len(self._heap)

    # -- asking ---------------------------------------------------------------------------------
    def add_question(self, question: Question) -> None:
        """Answer a question before anything else."""
        self._add(Task(question.kind, id(question), question.wanted, question=question))

    def add_merge(self, film: FilmWork) -> None:
        """Ask for a merge of what the film has when its turn comes."""
        task = Task(MERGE, film.id, film.merge_request)
        self._add(task)

    def read_queue(self) -> None:
        """Find jobs to develop and sweeps to close."""
        for job_id in self._scheduler.db.read(jobs.jobs_to_develop):
            self._add(Task(IMAGES, job_id, partial(self.images_request, job_id)))
        self.sweeps_may_have_ended()

    def sweeps_may_have_ended(self) -> None:
        """Find sweeps whose cells have all ended."""
        for sweep_id in self._scheduler.db.read(jobs.finished_sweeps):
            for page in self._scheduler.db.read(nights.missing_pages, sweep_id):
                key = f"{sweep_id}/{page}"
                self._add(Task(NIGHT, key, partial(self._night_request, key)))
            self._add(Task(SHEET, sweep_id, partial(self._sheet_request, sweep_id)))

    def _add(self, task: Task) -> None:
        if (task.kind, task.key) not in self._known:
            self._known.add((task.kind, task.key))
            heapq.heappush(self._heap, (task.kind, next(self._order), task))

    def forget(self) -> None:
        """Drop all tasks but questions; the child that had one was killed."""
        self._heap = [entry for entry in self._heap if entry[2].question is not None]
        heapq.heapify(self._heap)
        self._known = {(task.kind, task.key) for _, _, task in self._heap}
        if self._current is not None and (asked := self._current[1].question) is not None:
            asked.reply([{"pointer": "", "code": "lost", "message": "the child was stopped"}])
        self._current = None

    def dispatch(self, now: float) -> None:
        """Give the next task to the idle child."""
        child = self.slot.child
        if child is None or not child.ready:
            return
        if self._current is not None:
            if now - self._started > LIMIT_S[self._current[1].kind] and not self._over_limit:
                self._over_limit = True
                child.kill()
            return
        if self._scheduler.disk_paused(now):
            return
        while self._heap:
            _, _, task = heapq.heappop(self._heap)
            if task.kind == MERGE:
                film = self._scheduler.films.get(int(task.key))
                task.old_chunks = film.prefix_chunks if film else 0
            request = _asked(task)
            if request is None:
                self._known.discard((task.kind, task.key))
                continue
            task.seen = tuple(job["id"] for job in request.get("jobs", ()))
            task.attempt = request.get("attempt")
            token = next(self._tokens)
            self._current, self._started = (token, task), now
            child.send(NAMES[task.kind], token=token, **request)
            return

    # -- answers --------------------------------------------------------------------------------
    def handle(self, body: JsonDict) -> None:
        """Take a report (or the exit) of the utility child."""
        if body["op"] == "exit":
            self._ended(body["code"])
            return
        if self._current is None or body.get("token") != self._current[0]:
            return
        task = self._current[1]
        if body["op"] == "done":
            handler = {
                DIFFERENCE: self._answered,
                DRAW: self._answered,
                DEVELOP: self._answered,
                STABILITY: self._answered,
                CHECK: self._answered,
                COMPARE: self._answered,
                MERGE: self._merged,
                IMAGES: self._developed,
                NIGHT: self._paged,
                SHEET: self._drawn,
            }
            try:
                stored = handler[task.kind](task, body)
            except files.FileGone:
                stored = False
            if not stored:
                self._again(task, "file_missing", "a file that was just written is gone", "")
                return
            self._finish(task)
            self.slot.failures = 0
            jobs_of = task.seen or ((str(task.key),) if task.kind == IMAGES else ())
            took = time.monotonic() - self._started
            self._scheduler.telemetry.utility(NAMES[task.kind], jobs_of, took)
        elif task.question is not None and body["permanent"]:
            self._finish(task)
            fault = {"pointer": body["pointer"], "code": body["error"], "message": body["message"]}
            task.question.reply(body["faults"] or [fault])
        elif body["error"] == "disk_full":
            self._requeue(task)
            self._scheduler.pause_for_disk(body["message"])
        elif body["error"] == "damaged_file" and task.kind in (MERGE, IMAGES):
            self._finish(task)
            self._render_again(task, body)
        elif body["permanent"]:
            self._give_up(task, JobError(body["error"], body["message"], body["pointer"]))
        else:
            tail = self.slot.child.log_tail() if self.slot.child else ""
            self._again(task, body["error"], body["message"], tail)

    def _finish(self, task: Task) -> None:
        self._known.discard((task.kind, task.key))
        self._current = None

    def _requeue(self, task: Task) -> None:
        self._current = None
        heapq.heappush(self._heap, (task.kind, next(self._order), task))

    def _again(self, task: Task, kind: str, message: str, tail: str) -> None:
        task.tries += 1
        if task.tries < (1 if task.kind in (DRAW, STABILITY) else MAX_TRIES):
            self._requeue(task)
        else:
            tries = f"gave up after {task.tries} attempts to" if task.tries > 1 else "could not"
            why = f"{tries} {WORDS[task.kind]}: {message}"
            self._give_up(task, JobError(kind, why, "", tail))

    def _give_up(self, task: Task, error: JobError) -> None:
        log.warning("%s of %s failed: %s", NAMES[task.kind], task.key, error.message)
        db = self._scheduler.db
        if task.kind == MERGE:
            if (film := self._scheduler.films.get(int(task.key))) is not None:
                film.merging = False
            self._scheduler.fail_film(int(task.key), error)
        elif task.question is not None:  # a file that kills its reader
            fault = {"pointer": "", "code": error.code, "message": error.message}
            task.question.reply([fault])
        elif task.kind == IMAGES:
            db.write(lambda c: jobs.fail_job(c, str(task.key), error))
        elif task.kind == SHEET:
            db.write(lambda c: jobs.finish_sweep(c, str(task.key), None))
        self._scheduler.garbage()
        self._finish(task)
        self.sweeps_may_have_ended()

    def _ended(self, code: int | None) -> None:
        assert self.slot.child is not None
        kind, words = self.slot.child.exit_class(code)
        tail = self.slot.child.log_tail()
        log.warning("utility child (pid %d) %s", self.slot.child.pid, words)
        self._scheduler.health.counters["children_lost"] += 1
        self._scheduler.db.measures.child_ends[kind] += 1
        if not self.slot.child.ready:
            where = self._scheduler.data.logs
            self._scheduler.health.stuck = f"the utility child does not start; see {where}"
        self._scheduler.retire(self.slot, kind)
        if self._current is not None:
            task, limit = self._current[1], LIMIT_S[self._current[1].kind]
            if self._over_limit:
                kind, words = "time_limit", f"took longer than {limit:.0f} s"
            self._over_limit = False
            task.tries -= kind == "lost"  # not the task's fault
            if task.question is not None and task.question.answer.cancelled():
                self._finish(task)
            else:
                self._again(task, kind, words, tail)

    def _answered(self, task: Task, body: JsonDict) -> bool:
        assert task.question is not None
        task.question.reply([], **{k: v for k, v in body.items() if k not in ("op", "token")})
        return True

    # -- merges ---------------------------------------------------------------------------------
    def _merged(self, task: Task, body: JsonDict) -> bool:
        s = self._scheduler
        film_id = int(task.key)
        prefix = Blob(body["digest"], body["size"]) if body["digest"] else None
        if prefix is not None and not s.folder.has(prefix.digest, prefix.size):
            return False
        film = s.films.get(film_id)
        joined = {job.id: job.prefix_spp_at_submit for job in film.jobs} if film else {}
        for ended in body["ended"]:
            ended["cached"] = 0 < ended["spp"] <= joined.get(ended["job_id"], 0)
        merged = Merged(
            film_id,
            task.old_chunks,
            body["chunks"],
            prefix,
            body["facts"],
            body["ended"],
            body["shares"],
        )
        accepted = s.db.write(lambda c: films.commit_merge(c, merged))
        if film is not None:
            told = body.get("course") if accepted else None
            film.adopt(prefix if accepted else None, body["chunks"], task.seen, told)
        s.health.counters["merges"] += 1
        s.garbage()
        if body["ended"]:
            s.wake()
        elif s.budgets.concern(film):
            s.dirty()
        return True

    def _render_again(self, task: Task, body: JsonDict) -> None:
        """Forget a damaged file; what it held is rendered again."""
        s, digest = self._scheduler, body["digest"]
        log.warning("%s; rendering what it held again", body["message"])
        s.health.counters["files_damaged"] += 1
        if task.kind == IMAGES:
            film_id = s.db.read(lambda c: films.film_of(c, str(task.key)))
        else:
            film_id = int(task.key)
        film = s.films.get(film_id)
        if film is not None and (tokens := film.forget_file(digest)):
            film.merging = False
            for token, samples in tokens.items():
                s.db.write(films.discard_file, film_id, token, samples)
        else:
            s.db.write(lambda c: films.discard_prefix(c, film_id))
            s.films.pop(film_id, None)  # read anew, with the jobs that wait again
        s.garbage()
        s.wake()

    # -- images ---------------------------------------------------------------------------------
    def images_request(self, job_id: str, on_demand: bool = False) -> JsonDict | None:
        """Describe the images of a job; None if they are not to be made now."""

        def read(c: Any) -> JsonDict | None:
            job = views.get_job(c, job_id)
            film = files.find_reference(c, ("job", job_id), "film")
            wanted = JobState.SUCCEEDED if on_demand else JobState.RUNNING
            if job.state is not wanted or film is None:
                return None
            return self._film_of(c, job, film)

        return self._scheduler.db.read(read)

    def samples_request(self, job_id: str) -> JsonDict | None:
        """Describe a job's film as it stands, merged samples of an unended one; None without."""

        def read(c: Any) -> JsonDict | None:
            job = views.get_job(c, job_id)
            if film := files.find_reference(c, ("job", job_id), "film"):
                return self._film_of(c, job, film)
            row, prefix = films.merged_so_far(c, job_id)
            return self._film_of(c, job, prefix) | {"record": row} if prefix and job.spp else None

        return self._scheduler.db.read(read)

    def _film_of(self, c: Any, job: Job, film: Blob) -> JsonDict:
        return views.job_facts(c, job.id) | {
            "film": film.digest,
            "attempt": job.attempt,
            "threads": self._scheduler.options.children * self._scheduler.options.threads,
            "job": {
                "id": job.id,
                "label": job.label,
                "stop": job.stop,
                "stop_reason": job.stop_reason,
                "cached": job.cached,
                "film_key": job.film_key,
                "spp": job.spp,
                "seconds": job.seconds,
                "parameters": job.parameters,
                "sweep_id": job.sweep_id,
                "cell": job.cell,
            },
        }

    def _developed(self, task: Task, body: JsonDict) -> bool:
        s = self._scheduler
        made = {kind: Blob(digest, size) for kind, (digest, size) in body["files"].items()}
        if not all(s.folder.has(b.digest, b.size) for b in made.values()):
            return False
        if s.db.write(lambda c: jobs.finish_job(c, str(task.key), made, task.attempt)):
            s.health.counters["jobs_succeeded"] += 1
        s.wake()  # what waited for it may begin; one requeued meanwhile is developed again
        s.garbage()
        self.sweeps_may_have_ended()
        return True

    # -- nights ---------------------------------------------------------------------------------
    def _night_request(self, key: str) -> JsonDict:
        sweep_id, page = key.split("/")
        rows = self._scheduler.db.read(lambda c: nights.page_rows(c, sweep_id, int(page)))
        return {"cells": rows}

    def _paged(self, task: Task, body: JsonDict) -> bool:
        s, (sweep_id, page) = self._scheduler, str(task.key).split("/")
        blob = Blob(body["digest"], body["size"])
        if not s.folder.has(blob.digest, blob.size):
            return False
        s.db.write(lambda c: nights.add_page(c, sweep_id, int(page), blob))
        s.garbage()
        return True

    # -- sheets ---------------------------------------------------------------------------------
    def _sheet_request(self, sweep_id: str) -> JsonDict | None:
        """Describe a sweep's contact sheet; close a large sweep without."""
        cells = self._scheduler.db.read(lambda c: views.get_sweep(c, sweep_id)).cells
        if cells > SHEET_CELLS:
            self._scheduler.db.write(lambda c: jobs.finish_sweep(c, sweep_id, None))
            return None

        def read(c: Any) -> JsonDict:
            sweep = views.get_sweep(c, sweep_id)
            cells = []
            for job in views.list_jobs(c, None, sweep_id, None, sweep.cells):
                image = files.find_reference(c, ("job", job.id), "image.png")
                film = files.find_reference(c, ("job", job.id), "film") if not image else None
                cells.append(
                    {
                        "image": image.digest if image else None,
                        "film": self._film_of(c, job, film) if film else None,
                        "state": job.state.value,
                        "label": job.label,
                        "parameters": job.parameters,
                        "spp": job.spp,
                        "seconds": job.seconds,
                        "relmse": job.relmse,
                        "interval": list(job.relmse_interval) if job.relmse_interval else None,
                    }
                )
            return {
                "cells": cells,
                "columns": sweep.columns,
                "title": sweep.label,
                "axes": sweep.axes,
                "mode": sweep.mode,
            }

        return self._scheduler.db.read(read)

    def _drawn(self, task: Task, body: JsonDict) -> bool:
        s = self._scheduler
        sheet = Blob(body["digest"], body["size"])
        if not s.folder.has(sheet.digest, sheet.size):
            return False
        s.db.write(lambda c: jobs.finish_sweep(c, str(task.key), sheet))
        return True
