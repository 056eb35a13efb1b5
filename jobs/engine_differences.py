"""Difference images of a sweep against its baseline cell: the part of `Engine` that makes them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from matiere.jobs.errors import JobNotFound, JobsError, NotReadyYet
from matiere.jobs.job import RENDERED_STATES, Artifact, Sweep
from matiere.jobs.store import files, views

if TYPE_CHECKING:
    from matiere.jobs.scheduler import Scheduler
    from matiere.jobs.store.database import Database

KIND = "difference.png"


class EngineDifferences:
    """Paired differences of cells and the baseline of their sweep, made when first asked for."""

    _db: Database
    _scheduler: Scheduler

    if TYPE_CHECKING:

        def get_sweep(self, sweep_id: str) -> Sweep: ...

        def _artifact(self, blob: files.Blob | None, kind: str, why_not: str) -> Artifact: ...

    def difference(self, sweep_id: str, cell: int) -> Artifact:
        """Return the image of how a cell differs from the sweep's baseline, as `mt.compare` has it.

        It is made of stored films, replicate by replicate, so noise that both share cancels.
        Raises `JobNotFound` (no such sweep or cell, no baseline, a film that is no longer stored),
        `NotReadyYet`, or `Busy` when the child that makes images has no time for it.
        """
        sweep = self.get_sweep(sweep_id)
        if sweep.baseline is None:
            raise JobNotFound(f"sweep {sweep_id} has no baseline to compare with")
        if not 0 <= cell < sweep.cells or cell == sweep.baseline:
            why = "is the baseline" if cell == sweep.baseline else f"is none of {sweep.cells}"
            raise JobNotFound(f"cell {cell} {why}: it has no difference image")
        owner, kind = ("sweep", sweep_id), f"difference-{cell:06}"
        blob = self._db.read(lambda c: files.find_reference(c, owner, kind))
        if blob is None:
            cells = (sweep.baseline, cell)
            a, b = (self._film_of_cell(sweep_id, number) for number in cells)
            answer = self._scheduler.difference({"a": a, "b": b})
            if answer["faults"]:
                fault = answer["faults"][0]
                raise JobsError(fault["message"], code=fault["code"])
            blob = files.Blob(answer["digest"], answer["size"])
            made = {kind: blob}
            self._db.write(lambda c: files.add_references(c, owner, made))
        return self._artifact(blob, KIND, f"sweep {sweep_id} has no difference of cell {cell}")

    def _film_of_cell(self, sweep_id: str, cell: int) -> dict[str, Any]:
        job = self._db.read(lambda c: views.cell_of(c, sweep_id, cell))
        if job is None or not job.state.final:
            raise NotReadyYet(f"cell {cell} of sweep {sweep_id} has not ended")
        if job.state not in RENDERED_STATES:
            raise JobNotFound(f"cell {cell} ended as {job.state.value}, without an image")
        found = self._scheduler.utility.film_request(job)
        if found is None:
            why = f"the film of cell {cell} is no longer stored; submit the sweep again"
            raise JobNotFound(why)
        return found
