"""Telling people how a job or a sweep goes on: figures in words, and `matiere watch`.

What is extrapolated says "about": how long it takes is told from the error at the newest look and
from how fast render seconds passed of late.
"""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import TextIO

from rich.console import Console

from matiere.service.client import Client, JobStatus, ServiceEvent, SweepStatus
from matiere.service.console import Holdup, describe, format_error, format_time, live
from matiere.service.page import words

CODES = {"succeeded": 0, "failed": 1, "cancelled": 3, "expired": 4, "unfinished": 5}
WINDOW_S = 30.0  # of the rate at which render seconds pass
LEAST_S = 1.0  # that it is measured over
LOOK_S = 0.3  # shortest time between two looks at what changes without an event of its own
LINE_S = 10.0  # between two lines about the same state, but for news
NEWS_LINE_S = 1.0  # between two lines about news
Status = JobStatus | SweepStatus


class Pace:
    """How fast something grows, as seen of late: render seconds, of all processes together."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Measure by `clock`."""
        self._clock = clock
        self._seen: deque[tuple[float, float]] = deque()

    def see(self, seconds: float) -> None:
        """Take note of how far it is."""
        now = self._clock()
        if self._seen and seconds < self._seen[-1][1]:
            self._seen.clear()  # another attempt
        if not self._seen or seconds > self._seen[-1][1]:
            self._seen.append((now, seconds))
        while len(self._seen) > 2 and now - self._seen[0][0] > WINDOW_S:
            self._seen.popleft()

    def wait(self, seconds: float) -> float | None:
        """Return how long `seconds` more of it take, None while that is unknown."""
        if len(self._seen) < 2 or self._seen[-1][0] - self._seen[0][0] < LEAST_S:
            return None
        (begin, first), (end, last) = self._seen[0], self._seen[-1]
        return seconds * (end - begin) / (last - first)


def figures(job: JobStatus, pace: Pace) -> str:
    """Return samples and error of a job, and its outlook while it is rendered."""
    if job.state == "queued" and not job.spp:
        others = f"{job.waiting_for} other{'s' if job.waiting_for > 1 else ''}"
        waits = f", waits for {others}" if job.waiting_for else ""
        return f"queued{waits}"
    most = job.stop.get("spp")
    samples = f"{job.spp:,} of {most:,} spp" if most and most > job.spp else f"{job.spp:,} spp"
    told = [samples, format_error(job)]
    if job.state != "running" and not job.ended:
        told.insert(0, job.state)
    elif job.state == "running" and (ahead := outlook(job, pace)):
        told.append(ahead)
    return ", ".join(told)


def outlook(job: JobStatus, pace: Pace) -> str:
    """Return how long a running job is expected to take, and to what."""
    target = job.stop.get("target_error")
    name = words.target_error(target) if target else ""
    to_end = job.seconds * (1.0 / job.progress - 1.0) if 0.0 < job.progress < 1.0 else None
    if not target:
        return f"{_about(to_end, pace)} left" if to_end is not None else ""
    if job.target_seconds is None:
        return f"time to {name} not known yet"
    to_target = max(job.target_seconds - job.seconds, 0.0)
    if to_end is not None and to_end < 0.95 * to_target:
        return f"ends in {_about(to_end, pace)}, before {name} ({_about(to_target, pace)})"
    return f"{name} in {_about(to_target, pace)}"


def _about(seconds: float, pace: Pace) -> str:
    wall = pace.wait(seconds)
    if wall is None:
        return f"about {format_time(seconds)} of rendering"
    return f"about {format_time(wall)}"


def sweep_figures(sweep: SweepStatus, pace: Pace) -> str:
    """Return how many cells have ended and how, and how long the others take."""
    told = [f"{sweep.ended_cells:,} of {sweep.cells:,} cells"]
    told += [f"{n:,} {state}" for state, n in sweep.counts.items() if n]
    if sweep.budget is not None:
        told.append(f"{sweep.budget.spent_s:.3g} of {sweep.budget.seconds:g} s spent")
    left = pace.wait(1.0 - _share(sweep))
    if left is not None and not sweep.ended:
        told.append(f"about {format_time(left)} left")
    return ", ".join(told)


def _share(sweep: SweepStatus) -> float:
    if sweep.budget is not None:
        return min(sweep.budget.share, 0.99)
    return sweep.ended_cells / max(sweep.cells, 1)


@contextlib.contextmanager
def job_progress(label: str, client: Client) -> Iterator[Callable[[JobStatus], None]]:
    """Show one job that is asked for again and again; call what this gives at every look."""
    pace, holdup = Pace(), Holdup(client)

    def look(job: JobStatus) -> None:
        pace.see(job.seconds)
        held = holdup.text() if job.state == "queued" else ""
        show(job.progress, 1.0, figures(job, pace) + held)

    with live(label) as show:
        yield look


class Watch:
    """One `matiere watch`: what is shown after each event."""

    def __init__(self, client: Client, status: Status, out: TextIO) -> None:
        """Show on `out`: a bar if that is a terminal, else lines."""
        self._client, self.status, self._out = client, status, out
        self._pace, self._holdup = Pace(), Holdup(client)
        self._looked = self._printed = -1e9
        self._said: object = None
        self._lost = False

    def run(self) -> Status:
        """Follow to the end and return how it ended; `status` is always the newest known."""
        console = Console(file=self._out)
        if not console.is_terminal:
            self._follow(self._line, self._tell)
        else:
            with live(self.name, console) as bar:
                self._follow(lambda share, text, _: bar(share, 1.0, text), console.print)
        return self.status

    @property
    def name(self) -> str:
        """What people call it."""
        return self.status.label or self.status.id

    def _follow(
        self, show: Callable[[float, str, bool], None], tell: Callable[[str], None]
    ) -> None:
        def on_lost(why: str) -> None:
            self._lost = True
            tell(f"{self.name}: the service does not answer ({why}); trying again")

        for event in self._client.watch(self.status, on_lost=on_lost):
            if self._lost:
                self._lost = False
                tell(f"{self.name}: the service answers again")
            if self._refresh(event):
                show(*self._text(), event.kind == "look")
        self.status = self._now()

    def _refresh(self, event: ServiceEvent) -> bool:
        """Bring `status` up to date, not oftener than it is worth; tell whether it was."""
        now = time.monotonic()
        passing = event.kind in ("progress", "look") or isinstance(self.status, SweepStatus)
        if event.status is not None:
            self.status = event.status
        elif passing and now - self._looked < LOOK_S:
            return False
        else:
            self.status = self._now()
        self._looked = now
        if isinstance(self.status, JobStatus):
            self._pace.see(self.status.seconds)
        elif self.status.state == "running":
            self._pace.see(_share(self.status))
        return not self.status.ended

    def _now(self) -> Status:
        if isinstance(self.status, SweepStatus):
            return self._client.sweep(self.status.id)
        return self._client.job(self.status.id)

    def _text(self) -> tuple[float, str]:
        if isinstance(self.status, SweepStatus):
            return _share(self.status), sweep_figures(self.status, self._pace)
        held = self._holdup.text() if self.status.state == "queued" else ""
        return self.status.progress, figures(self.status, self._pace) + held

    def _line(self, share: float, text: str, is_news: bool) -> None:
        now = time.monotonic()
        is_sweep = isinstance(self.status, SweepStatus)
        about = self.status.counts if isinstance(self.status, SweepStatus) else self.status.state
        is_new = about != self._said
        wait = NEWS_LINE_S if (is_new if is_sweep else is_news) else LINE_S
        if (is_new and not is_sweep) or now - self._printed >= wait:
            self._said, self._printed = about, now
            self._tell(f"{self.name}  {100 * share:3.0f} %  {text}")

    def _tell(self, text: str) -> None:
        print(f"{time.strftime('%H:%M:%S')}  {text}", file=self._out, flush=True)


def ended(status: Status) -> str:
    """Return one line on how it ended."""
    if isinstance(status, JobStatus):
        return describe(status)
    counts = ", ".join(f"{n:,} {state}" for state, n in status.counts.items() if n)
    return f"{status.label or status.id}: {status.state}, {counts}"


def goes_on(kind: str, name: str, url: str) -> str:
    """Return what to say to those who no longer watch."""
    return (
        f"{kind} {name} goes on at {url}; watch it again, or cancel it, with\n"
        f"  matiere watch {name} --url {url}\n"
        f"  matiere cancel {name} --url {url}"
    )
