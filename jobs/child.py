"""The child process: `python -m matiere.jobs.child`, one request at a time, JSON lines over pipes.

A render child renders claims; the utility child is the same program asked other verbs. It never
opens the database. It ends at once when its control pipe closes, so a killed service leaves no
orphan. Requests: `{"op": "render"|"batch"|"expand"|"check"|"stability"|"merge"|"images"|"sheet"|
"draw", "token": n, ...}`, `{"op": "cancel"|"ping", ...}`; reports:
`{"op": "hello"|"pong"|"reading"|"begun"|"done"|"failed"|"cancelled", "token": n, ...}`. While it is
`reading` files a cancel cannot stop it: the service kills it then.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import errno
import faulthandler
import functools
import importlib
import json
import os
import queue
import resource
import signal
import sys
import threading
import traceback
from functools import partial
from pathlib import Path
from typing import Any

from matiere.errors import MatiereError
from matiere.jobs import cgroups
from matiere.jobs.artifacts import DamagedFile, StorageFault, open_artifacts
from matiere.jobs.job import JsonDict

PR_SET_PDEATHSIG = 1
NICE = 10
PRINTED_BYTES = 4096  # that a report tells of what was printed meanwhile
OOM_SCORE_ADJ = 500  # when memory runs out a child goes before the service does


def harden(parent: int, memory_bytes: int = 0) -> None:
    """Make this process a polite, short-lived victim: low priority, no core, dies with `parent`.

    With `memory_bytes` an allocation beyond it fails: RLIMIT_DATA counts what is private and
    writable, unlike RLIMIT_AS not what TBB and malloc reserve without using it.
    """
    faulthandler.enable()
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(0)  # the parent died before the request above
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if memory_bytes:
        hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
        soft = memory_bytes if hard == resource.RLIM_INFINITY else min(memory_bytes, hard)
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))
    os.nice(NICE)
    try:
        with Path("/proc/self/oom_score_adj").open("w") as file:
            file.write(str(OOM_SCORE_ADJ))
    except OSError:
        pass  # not allowed everywhere; only a preference


class Reports:
    """The pipe to the service; lines from several threads do not mix."""

    def __init__(self, fd: int) -> None:
        """Write to `fd`."""
        self._file = os.fdopen(fd, "wb", buffering=0)
        self._lock = threading.Lock()

    def send(self, op: str, **fields: Any) -> None:
        """Send one report; end the process if nobody listens any more."""
        line = json.dumps({"op": op, **fields}, allow_nan=False).encode() + b"\n"
        try:
            with self._lock:
                at = 0  # a stop and continue cuts a write short that waits for room in the pipe
                while at < len(line):
                    at += self._file.write(line[at:]) or 0
        except BrokenPipeError:
            os._exit(0)


class Child:
    """Reads the control pipe in one thread and works in another."""

    def __init__(self, options: argparse.Namespace) -> None:
        """Open pipes and the work module."""
        self.reports = Reports(options.report)
        self.folder = open_artifacts(options.artifacts)
        self.data = Path(options.data)
        self.work = importlib.import_module(options.work)
        self.threads: int = options.threads
        self.slots: int = options.slots
        self._control = os.fdopen(options.control, "rb")
        self._requests: queue.SimpleQueue[JsonDict] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._cancelled: set[int] = set()
        self._current: tuple[int, Any] | None = None
        self._renderer: Any = None
        self._batches: Any = None
        self._sweeps: Any = None

    def run(self) -> None:
        """Serve requests until the control pipe closes; say hello when all is imported."""
        threading.Thread(target=self._listen, name="control", daemon=True).start()
        self.work.warm_up()
        self.reports.send("hello", pid=os.getpid())
        while True:
            self._serve(self._requests.get())

    def _listen(self) -> None:
        for line in self._control:
            message = json.loads(line)
            if message["op"] == "ping":
                self.reports.send("pong", n=message["n"])
            elif message["op"] == "cancel":
                self._cancel(message["token"])
            else:
                self._requests.put(message)
        os._exit(0)  # also in the middle of a render

    def _cancel(self, token: int) -> None:
        with self._lock:
            self._cancelled.add(token)
            if self._current is not None and self._current[0] == token:
                self._current[1].cancel()

    def _serve(self, request: JsonDict) -> None:
        token: int = request["token"]
        flag = self.work.cancel_token()
        with self._lock:
            self._current = (token, flag)
            unwanted = token in self._cancelled
        before = _log_size()
        try:
            answer = None if unwanted else self._answer(request, flag)
        except BaseException as error:
            report = describe(error)
            self.reports.send("failed", token=token, printed=_printed(before), **report)
        else:
            if answer is None:
                self.reports.send("cancelled", token=token)
            else:
                self.reports.send("done", token=token, printed=_printed(before), **answer)
        finally:
            with self._lock:
                self._current = None
                self._cancelled.discard(token)

    def _answer(self, request: JsonDict, flag: Any) -> JsonDict | None:
        from matiere.jobs import drawing, merge, rendering, utility

        locate_assets(request, self.data)
        if request["op"] == "render":
            if self._renderer is None:
                self._renderer = rendering.Renderer(self.work, self.threads, self.slots)
            reading = functools.partial(self.reports.send, "reading", token=request["token"])
            answer: JsonDict | None = self._renderer.render(request, self.folder, flag, reading)
            return answer
        if request["op"] == "batch":
            return self._batch(request, flag)
        if request["op"] == "expand":
            expanded: JsonDict = self._cells().expand(request)
            return expanded
        if request["op"] == "merge":
            return merge.merge(self.work, request, self.folder)
        if request["op"] == "check":
            return utility.check(self.work, request)
        if request["op"] == "stability":
            return utility.check_material(self.work, request)
        if request["op"] == "images":
            return utility.make_images(self.work, self._cells(), request, self.folder)
        if request["op"] == "night":
            return utility.make_night(self.work, request, self.folder)
        if request["op"] == "draw":
            return drawing.draw(self.work, self._cells(), request, self.folder)
        if request["op"] == "compare":
            return utility.compare(request, self.folder)
        if request["op"] == "sheet":
            return utility.make_sheet(self.work, self._cells(), request, self.folder)
        raise ValueError(f"unknown request {request['op']!r}")

    def _cells(self) -> Any:
        from matiere.jobs.cells import Sweeps

        if self._sweeps is None:
            self._sweeps = Sweeps(self.work, self.folder, partial(locate, self.data))
        return self._sweeps

    def _batch(self, request: JsonDict, flag: Any) -> JsonDict | None:
        from matiere.jobs.batch import BatchRenderer

        if self._batches is None:
            sizes = self.threads, self.slots
            self._batches = BatchRenderer(self.work, self._cells(), describe, *sizes)

        def begun(film_id: int) -> None:
            self.reports.send("begun", token=request["token"], film=film_id)

        answer: JsonDict | None = self._batches.render(request, self.folder, flag, begun)
        return answer


def _log_size() -> int:
    """Return how long the file is that this process prints to; 0 for what is no file."""
    with contextlib.suppress(OSError):
        return os.fstat(2).st_size
    return 0


def _printed(before: int) -> str:
    """Return the end of what was printed since the log had `before` bytes."""
    size = _log_size()
    if size <= before:
        return ""
    sys.stderr.flush()
    with contextlib.suppress(OSError), Path("/proc/self/fd/2").open("rb") as log:
        log.seek(max(before, size - PRINTED_BYTES))
        return log.read(PRINTED_BYTES).decode(errors="replace")
    return ""


def locate_assets(request: JsonDict, data: Path) -> None:
    """Find the assets of a film below the data directory, wherever that lies by now."""
    if "root" in (assets := request.get("assets") or {}):
        assets["root"] = locate(data, assets["root"])


def locate(data: Path, name: str) -> str:
    """Return the folder of assets that a film calls `name`."""
    root = data / name  # an absolute one stays as it is
    if not root.exists():  # written by an older matiere, in a directory that was moved
        root = data / "views" / root.name if root.parent.name == "views" else data / "assets"
    return str(root)


def describe(error: BaseException) -> JsonDict:
    """Sort an exception into a class the supervisor acts on.

    `permanent`: the request itself is wrong, trying again gives the same. `disk_full`: try again
    later. Anything else is tried again a few times.
    """
    if is_storage_fault(error):
        return {"error": "disk_full", "message": str(error), "pointer": "", "permanent": False}
    if isinstance(error, DamagedFile):
        return {"error": "damaged_file", "message": str(error), "pointer": "",
                "permanent": False, "digest": error.digest}  # fmt: skip
    if isinstance(error, MatiereError) and error.code != "out_of_memory":  # Embree's is no fault
        faults = getattr(error, "errors", None)
        return {"error": error.code, "message": error.message, "pointer": error.pointer,
                "permanent": True, "faults": faults}  # fmt: skip
    traceback.print_exception(error, file=sys.stderr)
    memory = isinstance(error, MemoryError) or getattr(error, "code", "") == "out_of_memory"
    kind = "out_of_memory" if memory else "python_error"
    text = "".join(traceback.format_exception_only(error)).strip()
    return {"error": kind, "message": text, "pointer": "", "permanent": False}


def is_storage_fault(error: BaseException | None) -> bool:
    """Tell whether a full or broken disk lies behind an exception."""
    while error is not None:
        if isinstance(error, StorageFault):
            return True
        if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
            return True
        if os.strerror(errno.ENOSPC) in str(error):  # libraries keep only the words
            return True
        error = error.__cause__ or error.__context__
    return False


def main() -> None:
    """Parse the command line and serve."""
    parser = argparse.ArgumentParser(prog="matiere.jobs.child", description=__doc__)
    parser.add_argument("--control", type=int, required=True, help="file descriptor to read")
    parser.add_argument("--report", type=int, required=True, help="file descriptor to write")
    parser.add_argument("--artifacts", required=True, help="folder or URL of artifacts")
    parser.add_argument("--data", required=True, help="data directory")
    parser.add_argument("--work", required=True, help="module that renders")
    parser.add_argument("--threads", type=int, required=True, help="render threads")
    parser.add_argument("--slots", type=int, required=True, help="children x threads")
    parser.add_argument("--parent", type=int, required=True, help="pid of the service")
    parser.add_argument("--memory", type=int, default=0, help="bytes it may allocate; 0: any")
    parser.add_argument("--group", type=Path, help="control group to join")
    options = parser.parse_args()
    if options.group:
        cgroups.join(options.group)
    harden(options.parent, options.memory)
    Child(options).run()


if __name__ == "__main__":
    main()
