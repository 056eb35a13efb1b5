"""The JSON that goes over the wire, besides scenes: submissions and views of jobs and sweeps.

A scene is passed on as it came (`dict`): `matiere.jobs` validates it once, against the models of
`matiere.scene`, and its errors come back with pointers into the submission.
"""

from __future__ import annotations

import posixpath
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    JsonValue,
    StringConstraints,
    field_validator,
    model_validator,
)

from matiere.jobs.job import (
    DEFAULT_PRIORITY,
    MAX_PRIORITY,
    MIN_PRIORITY,
    RENDERED_STATES,
    Event,
    Job,
    JobState,
    Sweep,
)

Digest = Annotated[str, StringConstraints(pattern=r"^(sha256:)?[0-9a-f]{64}$")]
MAX_NAME_PART = 255  # bytes; what file systems hold
Label = Annotated[str, StringConstraints(max_length=200)]
Scene = Annotated[
    dict[str, Any],
    Field(description="A scene, version 1; GET /v1/schema is its JSON Schema."),
]
SOURCES = ("values", "linspace", "logspace", "set", "uniform", "loguniform")  # of an axis
Number = int | float  # a whole number stays one: seeds and sample counts are no floats


class _Request(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


# As in matiere.scene.model, which brings NumPy into the process (a test holds the two together).
class DisplayTarget(_Request):
    """How far the delivered 8-bit image may be off, through the view of its output."""

    code_values: int = Field(1, ge=1, le=254, description="8-bit steps that a pixel may be off")
    pixels_percent: float = Field(
        95.0, gt=0, lt=100, description="share of the pixels that keep to it, percent"
    )


class Target(_Request):
    """The error to reach: one of the three."""

    relmse: float | None = Field(
        None, gt=0, description="estimated relative mean squared error of the image"
    )
    rmse_percent: float | None = Field(
        None, gt=0, description="estimated root of the mean squared error, percent of the mean"
    )
    display: DisplayTarget | None = Field(
        None, description="code values of the delivered image, through its view"
    )

    @model_validator(mode="after")
    def _one(self) -> Self:
        kinds = (self.relmse, self.rmse_percent, self.display)
        if sum(kind is not None for kind in kinds) != 1:
            raise ValueError("give one of relmse, rmse_percent, display")
        return self


class Stop(_Request):
    """When to stop rendering: whichever of these comes first."""

    spp: int | None = Field(None, ge=1, description="samples per pixel")
    seconds: float | None = Field(None, gt=0, description="render seconds")
    target_error: Target | None = None

    def given(self) -> dict[str, Any] | None:
        """Return only what was set, or None."""
        return self.model_dump(exclude_none=True) or None


def _asset_name(name: str) -> str:
    """Refuse what no file can be called, before it comes near a file system."""
    parts = name.split("/")
    if not name or any(ord(character) < 32 for character in name):
        raise ValueError("a file name has at least one character, and no control characters")
    if len(name) > 1024 or any(len(part.encode()) > MAX_NAME_PART for part in parts):
        raise ValueError("a file name is too long")
    return name


AssetName = Annotated[str, AfterValidator(_asset_name)]


class _WithAssets(_Request):
    assets: dict[AssetName, Digest] = Field(
        default_factory=dict,
        description="file name in the scene -> SHA-256 of its bytes, as uploaded with"
        " PUT /v1/assets/{sha256}; other names are looked up below the server's asset folder",
    )

    @field_validator("assets")
    @classmethod
    def _one_place_each(cls, assets: dict[str, str]) -> dict[str, str]:
        """Refuse two names of one place, and a file where another name needs a folder."""
        places = {posixpath.normpath(name): name for name in assets}
        if len(places) < len(assets):
            raise ValueError("two of these names mean the same file")
        for place, name in places.items():
            above = posixpath.dirname(place)
            while above not in ("", "/"):
                if above in places:
                    raise ValueError(f"{name!r} lies below {places[above]!r}, which is a file")
                above = posixpath.dirname(above)
        return assets

    def pins(self) -> dict[str, str]:
        """Return file name -> bare lower-case hex digest."""
        return {name: value.removeprefix("sha256:") for name, value in self.assets.items()}


class _Submission(_WithAssets):
    stop: Stop | None = Field(None, description="overrides the scene's `render` section")
    priority: int = Field(
        DEFAULT_PRIORITY, ge=MIN_PRIORITY, le=MAX_PRIORITY, description="higher runs first"
    )
    label: Label = ""
    cache: Literal["use"] = Field(
        "use", description="an equal film rendered before is continued, never rendered again"
    )
    deadline: Number | str | None = Field(
        None,
        description="seconds from now, or a moment (RFC 3339): what is not complete then ends as"
        " `expired`, with the samples it has",
    )
    after: list[Annotated[str, StringConstraints(max_length=36)]] = Field(
        default_factory=list,
        max_length=1000,
        description="ids of jobs and sweeps that must succeed before this begins",
    )

    def stop_rule(self) -> dict[str, Any] | None:
        """Return the stop rule as the queue takes it."""
        return self.stop.given() if self.stop else None


class Change(_Request):
    """What can be changed of a job or sweep that has not ended."""

    priority: int = Field(ge=MIN_PRIORITY, le=MAX_PRIORITY, description="higher runs first")


class JobSubmission(_Submission):
    """One image to render."""

    scene: Scene


class Axis(_Request):
    """One thing that varies, and the values it takes or the range it takes them from."""

    pointer: str | list[str] = Field(description="JSON pointer(s) into the base scene")
    values: list[JsonValue] | None = Field(None, min_length=1)
    linspace: tuple[Number, Number, int] | None = Field(
        None, description="first, last, count", strict=False
    )
    logspace: tuple[Number, Number, int] | None = Field(
        None,
        description="first, last, count; first and last are values, not exponents",
        strict=False,
    )
    set: str | None = Field(None, description="name of a set of values: metals, or one of `sets`")
    uniform: tuple[Number, Number] | None = Field(
        None, description="low, high; for mode sobol", strict=False
    )
    loguniform: tuple[Number, Number] | None = Field(
        None, description="low, high, evenly spread logarithms; for mode sobol", strict=False
    )
    label: Label | None = None
    labels: list[Label] | None = Field(None, description="one text per value")

    @model_validator(mode="after")
    def _one_kind(self) -> Axis:
        given = [key for key in SOURCES if getattr(self, key) is not None]
        if len(given) > 1:
            raise ValueError(f"give exactly one of {', '.join(SOURCES)}, not {' and '.join(given)}")
        return self


class SobolPoints(_Request):
    """How many points of the sequence, and which sequence."""

    count: int = Field(ge=1, description="cells, before `where` leaves some out")
    seed: int = Field(1, ge=0, lt=2**32, description="another seed gives other points")


class Override(_Request):
    """Further settings of the cells for which a condition holds."""

    when: str = Field(description="condition over axis labels, as in `where`")
    set: dict[str, JsonValue] = Field(min_length=1, description="JSON pointer -> value")
    label: Label = Field("", description="added to the cells' labels")


class Budget(_Request):
    """Render seconds that all cells share, and the error that each is to reach."""

    seconds: float = Field(gt=0, description="render seconds of all cells together")
    target_error: Target


# A field called `list` would hide the type from the annotations of its class.
Axes = list[Axis]
Conditions = list[str]
Overrides = list[Override]
Cells = list[dict[str, JsonValue]]
NamedSets = dict[str, list[JsonValue] | dict[str, JsonValue]]


class SweepLanguage(BaseModel):
    """The cells of a sweep; docs/sweep.md explains the words."""

    axes: Axes | None = Field(
        None, max_length=16, description="what varies; in mode list only names for pointers"
    )
    mode: Literal["grid", "zip", "sobol", "list"] = Field(
        "grid",
        description="all combinations, in step, points that fill a box evenly, or cell by cell",
    )
    sobol: SobolPoints | None = Field(None, description="for mode sobol")
    sets: NamedSets | None = Field(
        None, description="name -> values, or label -> value, for axes with `set`"
    )
    where: Conditions | None = Field(
        None, max_length=32, description="conditions that every cell satisfies"
    )
    overrides: Overrides | None = Field(None, max_length=100)
    baseline: int | dict[str, JsonValue] | None = Field(
        None, description="the cell to compare with: its number, or axis label -> value"
    )
    budget: Budget | None = Field(
        None, description="instead of a stop rule: seconds for all cells, one error for each"
    )
    list: Cells | None = Field(
        None, min_length=1, description="for mode list: axis label or JSON pointer -> value"
    )

    def language(self) -> dict[str, Any]:
        """Return what was given, beside the mode, as the queue takes it."""
        names = set(SweepLanguage.model_fields) - {"mode"}
        given = self.model_dump(mode="json", include=names, exclude_unset=True)
        return {name: value for name, value in given.items() if value is not None}


class SweepSubmission(_Submission, SweepLanguage):
    """A base scene and what varies in it: one job per cell."""

    base: Scene
    columns: int | None = Field(None, ge=1, le=1000, description="columns of the contact sheet")


class ErrorView(BaseModel):
    """Why a job failed."""

    code: str
    message: str
    pointer: str
    log_tail: str


class PastAttempt(BaseModel):
    """How an earlier attempt of a requeued job ended."""

    attempt: int
    state: JobState
    queued: datetime
    started: datetime | None
    finished: datetime | None
    error: ErrorView | None

    @classmethod
    def of(cls, line: Mapping[str, Any]) -> PastAttempt:
        """Show a line of `Job.history`."""
        error = None
        if line["error_code"] is not None:
            keys = ("code", "message", "pointer")
            texts = {key: line[f"error_{key}"] or "" for key in keys}
            error = ErrorView(**texts, log_tail=line["error_log"] or "")
        return cls(
            attempt=line["attempt"],
            state=line["state"],
            queued=time_of(line["queued"]),
            started=time_or_none(line["started"]),
            finished=time_or_none(line["finished"]),
            error=error,
        )


class JobView(BaseModel):
    """A job as it stands."""

    id: str
    state: JobState
    label: str
    priority: int
    stop: dict[str, Any]
    width: int
    height: int
    film_key: str
    cached: bool = Field(description="an older film already met the stop rule")
    created: datetime
    started: datetime | None
    finished: datetime | None
    spp: int = Field(description="samples per pixel so far")
    progress: float = Field(description="0 to 1; 1 only when ended")
    seconds: float = Field(description="render seconds of the film so far")
    relmse: float | None = Field(description="newest error estimate; null while unknown")
    relmse_interval: tuple[float, float] | None = Field(description="its 95 % interval")
    stop_reason: str | None
    error: ErrorView | None
    target_seconds: float | None = Field(
        description="render seconds in all at which the target error is expected; null if unknown"
    )
    sweep_id: str | None
    cell: int | None
    parameters: dict[str, Any]
    effective_priority: float = Field(description="priority, and a point a minute of waiting")
    deadline: datetime | None
    after: list[str] = Field(description="jobs and sweeps that must succeed first")
    waiting_for: int = Field(description="how many of `after` have not succeeded yet")
    attempt: int = Field(description="1, and one more with every requeue")
    history: list[PastAttempt] = Field(description="how the attempts before this one ended")
    pinned: bool = Field(description="kept whatever its age")
    links: dict[str, str]

    @classmethod
    def of(cls, job: Job) -> JobView:
        """Show `job`."""
        self_link = f"/v1/jobs/{job.id}"
        links = {"self": self_link}
        links |= {name: f"{self_link}/{name}" for name in ("events", "log", "attempts")}
        for action in steps(job.state):
            links[action] = f"{self_link}:{action}"
        for kind in job.artifacts:
            if kind in JOB_FILES:
                links[JOB_FILES[kind][0]] = f"{self_link}/{JOB_FILES[kind][1]}"
        if job.spp:
            links["preview"] = f"{self_link}/preview"
        if job.sweep_id:
            links["sweep"] = f"/v1/sweeps/{job.sweep_id}"
        error = job.error
        return cls(
            id=job.id,
            state=job.state,
            label=job.label,
            priority=job.priority,
            stop=job.stop,
            width=job.width,
            height=job.height,
            film_key=job.film_key,
            cached=job.cached,
            created=time_of(job.created),
            started=time_or_none(job.started),
            finished=time_or_none(job.finished),
            spp=job.spp,
            progress=job.progress,
            seconds=job.seconds,
            relmse=job.relmse,
            relmse_interval=job.relmse_interval,
            stop_reason=job.stop_reason,
            target_seconds=job.target_seconds,
            error=ErrorView(**vars(error)) if error else None,
            sweep_id=job.sweep_id,
            cell=job.cell,
            parameters=job.parameters,
            effective_priority=job.effective_priority,
            deadline=time_or_none(job.deadline),
            after=list(job.after),
            waiting_for=job.waiting_for,
            attempt=job.attempt,
            history=[PastAttempt.of(line) for line in job.history],
            pinned=job.pinned,
            links=links,
        )


# artifact kind -> (name of its link, last part of its URL)
JOB_FILES = {
    "thumbnail.jpg": ("thumbnail", "thumbnail.jpg"),
    "image.png": ("image_png", "image.png"),
    "image.exr": ("image_exr", "image.exr"),
    "report.json": ("report", "report"),
    "error.svg": ("error_plot", "error-plot.svg"),
}


class JobPage(BaseModel):
    """One page of jobs."""

    jobs: list[JobView]
    next_cursor: str | None = Field(description="null on the last page")


class BudgetView(BaseModel):
    """What the cells of a sweep share, and how far they are."""

    seconds: float = Field(description="render seconds of all cells together")
    target_error: dict[str, Any]
    spent_s: float = Field(description="by all cells so far")
    needed_s: float | None = Field(
        description="by the cells that have not ended, as their errors look now; null while a cell"
        " has not been looked at"
    )
    closed: bool = Field(description="no cell gets more; those not at the target are `unfinished`")


class SweepView(BaseModel):
    """A sweep as it stands."""

    id: str
    state: JobState = Field(description="of the sweep as a whole")
    label: str
    mode: str
    axes: list[dict[str, Any]]
    cells: int
    counts: dict[str, int] = Field(description="cells by state")
    columns: int
    baseline: int | None = Field(description="number of the cell that others are compared with")
    budget: BudgetView | None = Field(description="of a sweep whose cells share render seconds")
    pinned: bool = Field(description="kept whatever its age")
    created: datetime
    finished: datetime | None
    after: list[str] = Field(description="jobs and sweeps that must succeed first")
    waiting_for: int = Field(description="how many of `after` have not succeeded yet")
    links: dict[str, str]

    @classmethod
    def of(cls, sweep: Sweep) -> SweepView:
        """Show `sweep`."""
        self_link = f"/v1/sweeps/{sweep.id}"
        links = {"self": self_link, "jobs": f"/v1/jobs?sweep={sweep.id}"}
        links["events"] = f"{self_link}/events"
        states = (JobState(state) for state, n in sweep.counts.items() if n)
        for action in dict.fromkeys(step for state in states for step in steps(state)):
            links[action] = f"{self_link}:{action}"
        if "contact-sheet.png" in sweep.artifacts:
            links["contact_sheet"] = f"{self_link}/contact-sheet.png"
        if sweep.finished is not None:
            links["night"] = f"{self_link}/night"
        return cls(
            id=sweep.id,
            state=sweep_state(sweep),
            label=sweep.label,
            mode=sweep.mode,
            axes=sweep.axes,
            cells=sweep.cells,
            counts=sweep.counts,
            columns=sweep.columns,
            baseline=sweep.baseline,
            budget=BudgetView(**vars(sweep.budget)) if sweep.budget else None,
            pinned=sweep.pinned,
            created=time_of(sweep.created),
            finished=time_or_none(sweep.finished),
            after=list(sweep.after),
            waiting_for=sweep.waiting_for,
            links=links,
        )


class SweepPage(BaseModel):
    """One page of sweeps."""

    sweeps: list[SweepView]
    next_cursor: str | None


class EventView(BaseModel):
    """Something that happened to a job or a sweep."""

    seq: int = Field(description="number: rises with every event, never used twice")
    time: datetime
    kind: str = Field(description="what happened: queued, running, progress, look, succeeded, ...")
    job_id: str | None
    sweep_id: str | None
    data: dict[str, Any]

    @classmethod
    def of(cls, event: Event) -> EventView:
        """Show `event`."""
        return cls(**{**vars(event), "time": time_of(event.time)})


class EventPage(BaseModel):
    """Events in order, for those who poll."""

    events: list[EventView]
    last: int = Field(description="pass it as `after` to read on")
    reset: bool = Field(description="what was asked for is not kept any more: read the job again")


class CheckSubmission(_WithAssets):
    """A material to test, given as in a scene, without textures."""

    material: dict[str, Any] = Field(description="type and parameters, as in a scene's `materials`")
    seed: int = Field(1, ge=0, lt=2**32, description="of the random numbers")
    plots: bool = Field(False, description="add `plots`: albedo and polar, as SVG")


class CheckReport(BaseModel):
    """A stability report; docs/check.md explains every key."""

    version: int = Field(description="of this format")
    material: dict[str, Any]
    verdict: Literal["pass", "warn", "fail"]
    reason: str
    findings: list[dict[str, Any]]
    limits: list[dict[str, Any]] = Field(description="parameters treated as limits")
    views: list[dict[str, Any]]
    furnace: list[dict[str, Any]] = Field(description="albedo by angle, side and channel")
    seconds: float
    plots: dict[str, str] = Field(default_factory=dict, description="name -> SVG, if asked for")


class AssetView(BaseModel):
    """An asset that the server holds."""

    sha256: str
    created: bool = Field(description="false when the server held it already")


class CheckView(BaseModel):
    """One line of a readiness answer."""

    ok: bool
    detail: str


class CollectedView(BaseModel):
    """What a collection removed, or would remove."""

    dry_run: bool
    jobs: int
    sweeps: int
    films: int
    film_bytes: int
    files: int = Field(description="that nobody names")
    file_bytes: int


class ReadyView(BaseModel):
    """The answer of a ready service."""

    ready: bool
    checks: dict[str, CheckView]


def steps(state: JobState) -> tuple[str, ...]:
    """Return what can be asked of a job in this state."""
    if state in RENDERED_STATES:
        return ()
    if state.final:
        return ("requeue",)
    return ("cancel", "resume" if state is JobState.PAUSED else "pause")


def sweep_state(sweep: Sweep) -> JobState:
    """Return one state for the whole: the worst end once every cell has ended."""
    count = {JobState(state): n for state, n in sweep.counts.items() if n}
    if not sweep.done:
        waiting = {state for state in count if not state.final}
        if waiting == {JobState.PAUSED}:
            return JobState.PAUSED
        return JobState.QUEUED if set(count) <= {JobState.QUEUED} else JobState.RUNNING
    for state in (JobState.FAILED, JobState.CANCELLED, JobState.EXPIRED, JobState.UNFINISHED):
        if state in count:
            return state
    return JobState.SUCCEEDED


def time_of(seconds: float) -> datetime:
    """Return Unix seconds as a moment in UTC."""
    return datetime.fromtimestamp(seconds, UTC)


def time_or_none(seconds: float | None) -> datetime | None:
    """Return Unix seconds as a moment in UTC, None as None."""
    return None if seconds is None else time_of(seconds)
