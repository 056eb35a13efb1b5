"""A small number of runs of the state machine; `./dev prove faults` makes 2,000."""

from __future__ import annotations

from hypothesis import HealthCheck, settings
from queue_machine import QueueMachine

TestQueue = QueueMachine.TestCase
TestQueue.settings = settings(
    max_examples=25,
    stateful_step_count=30,
    deadline=None,
    derandomize=True,
    database=None,
    suppress_health_check=list(HealthCheck),
)
