"""Control groups of children, on plain folders: what is written where, and when nothing is.

What the kernel makes of it is looked at where version 2 rules the memory and root may divide it.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from cgroup_look import SKIPPED

from matiere.jobs import cgroups, procfs


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Make what stands for a delegated group."""
    for name in ("memory.max", "cgroup.procs", "cgroup.subtree_control"):
        (tmp_path / name).write_text("")
    try:
        os.setxattr(tmp_path, cgroups.MARK, b"1")
    except OSError:
        pytest.skip("this file system has no extended attributes of users")
    return tmp_path


def test_service_and_children_part_in_a_delegated_group(folder: Path) -> None:
    groups = cgroups.take(3 * 2**30, folder)
    assert groups is not None
    assert (folder / "service" / "cgroup.procs").read_text() == "0"
    for group in (folder, folder / "children"):
        assert (group / "cgroup.subtree_control").read_text() == "+memory"
    assert (folder / "children" / "memory.max").read_text() == str(3 * 2**30)
    for _ in range(2):  # a child that is started again finds its group
        group = groups.place("render-0", 2**30)
        assert group == folder / "children" / "render-0"
        assert (group / "memory.max").read_text() == str(2**30)
        assert (group / "memory.swap.max").read_text() == "0"
    cgroups.join(group)
    assert (group / "cgroup.procs").read_text() == "0"


def test_a_group_that_is_not_ours_is_left_alone(folder: Path) -> None:
    os.removexattr(folder, cgroups.MARK)
    assert cgroups.take(2**30, folder) is None
    assert not (folder / "service").exists()


def test_without_a_memory_controller_nothing_is_done(folder: Path) -> None:
    (folder / "memory.max").unlink()
    assert cgroups.take(2**30, folder) is None
    assert not (folder / "service").exists()


def test_the_service_goes_back_where_others_live_in_the_group(folder: Path) -> None:
    (folder / "cgroup.subtree_control").unlink()
    (folder / "cgroup.subtree_control").mkdir()  # refuses what is written, as EBUSY would
    assert cgroups.take(2**30, folder) is None
    assert (folder / "cgroup.procs").read_text() == "0"


def test_kills_of_children_are_counted_beside_the_service(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "unit" / "service"
    own.mkdir(parents=True)
    (own / "memory.events").write_text("oom_kill 0\n")
    (own.parent / "memory.events").write_text("oom 4\noom_kill 3\n")
    real = procfs._read
    monkeypatch.setattr(procfs, "GROUPS", tmp_path)
    monkeypatch.setattr(
        procfs, "_read",
        lambda path: "0::/unit/service" if path == Path("/proc/self/cgroup") else real(path),
    )  # fmt: skip
    assert procfs.own_group() == own
    assert procfs.oom_kills() == 3


def test_the_kernel_kills_a_child_and_not_the_service() -> None:
    look = Path(__file__).with_name("cgroup_look.py")
    done = subprocess.run([sys.executable, look], capture_output=True, text=True, timeout=120)
    if done.returncode == SKIPPED:
        pytest.skip(done.stdout.strip())
    assert done.returncode == 0, done.stdout + done.stderr
