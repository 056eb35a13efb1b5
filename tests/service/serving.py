"""Running `matiere serve` as a process of its own."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from matiere.service.client import Client

JOBS_TESTS = Path(__file__).resolve().parents[1] / "jobs"
TIMEOUT_S = 120.0  # on a machine that does much else

# Renders with tests/jobs/fake_work.py: milliseconds, no engine.
QUICK = (
    "import functools, matiere.jobs.engine as e;"
    "e.open_engine = functools.partial(e.open_engine, work='fake_work');"
    "from matiere.service.cli import main; main()"
)


class Serving:
    """A running command and the lines it printed."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self.lines: list[str] = []
        self._queue: queue.Queue[str | None] = queue.Queue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._queue.put(line.rstrip("\n"))
        self._queue.put(None)

    def close(self) -> None:
        """Kill the command if it still runs, and forget it."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self._reader.join(10)
        assert self.process.stdout is not None
        self.process.stdout.close()

    def line(self, start: str, timeout_s: float = TIMEOUT_S) -> str:
        """Return the rest of the first line that begins with `start`."""
        end = time.monotonic() + timeout_s
        while True:
            for line in self.lines:
                if line.startswith(start):
                    return line.removeprefix(start).strip()
            printed = self._queue.get(timeout=max(0.01, end - time.monotonic()))
            if printed is None:
                raise AssertionError(f"ended without {start!r}: {self.lines}")
            self.lines.append(printed)

    def output(self) -> str:
        """Return all that was printed until the end."""
        while (line := self._queue.get(timeout=TIMEOUT_S)) is not None:
            self.lines.append(line)
        return "\n".join(self.lines)

    @property
    def pid(self) -> int:
        """The process."""
        return self.process.pid

    @property
    def url(self) -> str:
        """The URL that was printed."""
        return self.line("url ")

    def stop(self, how: signal.Signals = signal.SIGTERM, timeout_s: float = TIMEOUT_S) -> int:
        """Send a signal and return the exit code."""
        self.process.send_signal(how)
        return self.process.wait(timeout_s)


@contextmanager
def command(
    *arguments: object,
    quick: bool = True,
    environ: Mapping[str, str] | None = None,
    code: str | None = None,
) -> Iterator[Serving]:
    """Run a `matiere` command (through `code`, if given); it is killed if it still runs."""
    environment = {**os.environ, **(environ or {})}
    if quick and code is None:
        paths = [str(JOBS_TESTS), environment.get("PYTHONPATH", "")]
        environment["PYTHONPATH"] = os.pathsep.join(path for path in paths if path)
    start = ["-c", code or QUICK] if quick else ["-m", "matiere.service"]
    process = subprocess.Popen(
        [sys.executable, *start, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment,
    )
    serving = Serving(process)
    try:
        yield serving
    finally:
        serving.close()


@contextmanager
def serve(data: Path, *more: object, quick: bool = True) -> Iterator[tuple[Serving, Client]]:
    """Run `matiere serve` on a free port and give a client once it is ready."""
    with (
        command("serve", "--data", data, "--port", 0, *more, quick=quick) as serving,
        Client(serving.url, patience_s=5) as client,
    ):
        end = time.monotonic() + TIMEOUT_S
        while not client.ready():
            assert time.monotonic() < end, "not ready in time"
            time.sleep(0.02)
        yield serving, client
