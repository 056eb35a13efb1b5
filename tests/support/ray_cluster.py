"""A Ray cluster of several nodes on one machine, which nobody else can reach or see.

Ray binds ports on every interface it finds, so it runs in a network namespace whose only interface
is loopback, and in a process namespace of its own: what is left there can be counted, and nothing
outlives it. `run_inside` runs a script there; the script uses `Cluster`.
"""

from __future__ import annotations

import contextlib
import fcntl
import importlib.util
import json
import os
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

PORT = 6399
NAMESPACES = ("--net", "--mount", "--pid", "--fork", "--mount-proc", "--kill-child")


@cache
def _unshare() -> list[str] | None:
    program = shutil.which("unshare")
    for more in (["--map-root-user"], []):  # as anybody, or as root where that is forbidden
        command = [program or "", *more, *NAMESPACES]
        with contextlib.suppress(OSError, subprocess.TimeoutExpired):
            if subprocess.run([*command, "true"], capture_output=True, timeout=20).returncode == 0:
                return command
    return None


def why_not() -> str | None:
    """Return why no cluster can be started here, or None."""
    if importlib.util.find_spec("ray") is None:
        return "Ray is not installed (pip install 'matiere[ray]')"
    if _unshare() is None:
        return "no namespaces for an unprivileged user here (unshare --map-root-user --net)"
    return None


def run_inside(script: Path, *words: str, timeout_s: float = 300.0) -> dict[str, Any]:
    """Run a script in namespaces of its own; return the JSON of the last line it prints."""
    command = _unshare()
    assert command is not None, why_not()
    folder = Path(tempfile.mkdtemp(prefix="mray-", dir="/tmp"))  # short: names of sockets are
    support = os.pathsep.join(str(Path(__file__).parent / name) for name in (".", "../jobs"))
    path = os.pathsep.join(filter(None, [os.environ.get("PYTHONPATH"), support]))
    environment = os.environ | {
        "HOME": str(folder),
        "TMPDIR": str(folder),
        "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]),
        "PYTHONPATH": path,
        "PYTHONUNBUFFERED": "1",
        "RAY_USAGE_STATS_ENABLED": "0",
    }
    log = folder / "run.log"
    try:
        with log.open("wb") as output:
            process = subprocess.Popen(
                [*command, sys.executable, "-W", "ignore", str(script), *words],
                stdout=subprocess.PIPE,
                stderr=output,
                env=environment,
                text=True,
            )
            try:
                printed = process.communicate(timeout=timeout_s)[0]
            except subprocess.TimeoutExpired:
                process.kill()  # and with it all that is inside
                printed = process.communicate()[0]
        said = printed + log.read_text(errors="replace")[-6000:]
        assert process.returncode == 0, f"{script.name} {words} failed:\n{said}"
        return dict(json.loads(printed.splitlines()[-1]))
    finally:
        shutil.rmtree(folder, ignore_errors=True)


class Cluster:
    """Two or more Ray nodes inside `run_inside`; the first is the head, with GCS."""

    def __init__(self, cpus: int = 1) -> None:
        """Bring loopback up and start two nodes of `cpus` processors."""
        _loopback_up()
        self.address = f"127.0.0.1:{PORT}"
        self.folder = Path(tempfile.gettempdir())
        self.start_head(cpus)
        self.start_node(cpus)

    def start_head(self, cpus: int) -> None:
        """Start the head."""
        _ray("start", "--head", f"--port={PORT}", "--include-dashboard=false",
             f"--temp-dir={self.folder / 'ray'}", f"--num-cpus={cpus}",
             environment={"RAY_health_check_period_ms": "1000"})  # fmt: skip

    def start_node(
        self, cpus: int = 1, environment: dict[str, str] | None = None, before: str = ""
    ) -> None:
        """Start one more node; `before` are shell commands, which see mounts of their own."""
        arguments = ["start", f"--address={self.address}", f"--num-cpus={cpus}"]
        _ray(*arguments, environment=environment, before=before)

    def raylets(self) -> list[int]:
        """Return the pids of the nodes, oldest first."""
        return pids("raylet/raylet")

    def kill(self, words: str, *, last: bool = True) -> None:
        """SIGKILL the newest (or the oldest) process that has `words` in its command line."""
        os.kill(pids(words)[-1 if last else 0], signal.SIGKILL)

    def stop(self) -> list[str]:
        """Stop Ray; return the command lines of what is left besides this process."""
        _ray("stop", "--force")
        end = time.monotonic() + 10
        while (left := [line for pid, line in commands() if pid != os.getpid()]) and (
            time.monotonic() < end
        ):
            time.sleep(0.1)
        return left


def _ray(*words: str, environment: dict[str, str] | None = None, before: str = "") -> None:
    command = [str(Path(sys.executable).parent / "ray"), *words]
    if words[0] == "start":
        command += ["--node-ip-address=127.0.0.1", "--object-store-memory=80000000",
                    "--disable-usage-stats", "--include-log-monitor=false"]  # fmt: skip
    if before:
        command = ["unshare", "--mount", "sh", "-ec", f'{before}\nexec "$@"', "sh", *command]
    done = subprocess.run(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env=os.environ | (environment or {}),
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, f"ray {words}:\n{done.stdout}"


def commands() -> Iterator[tuple[int, str]]:
    """Yield pid and command line of every process of this namespace that runs, oldest first."""
    reap()
    for folder in sorted(Path("/proc").glob("[0-9]*"), key=lambda path: int(path.name)):
        with contextlib.suppress(OSError):
            state = (folder / "stat").read_text().rsplit(")", 1)[1].split()[0]
            text = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
            if state != "Z":
                yield int(folder.name), text


def reap() -> None:
    """Collect orphans: this process is the first of its namespace."""
    known = {int(path.name) for path in Path("/proc/self/task").glob("*")}
    for folder in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            fields = (folder / "stat").read_text().rsplit(")", 1)[1].split()
            if fields[0] == "Z" and int(fields[1]) == 1 and int(folder.name) not in known:
                _collect(int(folder.name))


def _collect(pid: int) -> None:
    # Processes that a Popen object of ours waits for are left to it.
    if pid not in _ours():
        with contextlib.suppress(ChildProcessError):
            os.waitpid(pid, os.WNOHANG)


def _ours() -> set[int]:
    import gc

    return {o.pid for o in gc.get_objects() if isinstance(o, subprocess.Popen)}


def pids(words: str) -> list[int]:
    """Return the pids of the processes with `words` in their command line, oldest first."""
    return [pid for pid, line in commands() if words in line]


def _loopback_up() -> None:
    up = struct.pack("16sH14x", b"lo", 0x1 | 0x40)  # IFF_UP, IFF_RUNNING
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        fcntl.ioctl(any_socket, 0x8914, up)  # SIOCSIFFLAGS


def wildcard_ports() -> list[str]:
    """Return the addresses other than loopback that something here listens on."""
    found = []
    for name, loopback in (("tcp", "0100007F"), ("tcp6", "0000000000000000FFFF00000100007F")):
        for line in Path(f"/proc/net/{name}").read_text().splitlines()[1:]:
            fields = line.split()
            host = fields[1].split(":")[0]
            if fields[3] == "0A" and host not in (loopback, "00000000000000000000000001000000"):
                found.append(fields[1])
    return found
