"""Progress and results on the terminal, for `matiere submit` and `matiere sweep`.

On a terminal the bars are live; elsewhere (a log file, a pipe) one plain line is written now and
then, so that a nightly log stays readable.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from matiere.errors import MatiereError, SceneValidationError
from matiere.service.client import Client, JobStatus, ServiceError

PLAIN_PERIOD_S = 10.0
HOLDUP_PERIOD_S = 5.0


def console() -> Console:
    """Return the console progress is shown on: stderr, so that stdout stays for results."""
    return Console(stderr=True)


def format_error(job: JobStatus) -> str:
    """Return the error estimate with its interval, or `unknown`."""
    if job.relmse is None:
        return "error unknown"
    if job.relmse_interval is None:
        return f"relMSE {job.relmse:.2e}"
    low, high = job.relmse_interval
    return f"relMSE {job.relmse:.2e} (95 %: {low:.2e} to {high:.2e})"


def format_time(seconds: float | None) -> str:
    """Return seconds as h:mm:ss or m:ss; `--:--` when unknown."""
    if seconds is None:
        return "--:--"
    whole = round(seconds)
    hours, minutes, rest = whole // 3600, whole % 3600 // 60, whole % 60
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def describe(job: JobStatus) -> str:
    """Return one line on how a job ended."""
    if job.rendered:
        cached = ", from an earlier render" if job.cached else ""
        return (
            f"{job.label or job.id}: {job.spp} spp in {job.seconds:.1f} s, {format_error(job)}, "
            f"stopped by {job.stop_reason}{cached}"
        )
    why = f": {job.error['message']}" if job.error and job.error.get("message") else ""
    where = f" at {job.error['pointer']}" if job.error and job.error.get("pointer") else ""
    return f"{job.label or job.id}: {job.state}{why}{where}"


@contextlib.contextmanager
def worded(path: Path) -> Iterator[None]:
    """Print the errors of a scene or sweep as `file: /pointer: what to do` and end with code 2."""
    try:
        yield
    except (SceneValidationError, ServiceError) as error:
        if not error.errors:
            raise
        for item in error.errors:
            print(
                f"{path}: {item['pointer']}: {item['message']}".replace(": : ", ": "),
                file=sys.stderr,
            )
        raise typer.Exit(2) from None


def check_writable(path: Path) -> None:
    """Raise `MatiereError` unless a file can be made at `path`: before the render, not after."""
    folder = path.absolute().parent
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    if path.is_dir():
        raise MatiereError(f"{path} is a folder; name a file", code="cannot_write")
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        raise MatiereError(f"{path} cannot be written: check {folder}", code="cannot_write")


class Remaining:
    """Tells the time left from the progress made since the first look."""

    def __init__(self) -> None:
        self._begin: tuple[float, float] | None = None

    def seconds(self, progress: float) -> float | None:
        """Return seconds left at `progress` (0..1); None until some progress was seen."""
        now = time.monotonic()
        if self._begin is None:
            self._begin = (now, progress)
            return None
        begin, first = self._begin
        done = progress - first
        if done <= 0.0 or now - begin < 0.5:
            return None
        return (now - begin) * (1.0 - progress) / done


class Holdup:
    """Asks a service now and then why it begins no new work."""

    def __init__(self, client: Client) -> None:
        self._client, self._asked, self._found = client, -HOLDUP_PERIOD_S, ""

    def text(self) -> str:
        """Return `, ` and the reason, or nothing."""
        if (now := time.monotonic()) - self._asked >= HOLDUP_PERIOD_S:
            self._asked, self._found = now, self._client.holdup()
        return f", {self._found}" if self._found else ""


@contextlib.contextmanager
def upload_progress() -> Iterator[Callable[[str, int, int], None]]:
    """Show uploads; call what this gives with name, bytes sent and bytes in all."""
    with contextlib.ExitStack() as stack:
        shows: dict[str, Callable[[float, float, str], None]] = {}

        def on_upload(name: str, sent: int, size: int) -> None:
            if name not in shows:
                stack.pop_all().close()  # the file before is complete
                shows[name] = stack.enter_context(live(f"uploading {name}"))
            shows[name](sent, max(size, 1), f"{sent / 1e6:.1f} of {size / 1e6:.1f} MB")

        yield on_upload


@contextlib.contextmanager
def live(title: str, shown: Console | None = None) -> Iterator[Callable[[float, float, str], None]]:
    """Give a function (done, total, text): a live bar on a terminal, else a line now and then."""
    shown = shown or console()
    if not shown.is_terminal:
        last = -PLAIN_PERIOD_S

        def line(done: float, total: float, text: str) -> None:
            nonlocal last
            if (now := time.monotonic()) - last >= PLAIN_PERIOD_S or done >= total:
                last = now
                print(f"{title}  {100 * done / total:3.0f} %  {text}", file=sys.stderr, flush=True)

        yield line
        return
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.fields[text]}", markup=False),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=shown) as progress:
        task = progress.add_task(title, total=1.0, text="")

        def bar(done: float, total: float, text: str) -> None:
            progress.update(task, completed=done, total=total, text=text)

        yield bar
