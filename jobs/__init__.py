"""Job queue of matiere: durable jobs and sweeps over render child processes."""

from matiere.jobs.engine import Engine, open_engine
from matiere.jobs.job import Artifact, Event, Job, JobState, Readiness, Sweep

__all__ = ["Artifact", "Engine", "Event", "Job", "JobState", "Readiness", "Sweep", "open_engine"]
