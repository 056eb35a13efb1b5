"""The values of the queue: job, sweep, artifact, event, and the legal state changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from matiere.jobs.errors import IllegalTransition

JsonDict = dict[str, Any]

MIN_PRIORITY, DEFAULT_PRIORITY, MAX_PRIORITY = 0, 50, 100


class JobState(StrEnum):
    """Where a job stands. `succeeded`, `unfinished`, `failed`, `cancelled` and `expired` end it."""

    QUEUED = "queued"
    RUNNING = "running"
    PAUSED = "paused"
    SUCCEEDED = "succeeded"
    UNFINISHED = "unfinished"  # the budget of its sweep ended before its error target was met
    FAILED = "failed"
    CANCELLED = "cancelled"
    EXPIRED = "expired"

    @property
    def final(self) -> bool:
        """Tell whether it has ended: only a requeue brings it back, and never a success."""
        return self in FINAL_STATES


FINAL_STATES = frozenset(
    {
        JobState.SUCCEEDED,
        JobState.UNFINISHED,
        JobState.FAILED,
        JobState.CANCELLED,
        JobState.EXPIRED,
    }
)
# Ended as was asked: with an image that has its error bar.
RENDERED_STATES = (JobState.SUCCEEDED, JobState.UNFINISHED)
RENDERED = tuple(state.value for state in RENDERED_STATES)

TRANSITIONS: Mapping[JobState, frozenset[JobState]] = {
    # a cache hit needs no rendering: straight to succeeded
    JobState.QUEUED: FINAL_STATES | {JobState.RUNNING, JobState.PAUSED},
    JobState.RUNNING: FINAL_STATES | {JobState.PAUSED},
    JobState.PAUSED: frozenset({JobState.QUEUED, JobState.CANCELLED, JobState.EXPIRED}),
    JobState.SUCCEEDED: frozenset(),
    JobState.UNFINISHED: frozenset(),  # submit again with a larger budget
    JobState.FAILED: frozenset({JobState.QUEUED}),  # requeued, as all below
    JobState.CANCELLED: frozenset({JobState.QUEUED}),
    JobState.EXPIRED: frozenset({JobState.QUEUED}),
}

ACTIVE_STATES = (JobState.QUEUED, JobState.RUNNING)
LIVE_STATES = tuple(s for s in JobState if s not in FINAL_STATES)

# Waiting for so long weighs as much as one point of priority.
AGEING_S = 60.0


def queue_rank(priority: int, queued: float) -> float:
    """Return the place in the queue, highest first: `priority` plus the time waited.

    All that waits ages alike, so the order of two jobs never changes while they wait; a job is
    overtaken only by those that are queued within `AGEING_S` seconds a point of the difference.
    """
    return priority * AGEING_S - queued


def check_transition(old: JobState, new: JobState) -> None:
    """Raise IllegalTransition unless `old -> new` is in the table."""
    if new not in TRANSITIONS[old]:
        raise IllegalTransition(f"a {old.value} job cannot become {new.value}")


@dataclass(frozen=True)
class JobError:
    """Why a job failed: class (`kind`), message, JSON pointer and the tail of the child's log."""

    code: str
    message: str
    pointer: str = ""
    log_tail: str = ""


@dataclass(frozen=True)
class Job:
    """One requested image and how far it is."""

    id: str
    state: JobState
    label: str
    priority: int
    stop: JsonDict  # {"spp": int|None, "seconds": float|None, "target_error": {kind: x}|None}
    width: int
    height: int
    film_key: str
    cached: bool  # the stored film already met the stop rule: nothing was rendered for this job
    created: float  # Unix seconds
    started: float | None
    finished: float | None
    spp: int  # merged samples per pixel; final once the job has ended
    progress: float  # 0..1, 1 only when ended
    seconds: float  # render seconds of the film so far (children's wall time)
    relmse: float | None  # newest estimate; None while unknown
    relmse_interval: tuple[float, float] | None  # its 95 % interval
    stop_reason: str | None  # "spp", "seconds", "target_error", "budget", once ended
    error: JobError | None
    sweep_id: str | None
    cell: int | None  # index within the sweep
    parameters: JsonDict  # axis label -> value, for a sweep cell
    artifacts: tuple[str, ...]  # kinds ready to fetch, see ARTIFACT_MEDIA_TYPES
    effective_priority: float = DEFAULT_PRIORITY  # with what waiting has added
    deadline: float | None = None  # Unix seconds
    after: tuple[str, ...] = ()  # jobs and sweeps that must succeed first
    waiting_for: int = 0  # how many of them have not yet
    attempt: int = 1  # rises with every requeue
    history: tuple[JsonDict, ...] = ()  # how the attempts before this one ended
    pinned: bool = False  # kept whatever its age
    target_seconds: float | None = None  # render seconds in all at which target_error is expected


@dataclass(frozen=True)
class Budget:
    """Render seconds that the cells of a sweep share, and the error that each is to reach."""

    seconds: float
    target_error: JsonDict
    spent_s: float  # by all cells so far
    needed_s: float | None  # by all that have not ended, as it looks now; None: not looked at yet
    closed: bool  # no cell gets more


@dataclass(frozen=True)
class Sweep:
    """A base scene, its axes, and the counts of its cells by state."""

    id: str
    label: str
    mode: str  # "grid" | "zip" | "sobol" | "list"
    axes: list[JsonDict]
    cells: int
    counts: dict[str, int]  # every JobState value -> number of cells
    created: float
    finished: float | None
    columns: int  # of the contact sheet
    artifacts: tuple[str, ...]
    after: tuple[str, ...] = ()  # jobs and sweeps that must succeed first
    waiting_for: int = 0  # how many of them have not yet
    baseline: int | None = None  # cell that others are compared with
    pinned: bool = False  # kept whatever its age
    budget: Budget | None = None  # of a sweep that shares its time out

    @property
    def done(self) -> bool:
        """Tell whether every cell has ended."""
        return sum(n for s, n in self.counts.items() if JobState(s).final) == self.cells


ARTIFACT_MEDIA_TYPES: Mapping[str, tuple[str, str]] = {
    # kind -> (media type, file name ending)
    "image.png": ("image/png", ".png"),
    "image.exr": ("image/x-exr", ".exr"),
    "thumbnail.jpg": ("image/jpeg", ".jpg"),
    "report.json": ("application/json", ".json"),
    "error.svg": ("image/svg+xml", ".svg"),
    "contact-sheet.png": ("image/png", ".png"),
    "signature": ("application/octet-stream", ".signature"),
    "night": ("application/octet-stream", ".night"),
    "film": ("application/octet-stream", ".film"),
}

# what a film is developed to
IMAGES = ("error.svg", "image.exr", "image.png", "report.json", "thumbnail.jpg")


@dataclass(frozen=True)
class Artifact:
    """An immutable content-addressed file."""

    kind: str
    digest: str  # SHA-256 of the bytes, lower-case hex
    size: int  # bytes
    path: str  # "" in an object store
    media_type: str


@dataclass(frozen=True)
class Event:
    """One line of history; `seq` rises strictly, with no repeats."""

    seq: int
    time: float
    kind: str  # "queued", "running", "progress", "look", "succeeded", "failed", "cancelled", ...
    job_id: str | None
    sweep_id: str | None
    data: JsonDict = field(default_factory=dict)


@dataclass(frozen=True)
class Check:
    """One line of a readiness answer."""

    ok: bool
    detail: str


@dataclass(frozen=True)
class Readiness:
    """Whether the engine takes and does work, and what each check says."""

    ready: bool
    checks: dict[str, Check]
