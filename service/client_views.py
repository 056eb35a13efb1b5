"""What the client answers with: jobs, sweeps, events, and its two errors."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict, Field
from typing_extensions import TypedDict

from matiere.errors import MatiereError
from matiere.service.budget_status import BudgetStatus

if TYPE_CHECKING:
    import httpx

ENDED = frozenset({"succeeded", "unfinished", "failed", "cancelled", "expired"})


class ServiceError(MatiereError):
    """The service refused a request; `errors` holds a pointer and a message for each bad value."""

    default_code = "service_error"

    def __init__(self, problem: Mapping[str, Any], status: int) -> None:
        """Keep the problem document `problem`."""
        errors = [dict(item) for item in problem.get("errors") or []]
        for item in errors:  # as seen from the scene file, not from the request around it
            at = str(item.get("pointer", ""))
            prefix = next((p for p in ("/scene", "/base") if at == p or at.startswith(p + "/")), "")
            item["pointer"] = at.removeprefix(prefix)
        lines = [f"{e['pointer']}: {e['message']}".removeprefix(": ") for e in errors]
        detail = str(problem.get("detail") or f"HTTP status {status}")
        message = "\n".join(lines) or f"{detail} {problem.get('remedy') or ''}".strip()
        super().__init__(message, code=str(problem.get("code") or self.default_code))
        self.status, self.errors, self.problem = status, errors, dict(problem)
        self.remedy = str(problem.get("remedy") or "")


class Unreachable(MatiereError):
    """No service answers at the URL."""

    default_code = "unreachable"


def refusal(answer: httpx.Response) -> ServiceError:
    """Return the error that an answer of status 400 or more stands for."""
    try:
        problem = answer.json()
    except ValueError:
        problem = {"detail": answer.text[:200]}
    return ServiceError(problem if isinstance(problem, dict) else {}, answer.status_code)


class Failure(TypedDict):
    """Why a job failed: class, message, JSON pointer into its scene, last lines of the log."""

    code: str
    message: str
    pointer: str
    log_tail: str


class PastAttempt(TypedDict):
    """How an attempt before the last requeue ended; times are RFC 3339."""

    attempt: int
    state: str
    queued: str
    started: str | None
    finished: str | None
    error: Failure | None


class _View(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")  # a newer service may say more


class JobStatus(_View):
    """A job as the service last described it.

    `spp` are samples per pixel so far, `seconds` render seconds so far (of all processes together),
    `progress` runs from 0 to 1. `relmse` is the estimated relative mean squared error and
    `relmse_interval` its 95 % interval; both are None while unknown. `target_seconds` are the
    render seconds in all after which the target error is expected.
    """

    id: str
    state: str
    label: str = ""
    width: int
    height: int
    cached: bool = False
    spp: int
    stop: dict[str, Any] = Field(default_factory=dict)
    progress: float
    seconds: float
    relmse: float | None = None
    relmse_interval: tuple[float, float] | None = None
    target_seconds: float | None = None
    stop_reason: str | None = None
    error: Failure | None = None
    cell: int | None = None
    parameters: dict[str, Any] = Field(default_factory=dict)
    priority: int = 50
    effective_priority: float = 50.0
    deadline: str | None = None
    after: list[str] = Field(default_factory=list)
    waiting_for: int = 0
    attempt: int = 1
    history: list[PastAttempt] = Field(default_factory=list)
    links: dict[str, str] = Field(default_factory=dict)

    @property
    def ended(self) -> bool:
        """Tell whether nothing more will happen."""
        return self.state in ENDED

    @property
    def rendered(self) -> bool:
        """Tell whether it ended with an image, at its target or where the budget ended."""
        return self.state == "succeeded" or (
            self.state == "unfinished" and "image_png" in self.links
        )


class SweepStatus(_View):
    """A sweep as the service last described it; `counts` are its cells by state."""

    id: str
    state: str
    label: str = ""
    mode: str = "grid"
    axes: list[dict[str, Any]]
    cells: int
    counts: dict[str, int]
    columns: int
    baseline: int | None = None
    budget: BudgetStatus | None = None
    links: dict[str, str] = Field(default_factory=dict)

    @property
    def ended_cells(self) -> int:
        """Return how many cells have ended."""
        return sum(n for state, n in self.counts.items() if state in ENDED)

    @property
    def ended(self) -> bool:
        """Tell whether every cell has ended."""
        return self.ended_cells == self.cells


class ServiceEvent(_View):
    """Something that happened to a job or a sweep, or how it stands.

    `kind` is one of docs/http.md (`queued`, `look`, `succeeded`, ...) with its `data`; `snapshot`
    and `reset` carry `status`, how the job or sweep stands after event number `seq`.
    """

    seq: int
    kind: str
    time: datetime | None = None
    job_id: str | None = None
    sweep_id: str | None = None
    data: dict[str, Any] = Field(default_factory=dict)
    status: JobStatus | SweepStatus | None = None
