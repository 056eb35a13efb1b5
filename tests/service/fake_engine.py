"""A job queue in memory, for tests of the HTTP layer alone: it renders nothing."""

from __future__ import annotations

import hashlib
import json
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from matiere.errors import Fault, SceneValidationError
from matiere.jobs.engine import Engine
from matiere.jobs.engine_gauges import Gauge
from matiere.jobs.engine_pictures import Picture
from matiere.jobs.errors import (
    Busy,
    DeletionRefused,
    Draining,
    IdempotencyConflict,
    JobNotFound,
    JobsError,
    NotReadyYet,
)
from matiere.jobs.job import (
    ARTIFACT_MEDIA_TYPES,
    Artifact,
    Check,
    Event,
    Job,
    JobError,
    JobState,
    Readiness,
    Sweep,
    check_transition,
)
from matiere.jobs.keys import KeyNotFound
from matiere.jobs.measure import Measures
from matiere.jobs.store.history import Attempt
from matiere.jobs.uploads import Uploads

FILES = ("image.png", "image.exr", "report.json", "error.svg", "thumbnail.jpg")
MAX_ASSET_BYTES = 100_000  # what the served application of the tests allows
BODY_TIMEOUT_S = 0.5


class NoKeys:
    """The keys of a store that has none."""

    def list(self) -> list[Any]:
        """Return none."""
        return []

    def get(self, key_id: str) -> Any:
        """Find none."""
        raise KeyNotFound(key_id)


class _Folder:
    """The part of a data directory that holds assets."""

    def __init__(self, root: Path) -> None:
        self.assets = root / "assets"
        self.assets.mkdir(exist_ok=True)

    def asset_path(self, digest: str) -> Path:
        return self.assets / ".sha256" / digest[:2] / digest


class FakeEngine(Engine):
    """Keeps jobs, sweeps and assets in dicts; `finish` ends a job by hand."""

    def __init__(self, folder: Path) -> None:
        self.data_dir = folder
        self.children, self.threads_per_child = 1, 1
        self.jobs: dict[str, Job] = {}
        self.sweeps: dict[str, Sweep] = {}
        self.uploads = Uploads(_Folder(folder), 0)  # type: ignore[arg-type]
        self.repeats: dict[str, tuple[str, str]] = {}
        self.is_draining = False
        self.failing: Exception | None = None  # raised by the next submission
        self.gate: threading.Event | None = None  # held submissions wait for it
        self.submissions = 0
        self.some_keys: Any = None

    @property
    def keys(self) -> Any:
        """Return the keys that a test gave, or none."""
        return self.some_keys or NoKeys()

    def close(self) -> None:
        """Do nothing."""

    def submit_job(
        self,
        scene: Mapping[str, Any],
        *,
        stop: Mapping[str, Any] | None = None,
        assets: Mapping[str, str] | None = None,
        priority: int = 50,
        label: str = "",
        deadline: float | str | None = None,
        after: Sequence[str] = (),
        idempotency_key: str | None = None,
        owner: str | None = None,
    ) -> Job:
        """Keep a job."""
        if self.gate is not None:
            self.gate.wait(10)
        if self.failing is not None:
            raise self.failing
        if self.is_draining:
            raise Draining("the service is stopping")
        if scene.get("version") != 1:
            raise SceneValidationError([Fault("/version", "literal_error", "must be 1")])
        body = json.dumps([scene, stop, assets, priority, label], sort_keys=True, default=str)
        if idempotency_key in self.repeats:
            known, job_id = self.repeats[idempotency_key]
            if known != body:
                raise IdempotencyConflict("the key was used with another request")
            return self.jobs[job_id]
        job = self._keep(label, priority, dict(stop or {}))
        if idempotency_key is not None:
            self.repeats[idempotency_key] = (body, job.id)
        return job

    def _keep(self, label: str, priority: int, stop: dict[str, Any], **more: Any) -> Job:
        self.submissions += 1
        job = Job(
            id=f"019aaaaa-0000-7000-8000-{len(self.jobs):012d}",
            state=JobState.QUEUED,
            label=label,
            priority=priority,
            stop=stop,
            width=8,
            height=8,
            film_key="0" * 64,
            cached=False,
            created=time.time(),
            started=None,
            finished=None,
            spp=0,
            progress=0.0,
            seconds=0.0,
            relmse=None,
            relmse_interval=None,
            stop_reason=None,
            error=None,
            sweep_id=more.get("sweep_id"),
            cell=more.get("cell"),
            parameters=more.get("parameters", {}),
            artifacts=(),
        )
        self.jobs[job.id] = job
        return job

    def finish(self, job_id: str, state: JobState = JobState.SUCCEEDED) -> Job:
        """End a job; a success has all files."""
        ok = state is JobState.SUCCEEDED
        job = replace(
            self.jobs[job_id],
            state=state,
            started=time.time(),
            finished=time.time(),
            spp=16 if ok else 0,
            progress=1.0,
            relmse=0.01 if ok else None,
            relmse_interval=(0.009, 0.011) if ok else None,
            stop_reason="spp" if ok else None,
            error=None if ok else JobError("crashed", "the child crashed 3 times"),
            artifacts=FILES if ok else (),
        )
        self.jobs[job_id] = job
        return job

    def recent_job(self, job_id: str) -> None:
        """Remember nothing."""

    def get_job(self, job_id: str) -> Job:
        """Return a job."""
        if job_id not in self.jobs:
            raise JobNotFound(job_id)
        return self.jobs[job_id]

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
        """List jobs, newest first."""
        jobs = [
            job
            for job in self.jobs.values()
            if (state is None or job.state == state)
            and (sweep_id is None or job.sweep_id == sweep_id)
            and (label is None or job.label == label)
        ]
        jobs.sort(key=lambda job: job.id, reverse=sweep_id is None and order != "created")
        if after is not None:
            ids = [job.id for job in jobs]
            jobs = jobs[ids.index(after) + 1 :]
        return jobs[:limit]

    def cancel_job(self, job_id: str) -> Job:
        """Cancel a live job."""
        job = self.get_job(job_id)
        if not job.state.final:
            job = self.finish(job_id, JobState.CANCELLED)
        return job

    def pause_job(self, job_id: str) -> Job:
        """Pause a job."""
        return self._change(job_id, JobState.PAUSED)

    def resume_job(self, job_id: str) -> Job:
        """Queue a job again."""
        return self._change(job_id, JobState.QUEUED)

    def requeue_job(self, job_id: str) -> Job:
        """Queue a job again."""
        return self._change(job_id, JobState.QUEUED)

    def _change(self, job_id: str, state: JobState) -> Job:
        job = self.get_job(job_id)
        check_transition(job.state, state)
        self.jobs[job_id] = replace(job, state=state)
        return self.jobs[job_id]

    def set_priority(self, job_id: str, priority: int) -> Job:
        """Change a priority."""
        self.jobs[job_id] = replace(self.get_job(job_id), priority=priority)
        return self.jobs[job_id]

    def submit_sweep(
        self,
        base: Mapping[str, Any],
        axes: Sequence[Mapping[str, Any]],
        *,
        mode: str = "grid",
        stop: Mapping[str, Any] | None = None,
        assets: Mapping[str, str] | None = None,
        priority: int = 50,
        label: str = "",
        columns: int | None = None,
        deadline: float | str | None = None,
        after: Sequence[str] = (),
        idempotency_key: str | None = None,
        owner: str | None = None,
        **language: Any,
    ) -> Sweep:
        """Keep a sweep along its first axis."""
        if not axes:
            raise SceneValidationError([Fault("/axes", "wrong_length", "a sweep needs axes")])
        if base.get("version") != 1:
            raise SceneValidationError([Fault("/version", "literal_error", "must be 1")])
        if axes[0]["pointer"] == "/nowhere":
            raise SceneValidationError([Fault("/axes/0/pointer", "pointer", "no such value")])
        sweep_id = f"019bbbbb-0000-7000-8000-{len(self.sweeps):012d}"
        for index, value in enumerate(axes[0].get("values", [])):
            self._keep(
                str(value), priority, {}, sweep_id=sweep_id, cell=index, parameters={"x": value}
            )
        self.sweeps[sweep_id] = Sweep(
            id=sweep_id,
            label=label,
            mode=mode,
            axes=[
                {"label": "x", "labels": [str(v) for v in axis.get("values", [])], **axis}
                for axis in axes
            ],
            cells=len(axes[0].get("values", [])),
            counts={},
            created=time.time(),
            finished=None,
            columns=columns or 4,
            artifacts=(),
            baseline=language.get("baseline"),
        )
        return self.get_sweep(sweep_id)

    def get_sweep(self, sweep_id: str) -> Sweep:
        """Return a sweep with fresh counts."""
        if sweep_id not in self.sweeps:
            raise JobNotFound(sweep_id)
        sweep = self.sweeps[sweep_id]
        states = [job.state for job in self.jobs.values() if job.sweep_id == sweep_id]
        sweep = replace(sweep, counts={str(s): states.count(s) for s in JobState})
        return replace(sweep, artifacts=("contact-sheet.png",) if sweep.done else ())

    def list_sweeps(
        self,
        *,
        after: str | None = None,
        limit: int = 100,
        label: str | None = None,
        order: str | None = None,
    ) -> list[Sweep]:
        """List sweeps, newest first."""
        ids = sorted(self.sweeps, reverse=True)
        if after is not None:
            ids = ids[ids.index(after) + 1 :]
        return [self.get_sweep(sweep_id) for sweep_id in ids[:limit]]

    def cancel_sweep(self, sweep_id: str) -> Sweep:
        """Cancel the live cells."""
        for job in list(self.jobs.values()):
            if job.sweep_id == sweep_id:
                self.cancel_job(job.id)
        return self.get_sweep(sweep_id)

    def delete_job(self, job_id: str) -> None:
        """Forget a job that is no cell."""
        if self.get_job(job_id).sweep_id is not None:
            raise DeletionRefused("the job is a cell", code="part_of_sweep")
        del self.jobs[job_id]

    def delete_sweep(self, sweep_id: str) -> None:
        """Forget a sweep and its cells."""
        self.get_sweep(sweep_id)
        del self.sweeps[sweep_id]
        self.jobs = {name: job for name, job in self.jobs.items() if job.sweep_id != sweep_id}

    def attempts(
        self, job_id: str, *, after: int = 0, limit: int = 100, newest: bool = False
    ) -> list[Attempt]:
        """Return three claims of any job."""
        self.get_job(job_id)
        made = [Attempt(n, "merged", 1, 4, 99, "x", 1.0, 2.0, 0.5, None, None, "") for n in (1, 2)]
        made += [Attempt(3, "failed", 1, 4, 99, "x", 3.0, 4.0, None, "signal", "crashed", "oh")]
        return [one for one in made if one.token > after][:limit]

    def log(self, job_id: str, most_bytes: int) -> str:
        """Return lines."""
        self.get_job(job_id)
        return "one\ntwo\n"[-most_bytes:]

    def artifact(self, job_id: str, kind: str) -> Artifact:
        """Return a file of a succeeded job."""
        job = self.get_job(job_id)
        if not job.state.final:
            raise NotReadyYet("not yet")
        return self._file(kind, f"{kind} of {job_id}")

    def sweep_artifact(self, sweep_id: str, kind: str = "contact-sheet.png") -> Artifact:
        """Return the contact sheet of a finished sweep."""
        if not self.get_sweep(sweep_id).done:
            raise NotReadyYet("not yet")
        return self._file(kind, f"{kind} of {sweep_id}")

    def cell_difference(self, sweep_id: str, cell: int) -> Picture:
        """Return a picture of a cell and the baseline."""
        sweep = self.get_sweep(sweep_id)
        if sweep.baseline is None or not 0 <= cell < sweep.cells or cell == sweep.baseline:
            raise JobNotFound("no difference")
        if not sweep.done:
            raise NotReadyYet("not yet")
        return Picture(f"difference of {cell}".encode(), "image/png", f"tag {cell}")

    def _file(self, kind: str, text: str) -> Artifact:
        content = text.encode()
        path = self.data_dir / f"served-{kind}"
        path.write_bytes(content)
        digest = hashlib.sha256(content).hexdigest()
        return Artifact(kind, digest, len(content), str(path), ARTIFACT_MEDIA_TYPES[kind][0])

    def film_picture(self, job_id: str, **how: Any) -> Picture:
        """Return a picture of a job that has samples."""
        if self.get_job(job_id).spp == 0:
            raise NotReadyYet("no samples yet")
        return Picture(b"picture", "image/jpeg", "tag")

    def difference_picture(self, a: str, b: str) -> Picture:
        """Return a picture of two jobs."""
        return Picture(b"picture", "image/png", "tag", {"statement": f"{a} against {b}"})

    def ball_picture(self, material: Mapping[str, Any]) -> Picture:
        """Return a ball."""
        if "type" not in material:
            raise SceneValidationError([Fault("/type", "missing", "say which")])
        return Picture(b"ball", "image/png", "tag")

    def readiness(self) -> Readiness:
        """Be ready unless draining."""
        check = Check(not self.is_draining, "draining" if self.is_draining else "takes work")
        return Readiness(check.ok, {"draining": check, "store": Check(True, "written in 1 ms")})

    @property
    def measures(self) -> Measures:
        """Return that nothing was measured."""
        return Measures()

    def gauge(self) -> Gauge:
        """Return that nothing is there."""
        return Gauge({}, [], 0, [], 0, 0, 0, False, False, True, {})

    def status(self) -> dict[str, Any]:
        """Return something."""
        return {"children": [], "queued": len(self.jobs)}

    def events(
        self,
        after: int = 0,
        *,
        job_id: str | None = None,
        sweep_id: str | None = None,
        limit: int = 500,
        wait_s: float = 0.0,
    ) -> list[Event]:
        """Return none."""
        return []

    def event_range(self) -> tuple[int, int]:
        """Return nothing."""
        return 0, 0

    def snapshot(
        self, *, job_id: str | None = None, sweep_id: str | None = None
    ) -> tuple[int, Job | Sweep | dict[str, int]]:
        """Return a job, a sweep or nothing."""
        if job_id is not None:
            return 0, self.get_job(job_id)
        return 0, self.get_sweep(sweep_id) if sweep_id is not None else {}

    def watch(self, callback: Callable[[], None]) -> Callable[[], None]:
        """Never call."""
        return lambda: None

    @property
    def assets(self) -> set[str]:
        """The digests that are held."""
        return {path.name for path in (self.data_dir / "assets").glob(".sha256/*/*")}

    def check_material(
        self,
        material: Mapping[str, Any],
        *,
        seed: int = 1,
        plots: bool = False,
        assets: Mapping[str, str] | None = None,
    ) -> dict[str, Any]:
        """Answer as told by the material's type."""
        if material.get("type") == "busy":
            raise Busy("the service is checking another material")
        if material.get("type") == "broken":
            raise JobsError("the child crashed", code="signal")
        if material.get("type") != "lambert":
            raise SceneValidationError([Fault("/type", "unknown_type", "no such type")])
        report: dict[str, Any] = {
            "version": 1, "material": dict(material), "verdict": "pass", "reason": "", "seconds": 1,
            "findings": [], "limits": [], "views": [], "furnace": [],
        }  # fmt: skip
        return report | ({"plots": {"polar": f"<svg>{seed}</svg>"}} if plots else {})

    def night(self, sweep_id: str) -> tuple[dict[str, Any], list[Artifact]]:
        """Return a night of one page, once every cell has ended."""
        sweep = self.get_sweep(sweep_id)
        if not sweep.done:
            raise NotReadyYet(f"sweep {sweep_id} has cells that have not ended")
        head = {"name": sweep.label, "sweep_id": sweep_id, "created": 1.0, "cells": sweep.cells}
        return head, [self._file("night", f"night of {sweep_id}")]

    def compare_sweeps(self, a: str, b: str, options: Mapping[str, Any]) -> dict[str, Any]:
        """Answer what was asked; be busy when a sweep is compared with itself."""
        if a == b:
            raise Busy("the service is comparing other nights")
        return {"a": a, "b": b, **options}
