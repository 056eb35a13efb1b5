"""Deaths at chosen steps: `os._exit` in a child or in the service, each step once.

`FAKE_CRASH` names a folder with one file for each step, `role.step`; the process that comes to a
step removes its file and ends there and then. `fake_work` installs this where the variable is set.
Roles are what a child is asked (render, merge, images) and `service`.
"""

from __future__ import annotations

import functools
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

VARIABLE = "FAKE_CRASH"
CHILD_STEPS = (
    "received", "before_write", "before_fsync", "before_rename", "after_rename", "after_write",
    "before_report", "after_report",
)  # fmt: skip
TRANSACTIONS = ("submit_job", "claim", "complete", "commit_merge", "finish_job")
SERVICE_STEPS = tuple(
    f"{when}_{name}" for name in TRANSACTIONS for when in ("begun", "uncommitted", "committed")
)

_role, _writing, _last = "", False, ""


def arm(folder: Path, role: str, *steps: str) -> None:
    """Let the next process of this role that comes to one of these steps die there."""
    folder.mkdir(exist_ok=True)
    for step in steps:
        (folder / f"{role}.{step}").touch()


def _come_to(step: str, role: str = "") -> None:
    file = Path(os.environ[VARIABLE]) / f"{role or _role}.{step}"
    try:
        file.unlink()
    except OSError:
        return
    os._exit(86)


def install() -> None:
    """Put the steps into the functions of this process."""
    main = sys.modules["__main__"]
    if hasattr(main, "Reports"):
        _install_in_child(main)
    else:
        _install_in_service()


def _install_in_child(main: Any) -> None:
    from matiere.jobs.artifacts import ArtifactFolder

    answer, send, write = main.Child._answer, main.Reports.send, ArtifactFolder._write
    fsync, replace = os.fsync, Path.replace

    def answered(self: Any, request: dict[str, Any], flag: Any) -> Any:
        global _role
        _role = request["op"]
        _come_to("received")
        return answer(self, request, flag)

    def sent(self: Any, op: str, **fields: Any) -> None:
        if op == "done":
            _come_to("before_report")
        send(self, op, **fields)
        if op == "done":
            _come_to("after_report")

    def written(self: Any, pieces: Any, temporary: Path) -> Any:
        global _writing
        _come_to("before_write")
        _writing = True
        result = write(self, pieces, temporary)
        _come_to("after_write")
        return result

    def synced(fd: int) -> None:
        global _writing
        first, _writing = _writing, False
        if first:
            _come_to("before_fsync")
        fsync(fd)

    def replaced(self: Path, target: Any) -> Any:
        _come_to("before_rename")
        result = replace(self, target)
        _come_to("after_rename")
        return result

    main.Child._answer, main.Reports.send = answered, sent
    ArtifactFolder._write = written  # type: ignore[method-assign]
    os.fsync, Path.replace = synced, replaced  # type: ignore[assignment, method-assign]


def _install_in_service() -> None:
    from matiere.jobs import engine
    from matiere.jobs.store import films, jobs

    def stepped(name: str, action: Callable[..., Any]) -> Callable[..., Any]:
        @functools.wraps(action)
        def run(*arguments: Any) -> Any:
            global _last
            _come_to(f"begun_{name}", "service")
            result = action(*arguments)
            _come_to(f"uncommitted_{name}", "service")
            _last = name
            return result

        return run

    notify = engine.Engine._notify

    def notified(self: Any) -> None:
        global _last
        last, _last = _last, ""
        if last:
            _come_to(f"committed_{last}", "service")
        notify(self)

    for name in TRANSACTIONS:
        module = jobs if hasattr(jobs, name) else films
        setattr(module, name, stepped(name, getattr(module, name)))
    engine.Engine._notify = notified  # type: ignore[method-assign]
