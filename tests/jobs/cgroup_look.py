"""What the kernel makes of the control groups: run as root where version 2 rules the memory.

`python cgroup_look.py` makes three groups below /sys/fs/cgroup, moves itself through them and exits
with 0 if a child beyond its limit is killed and counted, and the service never is.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import time
from pathlib import Path

from matiere.jobs import cgroups, procfs

MIB = 2**20
SKIPPED = 77
CHILD = """
import sys, time
from pathlib import Path
from matiere.jobs import cgroups
cgroups.join(Path(sys.argv[1]))
held = [b"x" * 2**20 for _ in range(int(sys.argv[2]))]
print("held", len(held), "MiB", flush=True)
time.sleep(float(sys.argv[3]))
"""


def unit(name: str, mark: bool = True) -> Path:
    """Make a group as systemd does, and move into it."""
    group = procfs.GROUPS / name
    group.mkdir(exist_ok=True)
    if mark:
        os.setxattr(group, cgroups.MARK, b"1")
    (group / "cgroup.procs").write_text("0")
    return group


def child(group: Path | None, mib: int, rest_s: float = 0.0) -> subprocess.Popen[bytes]:
    """Start a process that joins `group` and holds some memory."""
    return subprocess.Popen([sys.executable, "-c", CHILD, str(group), str(mib), str(rest_s)])


def tidy() -> None:
    """Go back to the root and remove the groups."""
    (procfs.GROUPS / "cgroup.procs").write_text("0")
    for group in sorted(procfs.GROUPS.glob("matiere-*/**/"), reverse=True):
        group.rmdir()


def look() -> None:
    """Look; an AssertionError tells what is otherwise."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    print("kernel", os.uname().release)
    unit("matiere-bare", mark=False)
    assert cgroups.take(100 * MIB) is None, "not delegated"
    crowded = unit("matiere-crowded")
    other = subprocess.Popen(["sleep", "1000"])
    assert cgroups.take(100 * MIB) is None, "another process lives in the group"
    assert procfs.own_group() == crowded
    other.kill()
    other.wait()
    mine = unit("matiere-unit")
    groups = cgroups.take(100 * MIB)
    assert groups is not None and procfs.own_group() == mine / "service"
    kills = procfs.oom_kills()
    assert child(groups.place("render-0", 60 * MIB), 200).wait() == -9, "beyond its limit"
    assert procfs.oom_kills() == kills + 1
    assert child(groups.place("render-0", 60 * MIB), 20).wait() == 0, "started again, within it"
    first = child(groups.place("render-0", 90 * MIB), 60, 120.0)
    time.sleep(10.0)
    second = child(groups.place("render-1", 90 * MIB), 60)
    ends = {second.wait(60), first.poll()}
    assert -9 in ends, "two within their limits, together beyond that of all"
    assert procfs.oom_kills() == kills + 2
    first.kill()
    first.wait()
    print("good: children were killed, the service lives in", procfs.own_group())


def main() -> int:
    """Look and tidy up; SKIPPED where the groups cannot be divided."""
    try:
        if "memory" not in (procfs.GROUPS / "cgroup.controllers").read_text().split():
            raise OSError("no memory controller")
        (procfs.GROUPS / "cgroup.subtree_control").write_text("+memory")
    except OSError as error:
        print(f"{procfs.GROUPS} cannot be divided: {error}")
        return SKIPPED
    try:
        look()
    finally:
        tidy()
    return 0


if __name__ == "__main__":
    sys.exit(main())
