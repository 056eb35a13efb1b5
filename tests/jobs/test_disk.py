"""Disks that fill up or turn read-only, clocks that jump: nothing is lost, the state is clear."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from conftest_jobs import FAKE, SCENE, open_engine, report_of, wait_until

from matiere.errors import SceneValidationError
from matiere.jobs import Engine, children, quota
from matiere.jobs.rules import Rules

pytestmark = pytest.mark.usefixtures("store")
SLOW = SCENE | {"chunk_s": 0.02, "render": {"spp": 24}}  # 60 chunks


@pytest.fixture
def mounted(tmp_path: Path) -> Iterator[Path]:
    """Mount a file system of its own for the artifacts, or skip."""
    folder = tmp_path / "data" / "artifacts"
    folder.mkdir(parents=True)
    mount = ["mount", "-t", "tmpfs", "-o", "size=16m,mode=700", "none", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("mounting a file system needs root")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def remount(folder: Path, how: str) -> None:
    """Remount `ro` or `rw`; a file that is open for writing delays it."""
    command = ["mount", "-o", f"remount,{how}", str(folder)]
    wait_until(lambda: subprocess.run(command, capture_output=True).returncode == 0)


def quiet_sums(path: Path, scene: dict[str, Any]) -> Any:
    with open_engine(path, children=1, **FAKE) as engine:
        job = engine.wait_job(engine.submit_job(scene).id, 30)
        return report_of(engine, job.id)["sums"]


def test_a_read_only_disk_delays_jobs_and_loses_none(mounted: Path, tmp_path: Path) -> None:
    with open_engine(tmp_path / "data", children=2, **FAKE) as engine:
        done = engine.wait_job(engine.submit_job(SCENE).id, 30)
        job = engine.submit_job(SLOW)
        wait_until(lambda: engine.get_job(job.id).progress > 0)
        remount(mounted, "ro")
        wait_until(lambda: engine.status()["disk_full"])
        checks = engine.readiness().checks
        assert not checks["artifacts"].ok and "ead-only" in checks["artifacts"].detail
        assert not engine.get_job(job.id).state.final
        assert Path(engine.artifact(done.id, "image.png").path).read_bytes(), "reads go on"
        later = engine.submit_job(SCENE | {"value": 5.0})
        assert later.state == "queued", "accepted: the database is on another disk"
        remount(mounted, "rw")
        job, later = (engine.wait_job(j.id, 60) for j in (job, later))
        assert (job.state, later.state) == ("succeeded", "succeeded"), (job.error, later.error)
        report = report_of(engine, job.id)
        assert (report["min_count"], report["max_count"]) == (24, 24)
        wait_until(lambda: engine.readiness().ready)
    assert quiet_sums(tmp_path / "quiet", SLOW) == report["sums"]


@pytest.mark.parametrize("step", [3600.0, -3600.0])
def test_a_clock_that_jumps_costs_no_lease(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: float
) -> None:
    real = time.time
    monkeypatch.setattr(children, "PING_S", 0.1)
    monkeypatch.setattr(children, "LEASE_S", 5.0)  # far less than the jump
    with open_engine(tmp_path / "data", children=2, **FAKE) as engine:
        job = engine.submit_job(SLOW)
        wait_until(lambda: engine.get_job(job.id).progress > 0)
        monkeypatch.setattr(time, "time", lambda: real() + step)
        job = engine.wait_job(job.id, 30)
        counters = engine.status()["counters"]
        assert (job.state, job.spp) == ("succeeded", 24)
        assert counters.get("children_lost", 0) == 0, "no lease ended"
        assert counters.get("reports_superseded", 0) == 0
        assert counters["chunks_rendered"] == 60, "nothing was rendered twice"
        seen = [event.seq for event in engine.events(0, job_id=job.id)]
        assert seen == sorted(set(seen)), "events go by number, not by time"
        later = engine.submit_job(SCENE)
        assert engine.wait_job(later.id, 30).state == "succeeded"
        assert engine.list_jobs()[0].id in (later.id, job.id)


def test_a_low_disk_is_told_everywhere_and_ends_by_itself(engine: Engine) -> None:
    wait_until(lambda: engine.readiness().ready)
    engine._scheduler.options = options = limited(engine, 2**60)
    wait_until(lambda: engine.status()["disk_low"])
    job = engine.submit_job(SCENE)
    time.sleep(0.5)
    assert engine.get_job(job.id).state == "queued"
    readiness = engine.readiness()
    assert not readiness.ready and "disk_low" in readiness.checks["disk"].detail
    assert options.min_free_bytes == 2**60
    engine._scheduler.options = limited(engine, 0)
    assert engine.wait_job(job.id, 30).state == "succeeded"
    wait_until(lambda: engine.readiness().ready)


def limited(engine: Engine, free: int) -> Any:
    return replace(engine._scheduler.options, min_free_bytes=free)


def test_a_low_disk_lets_idle_films_go(tmp_path: Path) -> None:
    """The limit is half of what is free or held; with nothing allowed all idle films go."""
    rules = Rules(film_bytes=0)
    with open_engine(tmp_path / "data", children=1, rules=rules, **FAKE) as engine:
        engine.wait_job(engine.submit_job(SCENE).id, 30)
        engine.storage._clock = lambda: time.time() + 120  # nobody used it for two minutes
        engine._scheduler.options = limited(engine, 2**60)
        wait_until(lambda: engine.storage.usage()["artifacts"]["films"]["files"] == 0)


def test_what_never_fits_is_refused_and_what_does_not_fit_now_too(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert quota.disk_need([(32, 24, 2), (8, 8, 2)]) == (
        3 * 32 * 24 * 2 * 56 + (32 * 24 + 64) * 40 + 40_000
    )
    monkeypatch.setattr(quota, "BYTES_PER_SAMPLE_SUM", 2**50)
    with pytest.raises(SceneValidationError, match="on the disk at once") as caught:
        engine.submit_job(SCENE)
    assert [(f.pointer, f.code) for f in caught.value.faults] == [("/film", "disk_limit")]
    free = quota.shutil.disk_usage(engine.data_dir)
    monkeypatch.setattr(
        quota, "BYTES_PER_SAMPLE_SUM", (free.free + free.total) // 2 // (32 * 24 * 6)
    )
    with pytest.raises(quota.OverQuota, match="are free") as late:
        engine.submit_sweep(SCENE, [{"pointer": "/value", "values": [1, 2]}])
    assert late.value.code == "over_quota"
    assert engine.list_jobs() == [] and engine.list_sweeps() == []
