"""What people do to jobs and sweeps that are queued: the part of `Engine` that steers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable
from typing import Any

from matiere.errors import Fault, SceneValidationError
from matiere.jobs.job import MAX_PRIORITY, MIN_PRIORITY, Job, Sweep
from matiere.jobs.scheduler import Scheduler
from matiere.jobs.store import control, jobs, removal
from matiere.jobs.store.database import Database


class Controls(ABC):
    """Cancel, pause, resume, requeue, priority: of a job, or of all cells of a sweep.

    Each is short, durable when it returns, and harmless when it is sent twice.
    """

    _db: Database
    _scheduler: Scheduler

    @abstractmethod
    def get_job(self, job_id: str) -> Job:
        """Return a job."""

    @abstractmethod
    def get_sweep(self, sweep_id: str) -> Sweep:
        """Return a sweep."""

    # -- jobs ---------------------------------------------------------------------------------
    def cancel_job(self, job_id: str) -> Job:
        """Cancel a live job; a film that another job wants goes on. An ended job is unchanged."""
        return self._steer(job_id, "jobs_cancelled", jobs.cancel_job)

    def pause_job(self, job_id: str) -> Job:
        """Hold a job back: what is being rendered (a second or two) ends, all samples are kept.

        Raises `IllegalTransition` for one that has ended.
        """
        return self._steer(job_id, "jobs_paused", control.pause_job)

    def resume_job(self, job_id: str) -> Job:
        """Let a paused job go on, in its old place. Raises `IllegalTransition` if it has ended."""
        return self._steer(job_id, "jobs_resumed", control.resume_job)

    def requeue_job(self, job_id: str) -> Job:
        """Start the next attempt of a failed, cancelled or expired job, under the same id.

        How the last one ended stays in `history`; samples of the film are kept. What was cancelled
        because this job had failed comes back too. Raises `IllegalTransition` for a succeeded job
        and while a job it waits for has failed.
        """
        return self._steer(job_id, "jobs_requeued", control.requeue_job)

    def set_priority(self, job_id: str, priority: int) -> Job:
        """Change the priority of a live job (0..100); the time it has waited still counts."""
        check_priority(priority)
        change = lambda c, i: control.set_priority(c, i, priority)  # noqa: E731
        return self._steer(job_id, "priorities_changed", change)

    # -- sweeps -------------------------------------------------------------------------------
    def cancel_sweep(self, sweep_id: str) -> Sweep:
        """Cancel every live cell."""
        return self._steer_cells(sweep_id, "jobs_cancelled", jobs.cancel_sweep)

    def pause_sweep(self, sweep_id: str) -> Sweep:
        """Pause every cell that waits or renders."""
        return self._steer_cells(sweep_id, "jobs_paused", control.pause_sweep)

    def resume_sweep(self, sweep_id: str) -> Sweep:
        """Let every paused cell go on."""
        return self._steer_cells(sweep_id, "jobs_resumed", control.resume_sweep)

    def requeue_sweep(self, sweep_id: str) -> Sweep:
        """Start the next attempt of every cell that failed, expired or was cancelled."""
        return self._steer_cells(sweep_id, "jobs_requeued", control.requeue_sweep)

    def set_sweep_priority(self, sweep_id: str, priority: int) -> Sweep:
        """Change the priority of every live cell (0..100)."""
        check_priority(priority)
        change = lambda c, i: control.set_sweep_priority(c, i, priority)  # noqa: E731
        return self._steer_cells(sweep_id, "priorities_changed", change)

    # -- removal ------------------------------------------------------------------------------
    def delete_job(self, job_id: str) -> None:
        """Remove a job with its results, ended or not; its film too, unless another job has it.

        Harmless when it is sent twice. Raises `JobNotFound`, and `DeletionRefused` for a cell of a
        sweep, a pinned job, and one that another waits for.
        """
        self._count("jobs_deleted", self._db.write(removal.delete_job, job_id))

    def delete_sweep(self, sweep_id: str) -> None:
        """Remove a sweep with its cells, results and night; otherwise as `delete_job`."""
        self._count("sweeps_deleted", self._db.write(removal.delete_sweep, sweep_id))

    # -- inside -------------------------------------------------------------------------------
    def _steer(self, job_id: str, counter: str, action: Callable[[Any, str], Any]) -> Job:
        self._count(counter, self._db.write(lambda c: action(c, job_id)))
        return self.get_job(job_id)

    def _steer_cells(self, sweep_id: str, counter: str, action: Callable[[Any, str], Any]) -> Sweep:
        self.get_sweep(sweep_id)
        self._count(counter, self._db.write(lambda c: action(c, sweep_id)))
        return self.get_sweep(sweep_id)

    def _count(self, counter: str, done: bool | int | list[str]) -> None:
        counters: Counter[str] = self._scheduler.health.counters
        counters[counter] += len(done) if isinstance(done, list) else int(done)
        self._scheduler.garbage()
        self._scheduler.wake()


def check_priority(priority: int) -> None:
    """Raise SceneValidationError unless `priority` is in its range."""
    if not MIN_PRIORITY <= priority <= MAX_PRIORITY:
        why = f"priority is {MIN_PRIORITY} to {MAX_PRIORITY}, not {priority}"
        raise SceneValidationError([Fault("/priority", "out_of_range", why)])
