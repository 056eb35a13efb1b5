"""What /proc and the control groups tell of processes and of memory; a dead one raises nothing."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Iterator
from pathlib import Path

PAGE = os.sysconf("SC_PAGE_SIZE")
TICKS = os.sysconf("SC_CLK_TCK")
GROUPS = Path("/sys/fs/cgroup")
SERVICE = "service"  # the group a service moves into beside those of its children: `cgroups`


def rss_bytes(pid: int) -> int:
    """Return the resident memory of a process, 0 if it has ended."""
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * PAGE
    except (OSError, IndexError, ValueError):
        return 0


def state_and_cpu(pid: int) -> tuple[str, float]:
    """Return the state letter of a process and the processor seconds it has used; "" if ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    except (OSError, IndexError):
        return "", 0.0
    return fields[0], (int(fields[11]) + int(fields[12])) / TICKS


def usable_memory() -> int:
    """Return the bytes this process may use: the machine's, or its control group's if less."""
    physical = os.sysconf("SC_PHYS_PAGES") * PAGE
    limits = [physical]
    for folder, name in _groups():
        text = _read(folder / name)
        if text.isdigit():
            limits.append(int(text))
    return min(limits)


def oom_kills() -> int:
    """Return how often the kernel killed for want of memory: in our control groups, or at all."""
    for folder, name in _groups():
        file = "memory.events" if name == "memory.max" else "memory.oom_control"
        for line in _read(folder / file).splitlines():
            if line.startswith("oom_kill "):
                return int(line.split()[1])
    for line in _read(Path("/proc/vmstat")).splitlines():
        if line.startswith("oom_kill "):
            return int(line.split()[1])
    return 0


def give_back_memory() -> None:
    """Return to the kernel what this process has freed: glibc keeps the holes between blocks."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)


def own_group() -> Path | None:
    """Return the control group (version 2) this process lives in; None without one."""
    for line in _read(Path("/proc/self/cgroup")).splitlines():
        if line.startswith("0::/"):
            return GROUPS / line[4:]
    return None


def _groups() -> Iterator[tuple[Path, str]]:
    """Yield our memory groups, innermost first, with the name of the file of their limit."""
    for line in _read(Path("/proc/self/cgroup")).splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers and "memory" not in controllers.split(","):
            continue
        root, name = GROUPS / "memory", "memory.limit_in_bytes"
        if not controllers:
            root, name = GROUPS, "memory.max"
        folder = root / path.lstrip("/")
        if not controllers and folder.name == SERVICE and folder != root:
            folder = folder.parent  # that counts what happened to our children too
        while folder.is_relative_to(root):
            yield folder, name
            folder = folder.parent


def _read(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""
