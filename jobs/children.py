"""Child processes seen from the service: start, talk, ping, kill, and read what they left."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from matiere.jobs import procfs
from matiere.jobs.job import JsonDict

log = logging.getLogger("matiere.jobs.children")

PING_S = 5.0
LEASE_S = 30.0  # without an answer for so long a child is killed and its work given back
START_S = 120.0  # the same for a child that has yet to say hello
REAP_S = 10.0  # a killed child that the kernel does not give back is then given up
BUSY_SHARE = 0.1  # of the lease on a processor: a silent child hangs by its own fault
TERM_AFTER_S, KILL_AFTER_S = 1.0, 3.0  # after a cancel that it does not answer
READING_KILL_S = 0.02  # the same while it reads files
DISOBEYED = ("lost", "killed by the service because it did not stop when it was told to cancel")
UNREADABLE = ("lost", "killed by the service because a report of it could not be read")
LOG_BYTES = 4 * 2**20
LOG_TAIL_BYTES = 4096


@dataclass(frozen=True)
class ChildOptions:
    """How to start a child."""

    name: str
    artifacts: str | Path
    data: Path
    logs: Path
    work: str
    threads: int
    slots: int
    memory_bytes: int = 0  # RLIMIT_DATA; 0: none
    scratch: Path | None = None  # its TMPDIR; none: in the data directory
    group: Path | None = None  # control group that it joins


@dataclass(frozen=True)
class Message:
    """A report (`op` and fields), or the exit of a child (`op` is "exit")."""

    child: Child
    body: JsonDict


class Child:
    """One running child. Its reports and its exit arrive in the inbox given to `start`."""

    remote = False  # it renders nothing itself: what works for it is limited elsewhere
    nodes: Sequence[JsonDict] = ()  # where that is

    def __init__(self, options: ChildOptions, inbox: queue.SimpleQueue[Any]) -> None:
        """Start the process; call from a thread that lives as long as the child should."""
        self.options = options
        self.capacity = 1  # claims that it works on at once
        self.name = options.name
        self.inflight: OrderedDict[int, Any] = OrderedDict()  # token -> claim, in order of work
        self.seen: OrderedDict[str, None] = OrderedDict()  # film keys it has worked on, newest last
        self.geometry = ""
        self.alive = True
        self.ready = False
        self.started = self.answered = self._pinged = time.monotonic()
        self.killed = False
        self.killed_at: float | None = None  # by SIGKILL
        self.cause: tuple[str, str] | None = None  # class and words, when the service killed it
        self.working: int | None = None  # token of the claim at work, kept by the warden
        self.working_since = 0.0
        self.oom_kills = procfs.oom_kills()
        self._cpu_answered = 0.0
        self._inbox = inbox
        self._outbox: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._log_path = options.logs / f"{options.name}.log"
        self._log_start = 0
        self._spawn()

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    # -- talking ------------------------------------------------------------------------------
    def greet(self, body: JsonDict) -> list[JsonDict]:
        """Take its hello; return what is to become known as events: `{"kind": ..., ...}`."""
        self.ready = True
        return []

    @property
    def trouble(self) -> str:
        """Why it cannot work though it answers; "" if it can."""
        return ""

    def send(self, op: str, **fields: Any) -> None:
        """Queue a request; never blocks, whatever the child does."""
        self._outbox.put(json.dumps({"op": op, **fields}, allow_nan=False).encode() + b"\n")

    def tick(self, now: float) -> None:
        """Ping the child; kill it when its control thread has not answered for a lease."""
        if not self.alive:
            return
        patience = LEASE_S if self.ready else START_S
        if now - self.answered > patience and not self.killed:
            self.kill(cause=self._why_silent(patience))
        elif now - self._pinged > PING_S:
            self._pinged = now
            self.send("ping", n=0)
        self._trim_log()

    def press(self, now: float) -> bool:
        """Kill it if it does not obey a cancel; tell whether one is still to be obeyed.

        C++ stops within milliseconds, while it builds too. Nothing stops the reading of files.
        """
        asked = [held for held in self.inflight.values() if held.cancelled is not None]
        if not asked:
            return False
        waited = now - min(held.cancelled for held in asked)
        first = next(iter(self.inflight.values()))
        reading = first.cancelled is not None and first.phase == "reading"
        if waited > KILL_AFTER_S or (reading and now - first.cancelled > READING_KILL_S):
            self.kill(cause=DISOBEYED)
        elif waited > TERM_AFTER_S and not self.killed:
            self.kill(signal.SIGTERM, cause=DISOBEYED)
        return True

    def escaped(self, now: float) -> bool:
        """Tell whether the child was killed long ago and the kernel has not given it back."""
        return self.killed_at is not None and now - self.killed_at > REAP_S

    def kill(
        self, how: signal.Signals = signal.SIGKILL, cause: tuple[str, str] | None = None
    ) -> None:
        """Send a signal to the child (it is reaped by its own reader thread)."""
        self.killed = True
        if self.cause is None and cause is not None:
            self.cause = cause
            log.warning("%s (pid %d) is killed: %s", self.name, self.pid, cause[1])
        if how is signal.SIGKILL and self.killed_at is None:
            self.killed_at = time.monotonic()
        with contextlib.suppress(ProcessLookupError):
            self._process.send_signal(how)

    def close(self) -> None:
        """Close the control pipe: the child ends at once."""
        self._outbox.put(None)

    def wait(self, timeout: float) -> bool:
        """Wait for the end; true if it came."""
        try:
            self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            return False
        return True

    def exit_class(self, code: int | None) -> tuple[str, str]:
        """Return class and words for how this child ended; None: it could not be reaped."""
        return exit_class(code, self.cause, procfs.oom_kills() > self.oom_kills)

    # -- remains ------------------------------------------------------------------------------
    def log_tail(self) -> str:
        """Return the last lines this process wrote to its log."""
        try:
            with self._log_path.open("rb") as file:
                end = file.seek(0, os.SEEK_END)
                file.seek(max(self._log_start if end > self._log_start else 0,
                              end - LOG_TAIL_BYTES))  # fmt: skip
                return file.read().decode(errors="replace")
        except OSError:
            return ""

    # -- inside -------------------------------------------------------------------------------
    def _command(self) -> list[str]:
        """Return the program and its options but for the pipes."""
        o = self.options
        command = [sys.executable, "-m", "matiere.jobs.child", "--artifacts", str(o.artifacts)]
        command += ["--data", str(o.data), "--work", o.work, "--threads", str(o.threads)]
        command += ["--slots", str(o.slots), "--memory", str(o.memory_bytes)]
        return command + (["--group", str(o.group)] if o.group else [])

    def _spawn(self) -> None:
        o = self.options
        control_read, control_write = os.pipe2(os.O_CLOEXEC)
        report_read, report_write = os.pipe2(os.O_CLOEXEC)
        command = [*self._command(), "--parent", str(os.getpid())]
        command += ["--control", str(control_read), "--report", str(report_write)]
        single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        temporary = o.scratch or o.data / "artifacts" / "tmp"  # emptied when the service starts
        with contextlib.suppress(OSError):
            temporary.mkdir(mode=0o700, parents=True, exist_ok=True)
        environment = {**os.environ, **single, "PYTHONSAFEPATH": "1", "TMPDIR": str(temporary)}
        self._rotate_log()
        with self._log_path.open("ab") as output:
            self._log_start = output.tell()
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                pass_fds=(control_read, report_write),
                start_new_session=True,
                env=environment,
            )
        os.close(control_read)
        os.close(report_write)
        for target, fd in ((self._write, control_write), (self._read, report_read)):
            threading.Thread(target=target, args=(fd,), name=o.name, daemon=True).start()

    def _write(self, fd: int) -> None:
        with os.fdopen(fd, "wb", buffering=0) as pipe:
            while (line := self._outbox.get()) is not None:
                try:
                    at = 0
                    while at < len(line):
                        at += pipe.write(line[at:]) or 0
                except (BrokenPipeError, OSError):
                    return

    def _read(self, fd: int) -> None:
        with os.fdopen(fd, "rb") as pipe:
            for line in pipe:
                try:
                    body = json.loads(line)
                except ValueError:
                    if line.endswith(b"\n"):  # else the last line of a killed child
                        self.kill(cause=UNREADABLE)
                    continue
                if body["op"] in ("pong", "hello"):  # of the control thread: no other renews
                    self.answered = time.monotonic()
                    self._cpu_answered = procfs.state_and_cpu(self.pid)[1]
                if body["op"] != "pong":
                    self._inbox.put(Message(self, body))
        code = self._process.wait()
        self._outbox.put(None)
        self._inbox.put(Message(self, {"op": "exit", "code": code}))

    def _why_silent(self, patience: float) -> tuple[str, str]:
        state, cpu = procfs.state_and_cpu(self.pid)
        words = f"its control thread has not answered for {patience:g} s"
        if state in ("T", "t"):
            return "lost", f"{words}: the process was stopped from outside"
        if cpu - self._cpu_answered >= BUSY_SHARE * patience:
            return "unresponsive", f"{words}, though it computes: the work holds it up"
        return "lost", words

    def _rotate_log(self) -> None:
        """Put the log of the child before aside; cut it first, or its whole size would stay."""
        self._trim_log()
        with contextlib.suppress(OSError):
            if self._log_path.stat().st_size > LOG_BYTES:
                self._log_path.replace(self._log_path.with_suffix(".log.1"))

    def _trim_log(self) -> None:
        """Cut a log that grows without end; the child appends, so it goes on at the start."""
        with contextlib.suppress(OSError):
            if self._log_path.stat().st_size > 4 * LOG_BYTES:
                tail = self.log_tail()
                self._log_path.with_suffix(".log.1").write_text(tail)
                os.truncate(self._log_path, 0)
                self._log_start = 0


def exit_class(
    code: int | None, cause: tuple[str, str] | None = None, memory_ran_out: bool = False
) -> tuple[str, str]:
    """Return class and words for how a child ended.

    `lost` is nobody's fault; every other class is that of the work. `cause` is why the service
    killed it, `memory_ran_out` that the kernel has killed for want of memory meanwhile.
    """
    if cause is not None:
        return cause
    if code is None:
        return "lost", "killed, but the kernel does not give the process back"
    if code == -signal.SIGKILL and memory_ran_out:
        return "out_of_memory", "killed by the kernel for want of memory"
    if code == -signal.SIGKILL:
        return "lost", "killed from outside (SIGKILL)"
    if code in (-signal.SIGTERM, -signal.SIGINT, -signal.SIGHUP):
        return "lost", f"ended from outside ({signal.Signals(-code).name})"
    if code < 0:
        return "signal", f"crashed with {signal.Signals(-code).name}"
    return "python_error", f"ended by itself with exit code {code}"
