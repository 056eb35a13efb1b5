"""A PostgreSQL of the tests' own: Debian's binaries, an unprivileged user, a socket, no TCP."""

from __future__ import annotations

import atexit
import ctypes
import itertools
import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path

import pytest

PR_SET_PDEATHSIG = 1
_numbers = itertools.count(1)


def binaries() -> Path | None:
    """Return the folder of the newest installed server, or None."""
    found = sorted(
        Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda p: float(p.parts[4])
    )
    if found:
        return found[-1].parent
    known = shutil.which("initdb")
    return Path(known).resolve().parent if known else None


class Postgres:
    """A running server; `database` makes one more empty database and returns its URL."""

    def __init__(self, folder: Path, programs: Path) -> None:
        """Make a cluster in `folder` and start it."""
        self.folder, self.programs = folder, programs
        self._who: dict[str, object] = {}
        if os.geteuid() == 0:  # postgres refuses root
            nobody = pwd.getpwnam("nobody")
            os.chown(folder, nobody.pw_uid, nobody.pw_gid)
            self._who = {"user": nobody.pw_uid, "group": nobody.pw_gid, "extra_groups": []}
        make = [programs / "initdb", "-D", folder / "data", "-U", "matiere", "--auth=trust"]
        make += ["--encoding=UTF8", "--locale=C", "--no-sync"]
        done = subprocess.run(make, cwd=folder, capture_output=True, text=True, **self._who)  # type: ignore[call-overload]
        assert done.returncode == 0, done.stdout + done.stderr
        self.start()

    def start(self) -> None:
        """Start the server and wait until it answers."""
        options = ["listen_addresses=", "fsync=off", "max_connections=200", "shared_buffers=32MB"]
        command = [str(self.programs / "postgres"), "-D", str(self.folder / "data")]
        command += ["-k", str(self.folder)]
        for option in options:
            command += ["-c", option]
        with (self.folder / "log").open("ab") as log:
            self.process = subprocess.Popen(  # type: ignore[call-overload]
                command, cwd=self.folder, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                preexec_fn=_die_with_parent, **self._who,
            )  # fmt: skip
        end = time.monotonic() + 60
        while subprocess.run(self._client("pg_isready"), capture_output=True).returncode != 0:
            assert time.monotonic() < end, (self.folder / "log").read_text()
            assert self.process.poll() is None, (self.folder / "log").read_text()
            time.sleep(0.05)

    def stop(self, how: signal.Signals = signal.SIGINT) -> None:
        """Stop the server: SIGINT closes its connections and ends it in order."""
        if self.process.poll() is None:
            self.process.send_signal(how)
        self.process.wait(30)

    def database(self) -> str:
        """Return the URL of a new, empty database."""
        name = f"t{os.getpid()}_{next(_numbers)}"
        self.sql("postgres", f"CREATE DATABASE {name}")
        return f"postgresql://matiere@/{name}?host={self.folder}"

    def sql(self, database: str, command: str) -> str:
        """Run one command with psql and return what it prints."""
        done = subprocess.run(
            [*self._client("psql"), "-d", database, "-AtXc", command],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    def _client(self, program: str) -> list[str]:
        return [str(self.programs / program), "-h", str(self.folder), "-U", "matiere"]


def _die_with_parent() -> None:
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGINT, 0, 0, 0)


_shared: list[Postgres] = []


def shared_server() -> Postgres:
    """Return the server of this test process, started when first wanted; skip without one."""
    if _shared:
        return _shared[0]
    programs = binaries()
    if programs is None:
        pytest.skip("no PostgreSQL here: apt-get install postgresql (./dev test does)")
    folder = Path(tempfile.mkdtemp(prefix="matiere-pg-"))
    server = Postgres(folder, programs)
    _shared.append(server)

    def end() -> None:
        server.stop()
        shutil.rmtree(folder, ignore_errors=True)

    atexit.register(end)
    return server
