"""Leases, fences, limits, and the classes of what goes wrong (T2 and T5 of the acceptance)."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from conftest_jobs import FAKE, SCENE, alive, report_of, wait_until

from matiere.jobs import Engine, children, open_engine, procfs, scheduler
from matiere.jobs.children import Child, exit_class
from matiere.jobs.job import Job
from matiere.jobs.scheduler import MAX_LOSSES, MAX_TRIES
from matiere.jobs.store import tables
from matiere.jobs.store.audit import audit

SLOW = SCENE | {"chunk_s": 0.02, "value": 7.0, "render": {"spp": 24}}
MIB = 2**20


def busy_child(engine: Any) -> Any:
    """Return a render child that holds a claim."""
    return next((c for c in engine.status()["children"] if c["claims"]), None)


def attempts(engine: Engine) -> list[Any]:
    """Return (state, class) of every attempt, oldest first."""
    table = tables.attempt.c
    rows = sa.select(table.state, table.error_class).order_by(table.id)
    return engine._db.read(lambda c: [tuple(row) for row in c.execute(rows)])


def superseded(engine: Engine) -> int:
    """Return the superseded reports that the films count."""
    total = sa.select(sa.func.sum(tables.film.c.reports_superseded))
    return int(engine._db.read(lambda c: c.scalar(total)) or 0)


@pytest.fixture
def short_lease(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a lease run out within three seconds."""
    monkeypatch.setattr(children, "PING_S", 0.2)
    monkeypatch.setattr(children, "LEASE_S", 3.0)


@pytest.fixture(scope="module")
def quiet_sums(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Hash of the samples of SLOW, undisturbed."""
    with pytest.MonkeyPatch.context() as patch:
        here = str(Path(__file__).parent)
        known = os.environ.get("PYTHONPATH")
        patch.setenv("PYTHONPATH", os.pathsep.join([here, *([known] if known else [])]))
        with open_engine(tmp_path_factory.mktemp("quiet"), children=1, **FAKE) as engine:
            job = engine.wait_job(engine.submit_job(SLOW | {"chunk_s": 0.0}).id, 60)
            return str(report_of(engine, job.id)["sums"])


# -- T2: leases and fences ----------------------------------------------------------------------
@pytest.mark.usefixtures("short_lease")
def test_a_stopped_child_that_escapes_the_kill_is_fenced_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, quiet_sums: str
) -> None:
    """SIGSTOP past the lease, and a kill that does not arrive: another finishes; then SIGCONT."""
    escaped: list[Child] = []

    def lost_kill(child: Child, *args: Any, **more: Any) -> None:
        child.killed, child.killed_at = True, time.monotonic()
        escaped.append(child)

    monkeypatch.setattr(children, "REAP_S", 0.3)
    with open_engine(tmp_path, children=1, **FAKE) as engine:
        job = engine.submit_job(SLOW)
        stopped = wait_until(lambda: busy_child(engine))["pid"]
        os.kill(stopped, signal.SIGSTOP)
        with monkeypatch.context() as patch:
            patch.setattr(Child, "kill", lost_kill)
            wait_until(lambda: escaped and not escaped[0].alive, 30)
        job = engine.wait_job(job.id, 60)
        assert (job.state, report_of(engine, job.id)["sums"]) == ("succeeded", quiet_sums)
        assert alive(stopped), "it has escaped"
        before = engine.status()["counters"]
        assert before["chunks_rendered"] == 12 * 5, "every chunk was committed exactly once"
        os.kill(stopped, signal.SIGCONT)
        wait_until(lambda: superseded(engine) == 1, 30)
        after = engine.status()["counters"]
        assert after["reports_superseded"] == 1
        assert after["chunks_rendered"] == before["chunks_rendered"]
        assert report_of(engine, job.id)["sums"] == quiet_sums
        assert engine._db.read(audit) == []
        escaped[0].close()
        wait_until(lambda: not alive(stopped))


@pytest.mark.usefixtures("short_lease")
def test_only_the_control_thread_renews_the_lease(tmp_path: Path) -> None:
    """A loop in C that holds the interpreter is killed, and stops after three attempts."""
    with open_engine(tmp_path, children=1, **FAKE) as engine:
        job = engine.submit_job(SCENE | {"misdeed": {"kind": "deaf"}})
        job = engine.wait_job(job.id, 90)
        assert job.error is not None
        assert (job.state, job.error.code) == ("failed", "unresponsive"), job.error
        assert engine.status()["counters"]["children_lost"] >= MAX_TRIES


def test_the_lease_does_not_follow_the_clock_of_the_wall(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An hour forth and an hour back: nobody is killed, nothing is rendered twice."""
    real = time.time
    with open_engine(tmp_path, children=1, **FAKE) as engine:
        job = engine.submit_job(SLOW)
        wait_until(lambda: busy_child(engine))
        for step in (3600.0, -3600.0):
            monkeypatch.setattr(time, "time", lambda step=step: real() + step)
            time.sleep(0.5)
        job = engine.wait_job(job.id, 60)
        assert job.state == "succeeded"
        assert engine.status()["counters"]["chunks_rendered"] == 12 * 5
        assert "children_lost" not in engine.status()["counters"]


# -- classes ------------------------------------------------------------------------------------
def test_how_a_child_ended_is_classed() -> None:
    kill = -signal.SIGKILL
    assert exit_class(kill)[0] == "lost"
    assert exit_class(kill, None, True)[0] == "out_of_memory", "the kernel was short of memory"
    assert exit_class(kill, ("memory_limit", "too large"), True) == ("memory_limit", "too large")
    assert exit_class(-signal.SIGTERM)[0] == exit_class(None)[0] == "lost"
    assert exit_class(-signal.SIGSEGV) == ("signal", "crashed with SIGSEGV")
    assert exit_class(-signal.SIGABRT) == ("signal", "crashed with SIGABRT")
    assert exit_class(1)[0] == "python_error"


def test_proc_tells_memory_and_state() -> None:
    size = procfs.rss_bytes(os.getpid())
    ballast = b"x" * (64 * MIB)
    assert procfs.rss_bytes(os.getpid()) - size > 32 * MIB, len(ballast)
    assert (
        2**28 < procfs.usable_memory() <= os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    )
    assert procfs.state_and_cpu(os.getpid())[0] in "RS"
    assert procfs.rss_bytes(2**22 + 1) == 0
    assert procfs.state_and_cpu(2**22 + 1) == ("", 0.0)
    assert procfs.oom_kills() >= 0


def test_what_is_killed_from_outside_is_tried_more_often_but_not_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert (MAX_TRIES, MAX_LOSSES) == (3, 20), "as the documents say"
    monkeypatch.setattr(scheduler, "MAX_LOSSES", 5)
    monkeypatch.setattr(scheduler, "RESTART_WAIT_S", (0.0,))
    with open_engine(tmp_path, children=1, **FAKE) as engine:
        job = engine.submit_job(SCENE | {"misdeed": {"kind": "SIGKILL", "chunk": 3}})
        job = engine.wait_job(job.id, 120)
        assert job.error is not None
        assert (job.state, job.error.code) == ("failed", "lost")
        assert "5 attempts" in job.error.message
        assert attempts(engine).count(("lost", "lost")) == 5


@pytest.mark.slow
def test_native_faults_among_good_jobs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """T5: each bad job stops after three attempts with its class; the good ones succeed."""
    wanted = {
        "SIGSEGV": "signal",
        "SIGABRT": "signal",
        "raise": "python_error",
        "spin": "time_limit",
        "hog": "out_of_memory",
    }
    limits = {"child_memory_bytes": 512 * MIB, "claim_limit_s": 10.0}
    monkeypatch.setattr(scheduler, "RESTART_WAIT_S", (0.0,))
    with open_engine(tmp_path, children=2, **FAKE, **limits) as engine:
        good = [engine.submit_job(SCENE | {"value": 100.0 + i}) for i in range(40)]
        bad = {
            kind: engine.submit_job(SCENE | {"misdeed": {"kind": kind, "chunk": 2}})
            for kind in wanted
        }
        chatty = engine.submit_job(SCENE | {"misdeed": {"kind": "chatter", "chunk": 5}})
        slowest, logs = _watch(engine, [*good, *bad.values(), chatty])
        for kind, code in wanted.items():
            job = engine.get_job(bad[kind].id)
            assert job.error is not None, kind
            assert (job.state, job.error.code) == ("failed", code), (kind, job.error)
            assert f"{MAX_TRIES} attempts" in job.error.message
        assert all(engine.get_job(job.id).state == "succeeded" for job in good)
        assert engine.get_job(chatty.id).state == "succeeded"
        kinds = [kind for state, kind in attempts(engine) if state == "failed"]
        print(f"attempts that failed: {sorted(kinds)}; largest log {logs / MIB:.0f} MiB")
        print(f"slowest read of {slowest[1]}: {slowest[0] * 1000:.0f} ms")
        assert sorted(kinds) == sorted(3 * list(wanted.values()))
        left = sum(p.stat().st_size for p in (engine.data_dir / "logs").glob("*"))
        assert left < 100 * MIB, "a gigabyte of log is cut while it is written"


def _watch(engine: Engine, jobs: list[Job]) -> tuple[tuple[float, int], int]:
    """Wait for jobs; return the slowest of many reads, how many these were, and the largest log."""
    slowest, reads, logs = 0.0, 0, 0
    end = time.monotonic() + 200
    left = {job.id for job in jobs}
    while left:
        assert time.monotonic() < end, left
        for job_id in list(left):
            begin = time.monotonic()
            if engine.get_job(job_id).state.final:
                left.discard(job_id)
            slowest, reads = max(slowest, time.monotonic() - begin), reads + 1
        sizes = [path.stat().st_size for path in (engine.data_dir / "logs").glob("*")]
        logs = max(logs, *sizes)
        time.sleep(0.05)
    return (slowest, reads), logs


def test_a_child_that_grows_too_large_is_killed_as_memory_limit(tmp_path: Path) -> None:
    """What RLIMIT_DATA does not count (shared memory, files) the watchdog sees."""
    with open_engine(tmp_path, children=1, **FAKE) as engine:
        wait_until(lambda: engine.readiness().ready)
        limit = max(procfs.rss_bytes(c["pid"]) for c in engine.status()["children"]) // 2
        object.__setattr__(engine._scheduler.options, "child_memory_bytes", limit)
        wait_until(lambda: engine.status()["counters"].get("children_lost", 0) >= 1)
        object.__setattr__(engine._scheduler.options, "child_memory_bytes", 0)
        job = engine.wait_job(engine.submit_job(SCENE).id, 60)
        assert job.state == "succeeded"
        log = [c.cause for c in _children(engine) if c.cause]
        assert all(cause[0] == "memory_limit" for cause in log)


def _children(engine: Engine) -> list[Child]:
    return [slot.child for slot in engine._scheduler.slots if slot.child is not None]


def at_work(engine: Engine) -> str:
    """Return the phase of the oldest claim of the first busy child."""
    held = (held for child in _children(engine) for held in list(child.inflight.values())[:1])
    return next((h.phase for h in held), "")


# -- cancel -------------------------------------------------------------------------------------
@pytest.mark.parametrize("phase", ["chunk_s", "build_s", "read_s"])
def test_a_cancel_is_obeyed_in_every_phase(tmp_path: Path, phase: str) -> None:
    """While it renders or builds the flag stops it; while it reads files the child is killed."""
    with open_engine(tmp_path, children=1, **FAKE) as engine:
        wait_until(lambda: engine.readiness().ready)
        cancel_three_times(engine, phase)


def cancel_three_times(engine: Engine, phase: str) -> None:
    """Cancel jobs in a phase and see that it is obeyed, and nobody blamed."""
    spent = []
    for n in range(3):
        job = engine.submit_job(SCENE | {phase: 30.0, "value": 50.0 + n})
        child = wait_until(lambda: busy_child(engine))
        wait_until(lambda: at_work(engine) == ("reading" if phase == "read_s" else "working"))
        begin = time.monotonic()
        engine.cancel_job(job.id)
        if phase == "read_s":
            wait_until(lambda pid=child["pid"]: not alive(pid))
        wait_until(lambda: not busy_child(engine))
        spent.append(time.monotonic() - begin)
    print(f"{phase}: cancelled in {[f'{1000 * s:.0f} ms' for s in spent]}")
    lost = engine.status()["counters"].get("children_lost", 0)
    assert lost == (len(spent) if phase == "read_s" else 0)
    assert min(spent) < 0.9, "within the flag's time, before SIGTERM"
    other = engine.wait_job(engine.submit_job(SCENE | {"value": 60.0}).id, 60)
    assert other.state == "succeeded"
    assert not [kind for state, kind in attempts(engine) if state in ("failed", "lost")]
