"""kill -9 of children and of the service: nothing lost, nothing twice, the same bits."""

from __future__ import annotations

import contextlib
import json
import os
import random
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest
from conftest_jobs import (
    FAKE,
    SCENE,
    Service,
    alive,
    children_of,
    open_engine,
    report_of,
    wait_until,
)

from matiere.jobs import quota
from matiere.jobs.errors import DiskFull
from matiere.jobs.quota import OverQuota

pytestmark = pytest.mark.usefixtures("store")

SLOW = SCENE | {"chunk_s": 0.005, "render": {"spp": 24}}  # 12 tiles x 5 ranges = 60 chunks
CELLS = 24
AXES = [{"pointer": "/value", "linspace": [1, 6, 6]}, {"pointer": "/x", "values": [1, 2, 3, 4]}]
SUBMIT_SWEEP = f"engine.submit_sweep({SLOW!r}, {AXES!r}, idempotency_key='s')"


def hashes(engine: Any) -> dict[int | None, str]:
    """Return the hash of every cell's samples; fail unless each pixel has exactly its spp."""
    found = {}
    for job in engine.list_jobs(sweep_id=engine.list_sweeps()[0].id, limit=1000):
        assert (job.state, job.spp) == ("succeeded", 24), job.error
        report = report_of(engine, job.id)
        assert (report["min_count"], report["max_count"]) == (24, 24)
        found[job.cell] = report["sums"]
    return found


@pytest.fixture(scope="module")
def quiet(tmp_path_factory: pytest.TempPathFactory) -> dict[int | None, str]:
    """Hashes of an undisturbed sweep with one process and one thread."""
    path = tmp_path_factory.mktemp("quiet")
    with pytest.MonkeyPatch.context() as patch:
        here = str(Path(__file__).parent)
        known = os.environ.get("PYTHONPATH")
        patch.setenv("PYTHONPATH", os.pathsep.join([here, *([known] if known else [])]))
        with open_engine(path, children=1, **FAKE) as engine:
            sweep = engine.submit_sweep(SCENE | {"render": {"spp": 24}} | {"chunk_s": 0.0}, AXES)
            assert engine.wait_sweep(sweep.id, 60).counts["succeeded"] == CELLS
            return hashes(engine)


@pytest.mark.slow
@pytest.mark.parametrize(("children", "threads"), [(1, 2), (2, 1)])
def test_the_bits_depend_neither_on_processes_nor_threads(
    quiet: dict[int | None, str], tmp_path: Path, children: int, threads: int
) -> None:
    options = FAKE | {"children": children, "threads_per_child": threads}
    with open_engine(tmp_path, **options) as engine:
        sweep = engine.submit_sweep(SCENE | {"render": {"spp": 24}}, AXES)
        engine.wait_sweep(sweep.id, 60)
        assert hashes(engine) == quiet


@pytest.mark.slow
def test_killed_children_lose_nothing(quiet: dict[int | None, str], tmp_path: Path) -> None:
    chance = random.Random(1)
    with open_engine(tmp_path, children=2, **FAKE) as engine:
        sweep = engine.submit_sweep(SLOW, AXES)
        kills = 0
        while engine.get_sweep(sweep.id).finished is None:
            time.sleep(0.3)
            pids = [c["pid"] for c in engine.status()["children"] if c["pid"]]
            if pids and kills < 8:
                with contextlib.suppress(ProcessLookupError):  # it has just ended
                    os.kill(chance.choice(pids), signal.SIGKILL)
                    kills += 1
        counters = engine.status()["counters"]
        print(f"{kills} kills, counters {counters}")
        assert kills >= 4
        assert hashes(engine) == quiet


def test_a_killed_service_resumes_where_chunks_are_missing(tmp_path: Path) -> None:
    stop = {"spp": 32, "seconds": 6e5}  # by two rules: not a film that one child renders whole
    film = {"width": 80, "height": 64, "render": stop}  # 80 tiles x 6 ranges, 164k samples
    base = SCENE | film | {"chunk_s": 0.004}
    axes = [{"pointer": "/value", "values": [1, 2, 3, 4, 5, 6]}]
    submit = f"engine.submit_sweep({base!r}, {axes!r})"
    service = Service(tmp_path / "killed", submit, children=2, **FAKE)
    orphans = wait_until(lambda: children_of(service.process.pid))
    folder = tmp_path / "killed" / "artifacts"
    wait_until(lambda: len([p for p in folder.glob("??/??/*") if p.is_file()]) >= 4)
    service.kill()
    wait_until(lambda: not any(alive(pid) for pid in orphans), 5.0)
    begin = time.monotonic()
    with open_engine(tmp_path / "killed", children=2, **FAKE) as engine:
        opened = time.monotonic() - begin
        sweep = engine.list_sweeps()[0]
        before = engine.list_jobs(sweep_id=sweep.id)
        assert not all(job.state.final for job in before), "killed too late to show anything"
        untouched = sum(1 for job in before if job.progress == 0.0)
        sweep = engine.wait_sweep(sweep.id, 60)
        assert sweep.counts["succeeded"] == 6
        rendered = engine.status()["counters"]["chunks_rendered"]
        missing = engine.resumed["chunks_missing"] + 480 * untouched
        print(f"opened in {opened:.2f} s, found {engine.resumed}")
        print(f"chunks missing {missing}, rendered {rendered}")
        assert rendered == missing < 480 * 6
        assert engine.resumed["chunks_voided"] > 0
        after = [report_of(engine, job.id)["sums"] for job in engine.list_jobs(sweep_id=sweep.id)]
    with open_engine(tmp_path / "quiet", children=1, **FAKE) as engine:
        sweep = engine.submit_sweep(SCENE | film, axes)
        engine.wait_sweep(sweep.id, 60)
        jobs = engine.list_jobs(sweep_id=sweep.id)
        assert after == [report_of(engine, job.id)["sums"] for job in jobs]


@pytest.mark.slow
def test_a_service_killed_again_and_again_ends_with_the_same_bits(
    quiet: dict[int | None, str], tmp_path: Path
) -> None:
    for kill in range(4):
        service = Service(tmp_path, SUBMIT_SWEEP, children=2, **FAKE)
        time.sleep(0.5 + 0.13 * kill)
        service.kill()
    with open_engine(tmp_path, children=2, **FAKE) as engine:
        assert len(engine.list_sweeps()) == 1, "the client repeats with its Idempotency-Key"
        engine.wait_sweep(engine.list_sweeps()[0].id, 60)
        assert hashes(engine) == quiet
        folder = engine.data_dir / "artifacts"
        kinds = engine.storage.usage()["artifacts"]
        assert kinds["chunks"]["files"] == 0
        known = sum(kind["files"] for kind in kinds.values())
        wait_until(lambda: len([p for p in folder.rglob("*") if p.is_file()]) <= known)


def busy_child(engine: Any) -> Any:
    """Return a child that holds a claim."""
    return next((c for c in engine.status()["children"] if c["claims"]), None)


def test_a_stopped_child_is_replaced_and_its_late_report_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from matiere.jobs import children

    monkeypatch.setattr(children, "PING_S", 0.2)
    monkeypatch.setattr(children, "LEASE_S", 1.0)
    with open_engine(tmp_path, children=1, **FAKE) as engine:
        job = engine.submit_job(SLOW | {"value": 7.0})
        child = wait_until(lambda: busy_child(engine))
        os.kill(child["pid"], signal.SIGSTOP)
        job = engine.wait_job(job.id, 30)
        assert job.state == "succeeded"
        assert not alive(child["pid"]), "killed and reaped before its work was handed out again"
        assert report_of(engine, job.id)["max_count"] == 24


def test_children_end_when_the_service_is_killed(tmp_path: Path) -> None:
    endless = SCENE | {"chunk_s": 1000.0}
    service = Service(tmp_path, f"engine.submit_job({endless!r})", children=2, **FAKE)
    pids = wait_until(lambda: len(children_of(service.process.pid)) == 3) and children_of(
        service.process.pid
    )
    service.kill()
    wait_until(lambda: not any(alive(pid) for pid in pids), 5.0)


def test_a_second_process_is_refused_while_the_first_lives(tmp_path: Path) -> None:
    service = Service(tmp_path, "engine.announce('http://127.0.0.1:1')", children=1, **FAKE)
    from matiere.jobs.errors import DataDirLocked

    with pytest.raises(DataDirLocked, match=str(service.process.pid)):
        open_engine(tmp_path, **FAKE)
    service.kill()
    open_engine(tmp_path, children=1, **FAKE).close()


# -- disk full ----------------------------------------------------------------------------------
@pytest.fixture
def small_disk(tmp_path: Path) -> Any:
    """Mount a tmpfs of 3 MiB, or skip."""
    folder = tmp_path / "small"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=3m", "none", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("mounting a tmpfs needs root")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def test_a_full_disk_delays_jobs_and_loses_none(
    small_disk: Path, store: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_engine(small_disk / "data", children=2, **FAKE) as engine:
        done = engine.wait_job(engine.submit_job(SCENE).id, 120)
        job = engine.submit_job(SLOW | {"value": 8.0, "width": 64, "height": 64})
        ballast = small_disk / "ballast"
        fill(ballast)
        time.sleep(3.0)
        readiness, state = engine.readiness(), engine.get_job(job.id).state
        print(f"full: {state}, {json.dumps({k: c.detail for k, c in readiness.checks.items()})}")
        assert not state.final
        assert not readiness.ready
        assert engine.get_job(done.id).state == "succeeded", "reads go on"
        with pytest.raises(OverQuota, match="free space"):
            engine.submit_job(SCENE | {"value": 99.0})
        if store == "sqlite":  # PostgreSQL keeps its data elsewhere
            with monkeypatch.context() as patch, pytest.raises(DiskFull, match="free space"):
                patch.setattr(quota, "check_disk", lambda *_: None)  # as if it fitted
                for i in range(1000):
                    engine.submit_job(SCENE | {"value": 100.0 + i, "note": "x" * 5000}, priority=0)
        accepted = len(engine.list_jobs(limit=2000))
        ballast.unlink()
        job = engine.wait_job(job.id, 120)
        assert job.state == "succeeded"
        assert report_of(engine, job.id)["min_count"] == 24
        wait_until(lambda: engine.readiness().ready)
        print(f"{accepted} jobs were accepted before the database was full")
        for job in engine.list_jobs(limit=2000):
            engine.cancel_job(job.id)
        assert len(engine.list_jobs(limit=2000)) == accepted, "refused ones left nothing"
        assert (
            engine.wait_job(engine.submit_job(SCENE | {"value": 9.0}).id, 120).state == "succeeded"
        )


def fill(path: Path) -> None:
    """Write until the disk is full."""
    with path.open("wb", buffering=0) as file:
        try:
            while True:
                file.write(b"x" * 4096)
        except OSError:
            return


def test_a_low_disk_holds_work_back_until_there_is_space(tmp_path: Path) -> None:
    with open_engine(tmp_path, children=1, work="fake_work", min_free_bytes=2**60) as engine:
        wait_until(lambda: engine.status()["disk_low"])
        job = engine.submit_job(SCENE)
        time.sleep(0.5)
        assert engine.get_job(job.id).state == "queued"
        assert "disk_low" in engine.readiness().checks["disk"].detail
        object.__setattr__(engine._scheduler.options, "min_free_bytes", 0)
        assert engine.wait_job(job.id, 30).state == "succeeded"
