"""The child program: what it imports, how it ends, what it says."""

from __future__ import annotations

import json
import os
import queue
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from matiere.jobs import children


def test_a_child_imports_no_database_no_service_and_no_engine() -> None:
    program = (
        "import sys\nimport matiere.jobs.child, matiere.jobs.rendering, matiere.jobs.utility\n"
        "import matiere.jobs.merge, matiere.jobs.work\n"
        "bad = {'sqlalchemy', 'alembic', 'pysqlite3', 'sqlite3', 'fastapi'}\n"
        "bad |= {'matiere.jobs.engine', 'matiere.jobs.scheduler'}\n"
        "assert not bad & set(sys.modules), bad & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)


def start(tmp_path: Path) -> tuple[subprocess.Popen[bytes], int, int]:
    """Start a child by hand; return it with the control and report ends of its pipes."""
    control_read, control_write = os.pipe()
    report_read, report_write = os.pipe()
    command = [sys.executable, "-m", "matiere.jobs.child", "--control", str(control_read)]
    command += ["--report", str(report_write), "--artifacts", str(tmp_path), "--work", "fake_work"]
    command += ["--data", str(tmp_path)]
    command += ["--threads", "1", "--slots", "1", "--parent", str(os.getpid())]
    child = subprocess.Popen(command, pass_fds=(control_read, report_write), start_new_session=True)
    os.close(control_read)
    os.close(report_write)
    return child, control_write, report_read


def test_a_child_answers_pings_and_ends_with_its_control_pipe(tmp_path: Path) -> None:
    child, control, report = start(tmp_path)
    with os.fdopen(report, "rb") as reports:
        assert json.loads(reports.readline()) == {"op": "hello", "pid": child.pid}
        os.write(control, b'{"op": "ping", "n": 7}\n')
        assert json.loads(reports.readline()) == {"op": "pong", "n": 7}
        status = Path(f"/proc/{child.pid}/status").read_text()
        assert os.getsid(child.pid) == child.pid, "a session of its own"
        own = os.getpriority(os.PRIO_PROCESS, 0)
        assert os.getpriority(os.PRIO_PROCESS, child.pid) >= min(19, own + 10)
        limits = Path(f"/proc/{child.pid}/limits").read_text()
        core = next(line for line in limits.splitlines() if line.startswith("Max core file"))
        assert core.split()[4] == "0"
        assert "State:" in status
        os.write(control, b'{"op": "nonsense", "token": 3}\n')
        answer = json.loads(reports.readline())
        assert (answer["op"], answer["token"], answer["error"]) == ("failed", 3, "python_error")
        os.close(control)
        assert child.wait(5) == 0


def test_a_child_ends_in_the_middle_of_a_render(tmp_path: Path) -> None:
    child, control, report = start(tmp_path)
    scene = {"width": 8, "height": 8, "value": 1.0, "chunk_s": 1000.0}
    request = {"op": "render", "token": 1, "film_key": "k", "scene": scene, "replicates": 2,
               "assets": {"root": "", "pins": {}}, "chunks": [0]}  # fmt: skip
    os.write(control, json.dumps(request).encode() + b"\n")
    with os.fdopen(report, "rb") as reports:
        assert json.loads(reports.readline())["op"] == "hello"
        time.sleep(0.5)
        assert child.poll() is None
        os.close(control)
        assert child.wait(5) == 0
        told = [json.loads(line) for line in reports]
        assert [line["op"] for line in told] == ["reading", "reading"], "nothing was done"


def test_a_huge_log_that_a_child_left_is_cut_before_the_next_one_writes(tmp_path: Path) -> None:
    log = tmp_path / "render-1.log"
    with log.open("wb") as file:
        file.truncate(10 * children.LOG_BYTES)  # sparse; too quick for the one who trims
        file.seek(0, os.SEEK_END)
        file.write(b"the last words\n")
    options = children.ChildOptions(
        name="render-1", artifacts=tmp_path, data=tmp_path, logs=tmp_path, work="fake_work",
        threads=1, slots=1,
    )  # fmt: skip
    inbox: queue.SimpleQueue[Any] = queue.SimpleQueue()
    child = children.Child(options, inbox)
    assert inbox.get(timeout=30).body["op"] == "hello"
    child.kill()
    assert child.wait(10)
    kept = sum(path.stat().st_size for path in tmp_path.glob("*.log*"))
    assert kept <= children.LOG_BYTES
    assert log.with_suffix(".log.1").read_text().endswith("the last words\n")
    assert "the last words" not in child.log_tail(), "those were another child's"


def test_a_long_report_survives_stops_of_the_child() -> None:
    """A write that waits for room in the pipe is cut short when the process is stopped."""
    read, write = os.pipe()
    program = (
        "import sys\nfrom matiere.jobs.child import Reports\n"
        "Reports(int(sys.argv[1])).send('done', text='x' * 2**20)\n"
    )
    teller = subprocess.Popen([sys.executable, "-c", program, str(write)], pass_fds=(write,))
    os.close(write)
    with os.fdopen(read, "rb") as reports:
        heard = reports.read(1000)  # it writes now, and fills the pipe
        for _ in range(20):
            teller.send_signal(signal.SIGSTOP)
            time.sleep(0.01)
            teller.send_signal(signal.SIGCONT)
            time.sleep(0.01)
            heard += reports.read(20_000)
        heard += reports.read()
    assert teller.wait(10) == 0
    assert json.loads(heard) == {"op": "done", "text": "x" * 2**20}


def test_a_child_whose_report_cannot_be_read_is_killed(tmp_path: Path) -> None:
    """What it was to do would otherwise wait for ever: it answers its pings."""

    class Garbled(children.Child):
        def _command(self) -> list[str]:
            program = (
                "import os, sys, time\nfd = int(sys.argv[sys.argv.index('--report') + 1])\n"
                'os.write(fd, b\'{"op": "done", "tok{"op": "hello"}\\n\')\ntime.sleep(60)\n'
            )
            return [sys.executable, "-c", program]

    options = children.ChildOptions(
        name="render-1", artifacts=tmp_path, data=tmp_path, logs=tmp_path, work="fake_work",
        threads=1, slots=1,
    )  # fmt: skip
    inbox: queue.SimpleQueue[Any] = queue.SimpleQueue()
    child = Garbled(options, inbox)
    assert inbox.get(timeout=30).body == {"op": "exit", "code": -signal.SIGKILL}
    assert child.exit_class(-signal.SIGKILL) == children.UNREADABLE


def test_exceptions_are_sorted_into_classes() -> None:
    from matiere.errors import ImageError, RenderError
    from matiere.jobs.artifacts import DamagedFile, StorageFault
    from matiere.jobs.child import describe

    def kind(error: BaseException) -> tuple[str, bool]:
        found = describe(error)
        return found["error"], found["permanent"]

    def wrapped() -> BaseException:
        try:
            try:
                raise OSError(28, "No space left on device")
            except OSError as error:
                raise ImageError(f"cannot write: {error.strerror}") from None
        except ImageError as error:
            return error

    assert kind(StorageFault(30, "Read-only file system")) == ("disk_full", False)
    assert kind(wrapped()) == ("disk_full", False)
    assert kind(ImageError("libpng: No space left on device")) == ("disk_full", False)
    assert kind(DamagedFile("gone", "ab")) == ("damaged_file", False)
    assert kind(RenderError("bad")) == ("render_error", True)
    assert kind(MemoryError()) == ("out_of_memory", False)
    assert kind(RuntimeError("x")) == ("python_error", False)
