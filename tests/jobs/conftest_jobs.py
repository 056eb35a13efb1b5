"""Helpers of the job tests: waiting, reading reports, and a service process to kill."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from postgres_server import shared_server

from matiere import jobs
from matiere.jobs import Engine

SCENE: dict[str, Any] = {"width": 32, "height": 24, "value": 1.0, "render": {"spp": 64}}
FAKE: dict[str, Any] = {"work": "fake_work", "min_free_bytes": 0}
databases: dict[str, str] | None = None  # data directory -> PostgreSQL URL; None: SQLite


def stored(data: Path) -> dict[str, str]:
    """Return the options of `open_engine` that choose the store of this test."""
    if databases is None:
        return {}
    if str(data) not in databases:
        databases[str(data)] = shared_server().database()
    return {"database_url": databases[str(data)]}


def open_engine(data: Path, **options: Any) -> Engine:
    """Open an engine over the store that the fixture `store` chose."""
    return jobs.open_engine(data, **stored(data), **options)


def wait_until(condition: Callable[[], Any], timeout_s: float = 20.0) -> Any:
    """Return the first true value of `condition`, or fail."""
    end = time.monotonic() + timeout_s
    while not (value := condition()):
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.01)
    return value


def report_of(engine: Any, job_id: str) -> dict[str, Any]:
    """Return the report of a finished job."""
    return dict(json.loads(Path(engine.artifact(job_id, "report.json").path).read_text()))


def submit_sweep(
    db: Any, count: int, name: str, after: tuple[str, ...] = (), plan: Any = None
) -> str:
    """Insert a sweep of films that are rendered chunk by chunk; return its id."""
    from matiere.jobs.store.cells import submit_sweep as insert
    from matiere.jobs.store.files import Blob
    from matiere.jobs.store.jobs import SweepSpec

    request = {"stop": None, "root": "", "pins": {}}
    plan = plan or Blob(64 * "0", 1)
    spec = SweepSpec("s", "grid", [], {}, 3, count, 50, plan, request, after)
    size = {"width": 8, "height": 8, "replicates": 2}
    rows = [
        size | {"film_key": f"{name}{n}", "geometry_key": "g", "scene": {}, "pins": {}, "cell": n,
                "stop": {"spp": 4}, "spp_cap": 4, "output": {}, "label": "", "parameters": {},
                "small": False}
        for n in range(count)
    ]  # fmt: skip
    return str(db.write(lambda c: insert(c, spec, rows)))


class Service:
    """A process that owns a data directory and submits what it is told, to be killed."""

    def __init__(self, data: Path, script: str, **options: Any) -> None:
        """Run `script` (it sees `engine`) in a fresh process and then wait for jobs for ever."""
        self.data = data
        options |= stored(data)
        program = (
            "import sys, json, time\n"
            "from matiere.jobs import open_engine\n"
            f"engine = open_engine({str(data)!r}, **{options!r})\n"
            f"{script}\n"
            "print('ready', flush=True)\n"
            "time.sleep(1000)\n"
        )
        self.process = subprocess.Popen(
            [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "ready\n"

    def kill(self) -> None:
        """SIGKILL the service and wait for its end."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


def children_of(pid: int) -> list[int]:
    """Return the pids whose parent is `pid`."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = status.read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        if int(fields[1]) == pid and fields[0] != "Z":
            found.append(int(status.parent.name))
    return found


def alive(pid: int) -> bool:
    """Tell whether a process runs (a zombie does not)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def killed_in_the_middle(data: Path, document: dict[str, Any], **options: Any) -> None:
    """Kill a service, and wait for the end of its children, three artifacts into the job."""
    service = Service(data, f"engine.submit_job({document!r})", **options)
    orphans = children_of(service.process.pid)
    folder = data / "artifacts"
    wait_until(lambda: len([p for p in folder.glob("??/??/*") if p.is_file()]) >= 3, 60)
    service.kill()
    wait_until(lambda: not any(alive(pid) for pid in orphans), 5.0)
