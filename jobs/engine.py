"""The face of the job queue: what the HTTP service, `matiere sweep` and the tests talk to.

One `Engine` owns one data directory (an exclusive lock), the only database writer, a scheduler
thread, N render children and one utility child. It touches no pixels itself. All methods are
synchronous, thread-safe and short; nothing here waits for a render except `wait_job` and
`wait_sweep`. Plain `def` endpoints may call them from a thread pool.

    with open_engine("demo-out/data", children=2) as engine:
        job = engine.submit_job(scene, stop={"spp": 64})
        job = engine.wait_job(job.id)
        print(engine.artifact(job.id, "image.png").path)

Assets. A scene names files (`"file": "ball.glb"`). The caller passes `assets={"ball.glb": sha256}`
after `put_asset` of each digest that `missing_assets` lists; a name not in the map is looked up as
a file below `<data>/assets`. Either way the digest is pinned at submission, and a child that reads
other bytes fails the job as `asset_changed`.
"""

from __future__ import annotations

import importlib
import logging
import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

from uuid6 import uuid7

from matiere.errors import Fault, SceneValidationError
from matiere.jobs import deadline as deadlines
from matiere.jobs import tracing
from matiere.jobs.cluster.member import cluster_of
from matiere.jobs.controls import Controls
from matiere.jobs.datadir import DataDir
from matiere.jobs.engine_access import EngineAccess
from matiere.jobs.engine_gauges import Gauges
from matiere.jobs.engine_history import EngineHistory
from matiere.jobs.engine_nights import EngineNights
from matiere.jobs.engine_pictures import BREAKDOWNS, Album, EnginePictures
from matiere.jobs.errors import (
    Busy,
    Draining,
    JobNotFound,
    JobsError,
    NotReadyYet,
)
from matiere.jobs.feed import Feed
from matiere.jobs.job import (
    ARTIFACT_MEDIA_TYPES,
    DEFAULT_PRIORITY,
    IMAGES,
    Artifact,
    Check,
    Job,
    JobState,
    JsonDict,
    Readiness,
    Sweep,
)
from matiere.jobs.limits import Limits
from matiere.jobs.recent import Recent
from matiere.jobs.rules import Rules
from matiere.jobs.scheduler import Scheduler
from matiere.jobs.slots import Options
from matiere.jobs.storage import Janitor, Storage
from matiere.jobs.store import batches, cells, files, films, jobs, views
from matiere.jobs.store.database import Database
from matiere.jobs.submission import Request, Submitter, body_hash
from matiere.jobs.term import Term
from matiere.jobs.uploads import Uploads

log = logging.getLogger("matiere.jobs.engine")
DEFAULT_WORK = "matiere.jobs.work"
MIN_FREE_BYTES = 2 * 10**9
MEMORY_SHARE = 8  # merging holds a film up to three times


def open_engine(
    data_dir: str | Path,
    *,
    children: int | None = None,
    threads_per_child: int = 1,
    url: str | None = None,
    database_url: str | None = None,
    artifacts_url: str | None = None,
    min_free_bytes: int = MIN_FREE_BYTES,
    rules: Rules | None = None,
    max_film_bytes: int | None = None,
    limits: Limits | None = None,
    child_memory_bytes: int | None = None,
    claim_limit_s: float = 3600.0,
    executor: str = "local",
    ray_address: str | None = None,
    webhooks: bool = False,
    work: str = DEFAULT_WORK,
) -> Engine:
    """Lock `data_dir`, migrate its store, resume its films, start the children.

    `children` defaults to usable cores / `threads_per_child`; `url` is written to `server.json`
    for other commands to find (it may be set later by `Engine.announce`). Raises `DataDirLocked`
    (with `url` and `pid` of the holder), `StoreError` (store newer than the program, damaged, or
    on a network file system). Below `min_free_bytes` of free disk no new work is handed out;
    `rules` say how long results and films are kept;
    films above `max_film_bytes` (an eighth of the memory) are refused, as is what is above
    `limits`. A child that uses more than `child_memory_bytes`, or works on one claim for more than
    `claim_limit_s`, is killed, which counts as a failed attempt (`memory_limit`, `time_limit`); by
    default only all children together have a limit, three quarters of the memory. With
    `executor="ray"` claims are rendered by the Ray cluster at `ray_address` (none: the one this
    machine is part of), at most `children` at once if that is given. With `webhooks` events go to
    the outbox, too. `work` names the module that renders; only tests give another.
    """
    child = (child_memory_bytes or 0, claim_limit_s)
    cluster = cluster_of(executor, ray_address, children, *child)
    threads = max(1, threads_per_child)
    count = children or max(1, len(os.sched_getaffinity(0)) // threads)
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    data = DataDir.open(data_dir, artifacts_url)
    try:
        database = Database(data.store if database_url is None else None, database_url)
    except BaseException:
        data.close()
        raise
    database.outbox = webhooks
    rules = replace(rules or Rules(), min_free_bytes=min_free_bytes)
    options = Options(count, threads, work, min_free_bytes, rules, *child, cluster)
    limits = limits or Limits()
    limits = replace(
        limits,
        film_bytes=max_film_bytes or limits.film_bytes or memory // MEMORY_SHARE,
        job_bytes=limits.job_bytes or memory // 2,
    )
    engine = Engine(data, database, options, limits)
    if url is not None:
        engine.announce(url)
    return engine


class Engine(Controls, EngineAccess, EngineHistory, EngineNights, EnginePictures, Feed, Gauges):
    """An open job queue; make one with `open_engine`."""

    def __init__(self, data: DataDir, database: Database, options: Options, limits: Limits) -> None:
        """Use `open_engine`."""
        self.data_dir, self.children = data.root, options.children
        self.threads_per_child = options.threads
        self._data, self._db = data, database
        self._closed, self._limits = False, limits
        self._follow()
        self._recent: Recent[Job] = Recent(None if database.shared else lambda: self._version)
        self._album = Album()
        self.uploads = Uploads(data, options.min_free_bytes)
        module = importlib.import_module(options.work)
        self._db.on_commit = self._notify
        term = Term(database)
        #: What the last instance left: claims and chunks voided, chunks present (done, unmerged),
        #: films begun, and the chunks these still miss to the end of their spp.
        self.resumed: JsonDict = term.found | self._begun(module)
        self._scheduler = Scheduler(database, data, options, module, term)
        self._submitter = Submitter(data, module, limits, self._scheduler.check_files)
        self._db.has_file = data.artifacts.has
        self._janitor = Janitor(self.storage, lambda: self._scheduler.term.running)
        self._scheduler.on_low_disk = self._janitor.hurry
        self._scheduler.start()
        self._janitor.start()

    # -- life ---------------------------------------------------------------------------------
    def __enter__(self) -> Engine:
        """Return self; `close` on leaving."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the engine."""
        self.close()

    def announce(self, url: str, **more: str | None) -> None:
        """Write `server.json` (url, pid, ...) so that other commands find this engine."""
        self._data.announce(url, **more)

    def drain(self, timeout_s: float = 8.0) -> bool:
        """Refuse new work, let running claims end, tell whether all ended within the time."""
        self._scheduler.health.draining = True
        end = time.monotonic() + timeout_s
        while not self._scheduler.idle():
            if time.monotonic() > end:
                return False
            time.sleep(0.02)
        return True

    def close(self) -> None:
        """Stop children and threads, close the store, release the lock. Safe to call twice."""
        if self._closed:
            return
        self._closed = True
        self._scheduler.health.draining = True
        self._janitor.end()
        self._scheduler.stop()
        self._scheduler.join()
        self._janitor.join()
        try:
            self._scheduler.term.end()
        except JobsError:
            pass  # a full disk: the next start sees an instance that did not end
        self._db.close()
        self._data.close()
        self._notify()

    @property
    def storage(self) -> Storage:
        """What is kept for how long: usage, collection, pins."""
        return self._scheduler.storage

    def readiness(self) -> Readiness:
        """Check a write transaction, an artifact write, a child's heartbeat, space, draining."""
        health = self._scheduler.health
        checks = {
            "accepting": Check(not (health.draining or self._closed), "takes new jobs"),
            "database": _attempt(self._db.check, "a write transaction works"),
            "artifacts": _attempt(self._write_probe, "a file can be written durably"),
            "children": self._children_check(),
            "disk": self._disk_check(),
        }
        return Readiness(all(check.ok for check in checks.values()), checks)

    def status(self) -> JsonDict:
        """Return JSON-able facts: children (pid, state, job), queue counts, disk, counters."""
        health, now = self._scheduler.health, time.monotonic()
        children = []
        for slot in (*self._scheduler.slots, self._scheduler.utility.slot):
            child = slot.child
            children.append(
                {
                    "name": slot.name,
                    "pid": child.pid if child else None,
                    "ready": bool(child and child.ready),
                    "claims": len(child.inflight) if child else 0,
                    "answered_s_ago": round(now - child.answered, 3) if child else None,
                }
            )
        usage = shutil.disk_usage(self.data_dir)
        return {
            "pid": os.getpid(),
            "data_dir": str(self.data_dir),
            "logs": str(self._data.logs),
            "children": children,
            "threads_per_child": self.threads_per_child,
            "executor": "ray" if self._scheduler.options.cluster else "local",
            "nodes": [node for s in self._scheduler.slots if s.child for node in s.child.nodes],
            "jobs": self._db.read(views.counts),
            "disk_free_bytes": usage.free,
            "disk_low": health.disk_low,
            "disk_full": self._scheduler.disk_paused(now),
            "draining": health.draining,
            "store": "postgresql" if self._db.shared else "sqlite",
            "scheduling": self._scheduler.term.running,
            "stuck": health.stuck or health.fault,
            "resumed": self.resumed,
            "counters": dict(health.counters),
        }

    # -- jobs ---------------------------------------------------------------------------------
    def submit_job(
        self,
        scene: Mapping[str, Any],
        *,
        stop: Mapping[str, Any] | None = None,
        assets: Mapping[str, str] | None = None,
        priority: int = DEFAULT_PRIORITY,
        label: str = "",
        deadline: float | str | None = None,
        after: Sequence[str] = (),
        idempotency_key: str | None = None,
        owner: str | None = None,
    ) -> Job:
        """Validate, pin and queue one scene; the job is durable when this returns.

        `stop` holds any of `spp`, `seconds`, `target_error`; given, it replaces the scene's own
        stop rule as in `mt.render`. `seconds` counts the film's render time as if all children
        worked on it (thread seconds / slots). `priority` is 0..100, higher first. At `deadline`
        (seconds from now, or a moment in RFC 3339) the job ends as `expired` with what is rendered
        by then. It begins when all jobs and sweeps in `after` (ids) have succeeded; if one does
        not, it is cancelled as `dependency_failed`. `owner` is the id of the API key that asked.
        Pointers in errors are relative to the scene, or to `stop` (prefix `/stop`) and the other
        arguments. Raises `SceneValidationError` (all errors at once), `AssetMissing`,
        `IdempotencyConflict`, `QueueFull`, `KeyLimit`, `DiskFull`, `Draining`.
        """
        self._accepting()
        moment = _given(deadline, after)
        begun = time.monotonic()
        digest = body_hash("job", scene, stop, assets, priority, label, *moment)
        key = jobs.Key(idempotency_key, digest) if idempotency_key else None
        if key is not None and (known := self._db.read(lambda c: jobs.replayed(c, key, "job"))):
            return self.get_job(known)
        ends = deadlines.parse(deadline, time.time())
        request = Request(stop, assets or {}, priority, label, ends, tuple(after))
        spec = self._submitter.job(scene, request)
        self.storage.check_room([(spec.film.width, spec.film.height, spec.film.replicates)])
        samples = float(spec.film.width * spec.film.height * spec.spp_cap)
        job_id = self._admit(1, samples, lambda c: jobs.submit_job(c, spec, key), owner)
        tracing.record("submit", job_id, time.monotonic() - begun)
        self._scheduler.wake()
        return self.get_job(job_id)

    def get_job(self, job_id: str) -> Job:
        """Return a job. Raises `JobNotFound`."""
        return self._recent.get(job_id, lambda: self._db.read(views.get_job, job_id))

    def recent_job(self, job_id: str) -> Job | None:
        """Return a job that was read since the last change, at once; None: `get_job` reads it."""
        return self._recent.peek(job_id)

    def job_scene(self, job_id: str) -> JsonDict | None:
        """Return the scene that a job renders, without its stop rule; None where it is not kept."""
        return self._db.read(lambda c: views.job_scene(c, job_id))

    def list_jobs(
        self,
        *,
        state: JobState | None = None,
        sweep_id: str | None = None,
        after: str | None = None,
        limit: int = 100,
        label: str | None = None,
        order: str | None = None,
    ) -> list[Job]:
        """List jobs, newest first; cells of a sweep by cell index.

        `order` is created, -created, finished or -finished (those that have ended). `after` is
        the `views.position` of the last one seen: its id, but where the order is by end.
        """
        how = {"label": label, "order": order}
        return self._db.read(lambda c: views.list_jobs(c, state, sweep_id, after, limit, **how))

    def wait_job(self, job_id: str, timeout_s: float | None = None) -> Job:
        """Return the job once it has ended, or as it is when the time is up."""
        return self._wait(lambda: self.get_job(job_id), lambda job: job.state.final, timeout_s)

    # -- sweeps -------------------------------------------------------------------------------
    def submit_sweep(
        self,
        base: Mapping[str, Any],
        axes: Sequence[Mapping[str, Any]],
        *,
        mode: str = "grid",
        stop: Mapping[str, Any] | None = None,
        assets: Mapping[str, str] | None = None,
        priority: int = DEFAULT_PRIORITY,
        label: str = "",
        columns: int | None = None,
        deadline: float | str | None = None,
        after: Sequence[str] = (),
        idempotency_key: str | None = None,
        owner: str | None = None,
        **language: Any,
    ) -> Sweep:
        """Queue one job per cell, all or none.

        An axis is `{"pointer": "/materials/ball/alpha", "values": [...]}` or `"linspace"`/
        `"logspace"`: `[first, last, count]`, with optional `"label"` and `"labels"` (one text per
        value). `pointer` may be a list of pointers that take the same value. `language` is the
        rest of what `parse_sweep` takes: `where`, `overrides`, `baseline`, ... Every cell's scene
        is validated; errors carry `/axes/0/values/3`-like or scene pointers.
        """
        self._accepting()
        parts = [base, axes, mode, stop, assets, priority, label, columns]
        parts += [*_given(deadline, after), *([language] if language else [])]
        digest = body_hash("sweep", *parts)
        key = jobs.Key(idempotency_key, digest) if idempotency_key else None
        if key is not None and (known := self._db.read(lambda c: jobs.replayed(c, key, "sweep"))):
            return self.get_sweep(known)
        ends = deadlines.parse(deadline, time.time())
        request = Request(stop, assets or {}, priority, label, ends, tuple(after))
        spec, rows = self._submitter.sweep(
            base, {"axes": axes, "mode": mode, **language}, request, columns
        )
        sizes = [(row["width"], row["height"], row["replicates"]) for row in rows]
        self.storage.check_room(sizes, spec.cells / len(rows))
        samples = sum(row["width"] * row["height"] * row["spp_cap"] for row in rows)
        samples *= spec.cells / len(rows)
        sweep_id = self._admit(
            spec.cells, samples, lambda c: cells.submit_sweep(c, spec, rows, key), owner
        )
        self._scheduler.wake()
        return self.get_sweep(sweep_id)

    def get_sweep(self, sweep_id: str) -> Sweep:
        """Return a sweep with the counts of its cells. Raises `JobNotFound`."""
        return self._db.read(lambda c: views.get_sweep(c, sweep_id))

    def list_sweeps(
        self,
        *,
        after: str | None = None,
        limit: int = 100,
        label: str | None = None,
        order: str | None = None,
    ) -> list[Sweep]:
        """List sweeps, newest first, or as `list_jobs`."""
        how = {"label": label, "order": order}
        return self._db.read(lambda c: views.list_sweeps(c, after, limit, **how))

    def wait_sweep(self, sweep_id: str, timeout_s: float | None = None) -> Sweep:
        """Return the sweep once all cells and its contact sheet are done, or when time is up."""
        return self._wait(
            lambda: self.get_sweep(sweep_id), lambda sweep: sweep.finished is not None, timeout_s
        )

    # -- results ------------------------------------------------------------------------------
    def artifact(self, job_id: str, kind: str) -> Artifact:
        """Return `image.png`, `image.exr`, `report.json` or `error.svg` of an ended job.

        Those of a small cell of a sweep are made when they are first asked for. Raises
        `JobNotFound` (no such job, or it failed or was cancelled), `NotReadyYet`, or `Busy` when
        the child that makes images has no time for it.
        """
        job = self.get_job(job_id)
        blob = self._db.read(lambda c: files.find_reference(c, ("job", job_id), kind))
        if blob is None and kind in IMAGES and kind in job.artifacts:
            blob = self._develop(job_id)[kind]
        if blob is None and not job.state.final:
            raise NotReadyYet(f"job {job_id} is {job.state.value}; its {kind} comes at the end")
        return self._artifact(blob, kind, f"job {job_id} {job.state.value}, without {kind}")

    def sweep_artifact(self, sweep_id: str, kind: str = "contact-sheet.png") -> Artifact:
        """Return an artifact of a sweep; raises `NotReadyYet` until its cells have ended."""
        sweep = self.get_sweep(sweep_id)
        blob = self._db.read(lambda c: files.find_reference(c, ("sweep", sweep_id), kind))
        if blob is None and sweep.finished is None:
            raise NotReadyYet(f"sweep {sweep_id} has cells that have not ended")
        return self._artifact(blob, kind, f"sweep {sweep_id} has no {kind}")

    def stream(self, artifact: Artifact) -> Iterator[bytes]:
        """Yield the bytes of an artifact, wherever it lies."""
        return self._data.artifacts.stream(artifact.digest)

    # -- assets -------------------------------------------------------------------------------
    def missing_assets(self, digests: Iterable[str]) -> list[str]:
        """Return those SHA-256 digests (lower-case hex) that must still be uploaded."""
        return [digest for digest in dict.fromkeys(digests) if not self.uploads.held(digest)]

    def check_material(
        self,
        material: Mapping[str, Any],
        *,
        seed: int = 1,
        plots: bool = False,
        assets: Mapping[str, str] | None = None,
    ) -> JsonDict:
        """Return the stability report of a material (`mt.check(...).as_dict()`), made in a child.

        With `plots` it also holds the plots as SVG. `assets` pins the files that the material
        names; others are looked up in the asset folder. Pointers in errors are relative to the
        material. Raises `SceneValidationError`, `AssetMissing`, `Busy` (one check at a time, 5
        seconds) and `Draining`.
        """
        self._accepting()
        request = {"material": dict(material), "seed": seed, "plots": plots}
        request["root"] = str(self._data.view(assets or {}))
        answer = self._scheduler.check_material(request)
        if not answer["faults"]:
            report: JsonDict = answer["report"]
            return report
        first = answer["faults"][0]
        if first["code"] == "time_limit":
            raise Busy(first["message"])
        if first["code"] in BREAKDOWNS:
            raise JobsError(first["message"], code=first["code"])
        raise SceneValidationError(
            Fault(f["pointer"], f["code"], f["message"], f.get("suggestion"))
            for f in answer["faults"]
        )

    def put_asset(self, digest: str, stream: Iterable[bytes]) -> bool:
        """Store streamed bytes under their digest; false if they were there already.

        Raises `AssetMismatch` (nothing is kept) or `DiskFull`. `uploads` takes them in pieces.
        """
        return self.uploads.whole(digest, stream)

    # -- inside -------------------------------------------------------------------------------
    def _accepting(self) -> None:
        if self._closed or self._scheduler.health.draining:
            raise Draining("the service is stopping and takes no new work; try again soon")

    def _begun(self, work: Any) -> JsonDict:
        begun = self._db.read(films.begun_films)
        missing = sum(
            max(work.plan(*size).chunk_count(cap) - merged - done, 0)
            for size, cap, merged, done in begun
        )
        return {"films_begun": len(begun), "chunks_missing": missing}

    def _develop(self, job_id: str) -> dict[str, files.Blob]:
        """Have the images of a stored film made, and keep them."""
        answer = self._scheduler.develop(job_id)
        if not answer["faults"]:
            made = {kind: files.Blob(*blob) for kind, blob in answer["files"].items()}
            self._db.write(lambda c: files.add_references(c, ("job", job_id), made))
            return made
        self.get_job(job_id)  # raises if it was deleted meanwhile
        fault = answer["faults"][0]
        if fault["code"] == "damaged_file":
            film = self._db.read(lambda c: files.find_reference(c, ("job", job_id), "film"))
            if film is not None:
                self._db.write(lambda c: batches.forget_prefix(c, film.digest))
            why = f"{fault['message']}; submit the sweep again to have it rendered anew"
            raise JobsError(why, code="damaged_file")
        raise JobsError(fault["message"], code=fault["code"])

    def _artifact(self, blob: files.Blob | None, kind: str, why_not: str) -> Artifact:
        if blob is None:
            raise JobNotFound(why_not)
        path = str(self._data.artifacts.path(blob.digest) or "")
        media_type = ARTIFACT_MEDIA_TYPES[kind][0]
        return Artifact(kind, blob.digest, blob.size, path, media_type)

    def _write_probe(self) -> None:
        digest, _ = self._data.artifacts.write([f"probe {uuid7()}".encode()])
        self._data.artifacts.remove(digest)

    def _children_check(self) -> Check:
        slots = (*self._scheduler.slots, self._scheduler.utility.slot)
        if not self._scheduler.term.running:
            slots = slots[-1:]  # render children start with the lease
        ready = sum(1 for s in slots if s.child and s.child.ready and not s.child.trouble)
        detail = f"{ready} of {len(slots)} child processes answer"
        if ready < len(slots) and self._scheduler.health.stuck:
            detail += f"; {self._scheduler.health.stuck}"
        if self._scheduler.health.fault:
            detail += f"; the scheduler fails: {self._scheduler.health.fault}"
        good = ready == len(slots) and self._scheduler.is_alive()
        return Check(good and not self._scheduler.health.fault, detail)

    def _disk_check(self) -> Check:
        if self._scheduler.disk_paused(time.monotonic()):
            return Check(False, "disk_full: a write failed a moment ago; work waits for space")
        if self._scheduler.health.disk_low:
            free = shutil.disk_usage(self.data_dir).free
            return Check(False, f"disk_low: {free / 2**20:.0f} MiB free; no new work is begun")
        return Check(True, "enough free space")


def _attempt(action: Callable[[], None], good: str) -> Check:
    try:
        action()
    except (JobsError, OSError) as error:
        return Check(False, str(error))
    return Check(True, good)


def _given(*values: Any) -> list[Any]:
    """Return what was given: a request without these hashes as it did before they were there."""
    return [[type(value).__name__, value] for value in values] if any(values) else []
