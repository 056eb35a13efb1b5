"""The part of the engine that has pictures drawn for somebody who waits: nothing is stored.

The utility child draws; the newest pictures stay in memory, so that a page that is looked at twice
costs one drawing.
"""

from __future__ import annotations

import hashlib
import json
import threading
from base64 import b64decode
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from matiere.errors import Fault, SceneValidationError
from matiere.jobs.errors import Busy, JobNotFound, JobsError, NotReadyYet
from matiere.jobs.job import Job, JsonDict, Sweep
from matiere.jobs.store import files, views
from matiere.jobs.store.files import Blob

if TYPE_CHECKING:
    from matiere.jobs.datadir import DataDir
    from matiere.jobs.scheduler import Scheduler
    from matiere.jobs.store.database import Database

KEPT_BYTES = 48 * 2**20
PREVIEW_PX = 960
# What the child reports of itself, not of the request.
BREAKDOWNS = (
    "lost", "signal", "python_error", "out_of_memory", "memory_limit", "unresponsive", "disk_full",
)  # fmt: skip


@dataclass(frozen=True)
class Picture:
    """A drawn picture: its bytes, what it is, a tag that changes with them, and a report."""

    data: bytes
    media_type: str
    tag: str
    report: JsonDict = field(default_factory=dict)


class Album:
    """The newest pictures, up to so many bytes."""

    def __init__(self) -> None:
        """Start empty."""
        self._held: OrderedDict[str, Picture] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    def get(self, key: str) -> Picture | None:
        """Return a picture drawn lately."""
        with self._lock:
            if key in self._held:
                self._held.move_to_end(key)
            return self._held.get(key)

    def keep(self, key: str, picture: Picture) -> None:
        """Keep a picture while there is room."""
        with self._lock:
            if key not in self._held:
                self._bytes += len(picture.data)
            self._held[key] = picture
            while self._bytes > KEPT_BYTES:
                self._bytes -= len(self._held.popitem(last=False)[1].data)


class EnginePictures:
    """Methods of `Engine`."""

    _db: Database
    _data: DataDir
    _scheduler: Scheduler
    _album: Album

    if TYPE_CHECKING:

        def get_job(self, job_id: str) -> Job: ...

        def get_sweep(self, sweep_id: str) -> Sweep: ...

    def film_picture(
        self,
        job_id: str,
        *,
        shown: Mapping[str, Any] | None = None,
        suffix: str = ".png",
        longest: int | None = None,
    ) -> Picture:
        """Draw what a job has, finished or not, through `shown` (exposure, view, display).

        With `longest` it is a JPEG whose edges are at most so many pixels. Raises `NotReadyYet`
        before the first samples, `JobNotFound` for one that has no film any more, `Busy`, and
        MatiereError for an unknown view.
        """
        how: JsonDict = {"shown": dict(shown or {}), "suffix": ".jpg" if longest else suffix}
        how |= {"longest": longest}
        kind = "image/png" if how["suffix"] == ".png" else "image/jpeg"
        ended, output = self._db.read(lambda c: _image_of(c, job_id))
        if ended is not None:  # just what its certificate is about; a film may have gone on
            request = {"what": "image", "image": ended.digest, "output": output, **how}
            return self._draw(request, kind, [ended.digest, output, how], job_id)
        film = self._film(job_id)
        name = [film["film"], film["record"], film["output"], how]
        return self._draw({"what": "film", "film": film, **how}, kind, name, job_id)

    def difference_picture(self, a: str, b: str) -> Picture:
        """Compare the films of two jobs (`mt.compare`, b against a): picture and `report`."""
        films = [self._film(a), self._film(b)]
        request = {"what": "difference", "a": films[0], "b": films[1]}
        name = [[film["film"], film["record"]] for film in films]
        return self._draw(request, "image/png", ["difference", *name], a, b)

    def cell_difference(self, sweep_id: str, cell: int) -> Picture:
        """Compare a cell of a sweep with its baseline, as `difference_picture` does.

        Raises `JobNotFound` (no such sweep or cell, no baseline, no samples kept), `NotReadyYet`
        or `Busy`.
        """
        sweep = self.get_sweep(sweep_id)
        if sweep.baseline is None:
            raise JobNotFound(f"sweep {sweep_id} has no baseline to compare with")
        if not 0 <= cell < sweep.cells or cell == sweep.baseline:
            why = "is the baseline" if cell == sweep.baseline else f"is none of {sweep.cells}"
            raise JobNotFound(f"cell {cell} {why}: it has no difference image")
        a, b = (self._ended_cell(sweep_id, number) for number in (sweep.baseline, cell))
        return self.difference_picture(a, b)

    def ball_picture(self, material: Mapping[str, Any]) -> Picture:
        """Render a small ball of a material, given as in a scene. Raises SceneValidationError."""
        request = {"what": "ball", "material": dict(material), "root": str(self._data.view({}))}
        return self._draw(request, "image/png", ["ball", request["material"]])

    def _ended_cell(self, sweep_id: str, cell: int) -> str:
        job = self._db.read(lambda c: views.cell_of(c, sweep_id, cell))
        if job is None or not job.state.final:
            raise NotReadyYet(f"cell {cell} of sweep {sweep_id} has not ended")
        return job.id

    def _film(self, job_id: str) -> JsonDict:
        job = self.get_job(job_id)
        found = self._scheduler.utility.samples_request(job_id)
        if found is not None:
            return found
        if job.state.final:
            raise JobNotFound(f"job {job_id} is {job.state} and no samples of it are kept")
        raise NotReadyYet(f"job {job_id} is {job.state.value} and has no samples yet")

    def _draw(self, request: JsonDict, kind: str, name: list[Any], *job_ids: str) -> Picture:
        key = hashlib.sha256(json.dumps(name, sort_keys=True).encode()).hexdigest()
        if (known := self._album.get(key)) is not None:
            return known
        answer = self._scheduler.draw(request)
        if answer["faults"]:
            for job_id in job_ids:
                self.get_job(job_id)  # raises if it was deleted meanwhile
            raise _fault(answer["faults"])
        made = Picture(b64decode(answer["picture"]), kind, key[:32], answer.get("report", {}))
        self._album.keep(key, made)
        return made


def _image_of(c: Any, job_id: str) -> tuple[Blob | None, JsonDict]:
    """Return the linear image of an ended job and how it is shown."""
    found = files.find_reference(c, ("job", job_id), "image.exr")
    return found, views.job_output(c, job_id) if found else {}


def _fault(faults: list[JsonDict]) -> Exception:
    first = faults[0]
    if first["code"] == "time_limit":
        return Busy(first["message"], code="too_many_pictures")
    if first["code"] in (*BREAKDOWNS, "damaged_file"):
        return JobsError(first["message"], code=first["code"])
    if "pointer" in first and (first["pointer"] or len(faults) > 1):
        return SceneValidationError(
            Fault(f["pointer"], f["code"], f["message"], f.get("suggestion")) for f in faults
        )
    return JobsError(first["message"], code=first["code"])
