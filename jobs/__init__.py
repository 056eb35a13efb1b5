"""Job queue of matiere: durable jobs and sweeps over render child processes.

Names are loaded when first used: a child process imports neither the engine nor the database.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matiere.jobs.engine import Engine, open_engine
    from matiere.jobs.job import Artifact, Event, Job, JobState, Readiness, Sweep

_HOMES = {"Engine": "engine", "open_engine": "engine"} | dict.fromkeys(
    ("Artifact", "Event", "Job", "JobState", "Readiness", "Sweep"), "job"
)

__all__ = ["Artifact", "Engine", "Event", "Job", "JobState", "Readiness", "Sweep", "open_engine"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
