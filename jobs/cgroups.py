"""A control group (version 2) for the children of a service that was given a subtree of its own.

systemd gives one with `Delegate=memory`, a container with a writable /sys/fs/cgroup. The kernel
takes no processes beside subgroups, so the service moves into `service` and its children begin in
groups below `children`. When memory runs out there the kernel kills a child, and nothing else pages
or dies for it. Without such a subtree nothing is done; the limits that need none hold everywhere.
"""

from __future__ import annotations

import contextlib
import logging
import os
from pathlib import Path

from matiere.jobs import procfs

log = logging.getLogger("matiere.jobs.cgroups")

CHILDREN = "children"
MARK = "user.delegate"  # systemd's extended attribute of a group that is somebody else's to divide


class Groups:
    """The groups of one service's children."""

    def __init__(self, folder: Path) -> None:
        """Divide the group `folder`; `take` does so."""
        self._folder = folder

    def place(self, name: str, memory_bytes: int) -> Path | None:
        """Return the group a child begins in, its memory limited; None if that is refused."""
        group = self._folder / name
        try:
            group.mkdir(exist_ok=True)
            (group / "memory.max").write_text(str(memory_bytes))
            with contextlib.suppress(OSError):  # a kernel without swap accounting
                (group / "memory.swap.max").write_text("0")
        except OSError as error:
            log.warning("no control group for %s: %s", name, error)
            return None
        return group


def take(all_bytes: int, own: Path | None = None) -> Groups | None:
    """Divide the group of this process if it was delegated; None if it was not.

    `all_bytes` is what all children may use together. `own` is for tests.
    """
    folder = own or procfs.own_group()
    if folder is None or not _delegated(folder):
        return None
    service, children = folder / procfs.SERVICE, folder / CHILDREN
    try:
        service.mkdir(exist_ok=True)
        children.mkdir(exist_ok=True)
        (service / "cgroup.procs").write_text("0")
        try:
            for group in (folder, children):
                (group / "cgroup.subtree_control").write_text("+memory")
        except OSError:  # other processes live in it
            (folder / "cgroup.procs").write_text("0")
            raise
        (children / "memory.max").write_text(str(all_bytes))
    except OSError as error:
        log.info("the control group %s cannot be divided: %s", folder, error)
        return None
    log.info("children run in control groups below %s", children)
    return Groups(children)


def join(group: Path) -> None:
    """Move this process into a group."""
    try:
        (group / "cgroup.procs").write_text("0")
    except OSError as error:
        log.warning("cannot join the control group %s: %s", group, error)


def _delegated(folder: Path) -> bool:
    """Tell whether a group was given to us: marked by systemd, or the root of a container."""
    if not (folder / "memory.max").exists():  # no memory controller, or the machine's own root
        return False
    if folder == procfs.GROUPS:
        return os.access(folder / "cgroup.subtree_control", os.W_OK)
    try:
        return os.getxattr(folder, MARK) == b"1"
    except OSError:
        return False
