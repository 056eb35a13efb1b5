"""What the scheduler keeps in memory: places of children, their claims, options, health."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from matiere.jobs.children import Child
from matiere.jobs.cluster.member import Cluster
from matiere.jobs.rules import Rules


@dataclass
class Held:
    """A claim in a child's hands."""

    token: int
    film_id: int
    chunks: list[int]
    samples: int
    sent: float
    cancelled: float | None = None
    phase: str = "given"  # then "reading" its files, then "working": building, rendering
    kind: str = "chunks"  # of one film; or of `Batching`: "batch", "expand"
    detail: Any = None  # of `Batching`
    begun: int | None = None  # the film of a batch that the child is at


@dataclass(frozen=True)
class Options:
    """How the engine runs its children."""

    children: int
    threads: int
    work: str
    min_free_bytes: int
    rules: Rules = field(default_factory=Rules)
    child_memory_bytes: int = 0  # of one child; 0: only all together have a limit
    claim_limit_s: float = 3600.0  # a child that works on one claim for longer is killed
    cluster: Cluster | None = None  # render there; none: in children of this machine


@dataclass
class Slot:
    """The place of one render child, refilled when the child dies."""

    name: str
    child: Child | None = None
    failures: int = 0  # deaths since its last good report
    not_before: float = 0.0


@dataclass
class Health:
    """What readiness reports, replaced as a whole for other threads to read."""

    disk_full_until: float = 0.0
    disk_low: bool = False
    draining: bool = False
    stuck: str = ""  # a child that does not start
    fault: str = ""  # the last round of the scheduler failed
    counters: Counter[str] = field(default_factory=Counter)
