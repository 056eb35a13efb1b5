"""The part of the engine that deals with nights: their pages, and two of them compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from matiere.jobs.errors import JobNotFound, JobsError, NotReadyYet
from matiere.jobs.job import ARTIFACT_MEDIA_TYPES, Artifact, JsonDict, Sweep
from matiere.jobs.night_options import Options
from matiere.jobs.store import nights, views

if TYPE_CHECKING:
    from matiere.jobs.datadir import DataDir
    from matiere.jobs.scheduler import Scheduler
    from matiere.jobs.store.database import Database


class EngineNights:
    """Methods of `Engine`."""

    _db: Database
    _data: DataDir
    _scheduler: Scheduler

    def night(self, sweep_id: str) -> tuple[JsonDict, list[Artifact]]:
        """Return the head of a sweep's night and its pages, in order (`matiere.jobs.night`).

        Raises `JobNotFound`, or `NotReadyYet` while cells have not ended.
        """

        def read(c: Any) -> tuple[Sweep, list[Any]]:
            return views.get_sweep(c, sweep_id), nights.pages(c, sweep_id)

        sweep, blobs = self._db.read(read)
        if not blobs and sweep.finished is None:
            raise NotReadyYet(f"sweep {sweep_id} has cells that have not ended")
        if not blobs:
            raise JobNotFound(f"sweep {sweep_id} was rendered by an older matiere and has no night")
        media_type = ARTIFACT_MEDIA_TYPES["night"][0]
        place = self._data.artifacts.path
        files = [
            Artifact("night", b.digest, b.size, str(place(b.digest)), media_type) for b in blobs
        ]
        head = {"name": sweep.label, "sweep_id": sweep.id, "created": sweep.created,
                "cells": sweep.cells}  # fmt: skip
        return head, files

    def compare_sweeps(
        self, a: str, b: str, options: Mapping[str, Any] | Options | None = None
    ) -> JsonDict:
        """Compare the night of sweep `b` with that of the earlier sweep `a`, in the utility child.

        The report is that of `compare_nights.compare_nights`. Raises `JobNotFound`, `NotReadyYet`,
        `Busy` (one comparison at a time) and MatiereError for options out of range.
        """
        chosen = options if isinstance(options, Options) else Options(**(options or {}))
        request: JsonDict = {"options": asdict(chosen)}
        for name, sweep_id in (("a", a), ("b", b)):
            head, files = self.night(sweep_id)
            request[name] = {"head": head, "pages": [file.digest for file in files]}
        answer = self._scheduler.compare_nights(request)
        if answer["faults"]:
            self.night(a), self.night(b)  # raises if one was deleted meanwhile
            first = answer["faults"][0]
            raise JobsError(first["message"], code=first["code"])
        report: JsonDict = answer["report"]
        return report
