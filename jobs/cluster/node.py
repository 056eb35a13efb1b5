"""What runs on a node: a claim, in a render child there; and a look at whether the node will do.

A Ray task is the supervisor of one render child, the same program as on one machine: its crash, its
memory and its time are classed here, and Ray's worker process touches no pixels. The child stays
with the worker process from task to task, with the scenes it has built, and dies with it.
"""

from __future__ import annotations

import atexit
import contextlib
import importlib
import os
import platform
import queue
import shutil
import signal
import socket
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matiere.jobs import procfs
from matiere.jobs.artifacts import DamagedFile, StorageFault, open_artifacts
from matiere.jobs.children import Child, ChildOptions
from matiere.jobs.job import JsonDict
from matiere.jobs.slots import Held

POLL_S = 0.02
MEMORY_SHARE = 0.75  # of a node, for one render child, without a limit of its own
MIB = 2**20
SHARED_FOLDERS = ("assets", "views")  # of the data directory; read on every node
MARK = ".shared"  # a file in them, by which a node tells that they are the service's


@dataclass(frozen=True)
class Post:
    """What every task needs to know."""

    artifacts: str
    data: str
    work: str
    threads: int
    memory_bytes: int
    claim_limit_s: float


# -- a claim ------------------------------------------------------------------------------------
_station: Station | None = None


def render(post: Post, request: JsonDict) -> JsonDict:
    """Have the render child of this worker process answer a request; return its report.

    A child that ended instead is reported as `{"op": "ended", "kind", "message", ...}`.
    """
    global _station
    if _station is None:
        _station = Station(post)
    return _station.serve(request)


class Station:
    """The render child of one Ray worker process."""

    def __init__(self, post: Post) -> None:
        """Make a folder for its log and scratch files; the child starts with the first claim."""
        self._post = post
        self._inbox: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._child: Child | None = None
        _remove_stale_folders()
        self._folder = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{os.getpid()}-"))
        atexit.register(shutil.rmtree, self._folder, ignore_errors=True)

    def serve(self, request: JsonDict) -> JsonDict:
        """Send a request and wait for its report, keeping an eye on the child."""
        token, now = request["token"], time.monotonic()
        held = Held(token, -1, [], 0, now)
        with _cancels() as asked:
            child = self._child or self._start()
            child.inflight[token] = held
            child.send(**request)
            try:
                while (report := self._report(child, held)) is None:
                    now = time.monotonic()
                    if asked and held.cancelled is None:
                        held.cancelled = now
                        child.send("cancel", token=token)
                    child.tick(now)
                    child.press(now)
                    self._limit(child, held, now)
                    if child.escaped(now):
                        report = self._ended(child, held, None)
                        break
            finally:
                child.inflight.clear()
        return report

    def _start(self) -> Child:
        p = self._post
        memory = p.memory_bytes or int(MEMORY_SHARE * procfs.usable_memory())
        options = ChildOptions("render", p.artifacts, Path(p.data), self._folder, p.work, p.threads,
                               p.threads, memory, self._folder / "tmp")  # fmt: skip
        self._child = Child(options, self._inbox)
        return self._child

    def _report(self, child: Child, held: Held) -> JsonDict | None:
        """Return the report that ends a claim, if it has come."""
        with contextlib.suppress(queue.Empty):
            message = self._inbox.get(timeout=POLL_S)
            body = message.body
            if message.child is not child:
                return None  # of one that was given up
            if body["op"] == "exit":
                return self._ended(child, held, body["code"])
            if body["op"] == "hello":
                child.greet(body)
            elif body.get("token") != held.token:
                return None
            elif body["op"] == "reading":
                held.phase = "reading" if body["on"] else "working"
            elif body["op"] == "begun":
                held.begun, held.phase = body["film"], "working"
            else:
                tail = child.log_tail() if body["op"] == "failed" else ""
                return {**body, "log_tail": tail}
        return None

    def _ended(self, child: Child, held: Held, code: int | None) -> JsonDict:
        self._child = None
        kind, words = child.exit_class(code)
        return {"op": "ended", "token": held.token, "error": kind, "message": words,
                "log_tail": child.log_tail(), "begun": held.begun}  # fmt: skip

    def _limit(self, child: Child, held: Held, now: float) -> None:
        if child.killed:
            return
        limit = self._post.memory_bytes
        if limit and (size := procfs.rss_bytes(child.pid)) > limit:
            words = f"it used {size // MIB} MiB of memory; a child may use {limit // MIB} MiB"
            child.kill(cause=("memory_limit", words))
        elif now - held.sent > self._post.claim_limit_s:
            words = f"it worked on one claim for more than {self._post.claim_limit_s:g} s"
            child.kill(cause=("time_limit", words))


@contextlib.contextmanager
def _cancels() -> Iterator[list[bool]]:
    """Yield a list that is filled when the driver cancels this task (Ray raises SIGINT)."""
    asked: list[bool] = []
    before = signal.signal(signal.SIGINT, lambda *_: asked.append(True))
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)


_PREFIX = "matiere-node-"


def _remove_stale_folders() -> None:
    """Remove what worker processes that were killed have left in the folder of scratch files."""
    for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        pid = folder.name.removeprefix(_PREFIX).split("-")[0]
        with contextlib.suppress(OSError):
            dead = pid.isdigit() and not Path(f"/proc/{pid}").exists()
            if dead and folder.stat().st_uid == os.getuid():
                shutil.rmtree(folder, ignore_errors=True)


# -- a look at the node -------------------------------------------------------------------------
def fingerprint(work: str) -> JsonDict:
    """Return what decides on the bits of a render: the engine, and the library of its maths."""
    engines = importlib.import_module(work).engines()
    return {**next(iter(engines.values())), "libc": " ".join(platform.libc_ver())}


def examine(post: Post, mark: str, probe: str, wanted: JsonDict) -> JsonDict:
    """Return the name of this node and why it cannot be used (`reason`; "": it can).

    `mark` is what the service wrote into the folders that must be shared, `probe` an artifact,
    `wanted` the service's fingerprint. The node writes an artifact too (`written`).
    """
    answer: JsonDict = {"name": socket.gethostname(), "reason": "", "written": None}
    if (mine := fingerprint(post.work)) != wanted:
        return answer | {"reason": _difference(mine, wanted)}
    for name in SHARED_FOLDERS:
        if _read(Path(post.data) / name / MARK) != mark:
            why = f"it does not see the folder {post.data}/{name} of the service"
            return answer | {"reason": f"{why}; share it under the same name"}
    folder = open_artifacts(post.artifacts)
    try:
        folder.read(probe)
        digest, size = folder.write([f"node {answer['name']} {os.getpid()} {mark}".encode()])
    except DamagedFile:
        why = f"it does not see the artifacts of the service at {folder.location}"
        return answer | {"reason": f"{why}; share them under the same name, or use artifacts_url"}
    except StorageFault as error:
        return answer | {"reason": f"it cannot write artifacts: {error}"}
    return answer | {"written": [digest, size]}


def _difference(mine: JsonDict, wanted: JsonDict) -> str:
    """Say in words how the engine of this node differs from the service's."""
    parts = [
        f"{key} is {mine.get(key)!r}, not {wanted.get(key)!r}"
        for key in sorted({*mine, *wanted})
        if mine.get(key) != wanted.get(key)
    ]
    return "it renders other bits than the service: " + ", ".join(parts)


def _read(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:
        return ""
