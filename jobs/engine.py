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

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

from matiere.jobs.job import (
    DEFAULT_PRIORITY,
    Artifact,
    Event,
    Job,
    JobState,
    JsonDict,
    Readiness,
    Sweep,
)


def open_engine(
    data_dir: str | Path,
    *,
    children: int | None = None,
    threads_per_child: int = 1,
    url: str | None = None,
    database_url: str | None = None,
    min_free_bytes: int = 512 * 2**20,
) -> Engine:
    """Lock `data_dir`, migrate its store, resume its films, start the children.

    `children` defaults to usable cores / `threads_per_child`; `url` is written to `server.json`
    for other commands to find (it may be set later by `Engine.announce`). Raises `DataDirLocked`
    (with `url` and `pid` of the holder), `StoreError` (store newer than the program, damaged, or
    on a network file system).
    """
    raise NotImplementedError


class Engine:
    """An open job queue; make one with `open_engine`."""

    data_dir: Path
    children: int
    threads_per_child: int

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

    def announce(self, url: str) -> None:
        """Write `server.json` (url, pid) so that other commands find this engine."""
        raise NotImplementedError

    def drain(self, timeout_s: float = 8.0) -> bool:
        """Refuse new work, let running claims end, tell whether all ended within the time."""
        raise NotImplementedError

    def close(self) -> None:
        """Stop children and threads, close the store, release the lock. Safe to call twice."""
        raise NotImplementedError

    def readiness(self) -> Readiness:
        """Check a write transaction, an artifact write, a child's heartbeat, space, draining."""
        raise NotImplementedError

    def status(self) -> JsonDict:
        """Return JSON-able facts: children (pid, state, job), queue counts, disk, counters."""
        raise NotImplementedError

    # -- jobs ---------------------------------------------------------------------------------
    def submit_job(
        self,
        scene: Mapping[str, Any],
        *,
        stop: Mapping[str, Any] | None = None,
        assets: Mapping[str, str] | None = None,
        priority: int = DEFAULT_PRIORITY,
        label: str = "",
        idempotency_key: str | None = None,
    ) -> Job:
        """Validate, pin and queue one scene; the job is durable when this returns.

        `stop` holds any of `spp`, `seconds`, `target_error` and overrides the scene's `render`
        section. `priority` is 0..100, higher first. Pointers in errors are relative to the scene
        or to `stop` (prefix `/stop`). Raises `SceneValidationError` (all errors at once),
        `AssetMissing`, `IdempotencyConflict`, `DiskFull`, `Draining`.
        """
        raise NotImplementedError

    def get_job(self, job_id: str) -> Job:
        """Return a job. Raises `JobNotFound`."""
        raise NotImplementedError

    def list_jobs(
        self,
        *,
        state: JobState | None = None,
        sweep_id: str | None = None,
        after: str | None = None,
        limit: int = 100,
    ) -> list[Job]:
        """List jobs, newest first; cells of a sweep by cell index. `after` is the last id seen."""
        raise NotImplementedError

    def cancel_job(self, job_id: str) -> Job:
        """Cancel a live job; a film that another job wants goes on. An ended job is unchanged."""
        raise NotImplementedError

    def wait_job(self, job_id: str, timeout_s: float | None = None) -> Job:
        """Return the job once it has ended, or as it is when the time is up."""
        raise NotImplementedError

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
        idempotency_key: str | None = None,
    ) -> Sweep:
        """Queue one job per cell, all or none.

        An axis is `{"pointer": "/materials/ball/alpha", "values": [...]}` or `"linspace"`/
        `"logspace"`: `[first, last, count]`, with optional `"label"` and `"labels"` (one text per
        value). `pointer` may be a list of pointers that take the same value. Every cell's scene
        is validated; errors carry `/axes/0/values/3`-like or scene pointers.
        """
        raise NotImplementedError

    def get_sweep(self, sweep_id: str) -> Sweep:
        """Return a sweep with the counts of its cells. Raises `JobNotFound`."""
        raise NotImplementedError

    def list_sweeps(self, *, after: str | None = None, limit: int = 100) -> list[Sweep]:
        """List sweeps, newest first."""
        raise NotImplementedError

    def cancel_sweep(self, sweep_id: str) -> Sweep:
        """Cancel every live cell."""
        raise NotImplementedError

    def wait_sweep(self, sweep_id: str, timeout_s: float | None = None) -> Sweep:
        """Return the sweep once all cells and its contact sheet are done, or when time is up."""
        raise NotImplementedError

    # -- results ------------------------------------------------------------------------------
    def artifact(self, job_id: str, kind: str) -> Artifact:
        """Return `image.png`, `image.exr`, `report.json` or `error.svg` of an ended job.

        Raises `JobNotFound` (no such job, or it failed or was cancelled) or `NotReadyYet`.
        """
        raise NotImplementedError

    def sweep_artifact(self, sweep_id: str, kind: str = "contact-sheet.png") -> Artifact:
        """Return an artifact of a sweep; raises `NotReadyYet` until its cells have ended."""
        raise NotImplementedError

    def events(
        self,
        after: int = 0,
        *,
        job_id: str | None = None,
        sweep_id: str | None = None,
        limit: int = 500,
        wait_s: float = 0.0,
    ) -> list[Event]:
        """Return events with `seq > after`, waiting up to `wait_s` for the first."""
        raise NotImplementedError

    # -- assets -------------------------------------------------------------------------------
    def missing_assets(self, digests: Iterable[str]) -> list[str]:
        """Return those SHA-256 digests (lower-case hex) that must still be uploaded."""
        raise NotImplementedError

    def put_asset(self, digest: str, stream: Iterable[bytes]) -> bool:
        """Store streamed bytes under their digest; false if they were there already.

        Raises `AssetMismatch` (nothing is kept) or `DiskFull`.
        """
        raise NotImplementedError
