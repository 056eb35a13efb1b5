"""T4: a death at every step between claim and commit, in children and in the service."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from conftest_jobs import FAKE, SCENE, report_of, wait_until
from crash_points import CHILD_STEPS, SERVICE_STEPS, VARIABLE, arm

from matiere.jobs import Engine, open_engine, scheduler
from matiere.jobs.store.audit import audit, audit_files

FILM = SCENE | {"render": {"spp": 8}}  # 12 tiles x 3 ranges
VALUES = [1.5, 2.5]
AXES = [{"pointer": "/value", "values": VALUES}]


def samples_of(engine: Engine, film: Any, index: int) -> int:
    """Return the samples of a chunk by the stand-in's plan."""
    import fake_work

    c = fake_work.plan(film.width, film.height, film.replicates).chunk(index)
    return (c["x1"] - c["x0"]) * (c["y1"] - c["y0"]) * (c["s1"] - c["s0"])


def audited(engine: Engine) -> list[str]:
    """Return what is wrong with rows and files, once the collector has been round."""
    folder = engine._data.artifacts

    def wrong(c: Any) -> list[str]:
        return audit(c, lambda film, i: samples_of(engine, film, i)) + audit_files(c, folder)

    return engine._db.read(wrong)


@pytest.fixture(scope="module")
def quiet(tmp_path_factory: pytest.TempPathFactory) -> dict[float, str]:
    """Hashes of the samples by value, undisturbed."""
    with pytest.MonkeyPatch.context() as patch:
        here = str(Path(__file__).parent)
        known = os.environ.get("PYTHONPATH")
        patch.setenv("PYTHONPATH", os.pathsep.join([here, *([known] if known else [])]))
        with open_engine(tmp_path_factory.mktemp("quiet"), children=1, **FAKE) as engine:
            values = [*VALUES, *(10.0 + n for n in range(len(CHILD_STEPS)))]
            axes = [{"pointer": "/value", "values": values}]
            sweep = engine.wait_sweep(engine.submit_sweep(FILM, axes).id, 60)
            jobs = engine.list_jobs(sweep_id=sweep.id)
            return {job.parameters["value"]: report_of(engine, job.id)["sums"] for job in jobs}


def test_a_child_may_die_at_every_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, quiet: dict[float, str]
) -> None:
    """Each job loses its renderer, its merger and its developer, at the same step."""
    deaths = tmp_path / "deaths"
    deaths.mkdir()
    monkeypatch.setenv(VARIABLE, str(deaths))
    monkeypatch.setattr(scheduler, "RESTART_WAIT_S", (0.0,))
    with open_engine(tmp_path / "data", children=1, **FAKE) as engine:
        for n, step in enumerate(CHILD_STEPS):
            for role in ("render", "merge", "images"):
                arm(deaths, role, step)
            job = engine.wait_job(engine.submit_job(FILM | {"value": 10.0 + n}).id, 60)
            assert job.state == "succeeded", (step, job.error)
            report = report_of(engine, job.id)
            assert report["sums"] == quiet[10.0 + n], step
            assert (report["min_count"], report["max_count"]) == (8, 8)
            assert list(deaths.iterdir()) == [], "every role came to the step"
            wait_until(lambda: audited(engine) == [], 10)
        assert engine.status()["counters"]["children_lost"] == 3 * len(CHILD_STEPS)


def lives(data: Path, steps: tuple[str, ...], folder: Path) -> int:
    """Run services one after the other, each to its death, until one ends by itself."""
    arm(folder, "service", *steps)
    program = (
        "from matiere.jobs import open_engine\n"
        f"engine = open_engine({str(data)!r}, children=1, **{FAKE!r})\n"
        f"jobs = [engine.submit_job({FILM!r} | {{'value': v}}, idempotency_key=str(v)).id\n"
        f"        for v in {VALUES!r}]\n"
        "assert all(engine.wait_job(job, 60).state == 'succeeded' for job in jobs)\n"
        "engine.close()\n"
    )
    environment = {**os.environ, VARIABLE: str(folder)}
    count = 0
    while (
        subprocess.run([sys.executable, "-c", program], env=environment, timeout=90).returncode
        == 86
    ):
        count += 1
        assert count <= len(steps)
    return count


def died_everywhere(data: Path, steps: tuple[str, ...], quiet: dict[float, str]) -> None:
    """Let the service die at every step; then all is there, once, and the audit is clean."""
    deaths = data.parent / "deaths"
    assert lives(data, steps, deaths) == len(steps)
    assert list(deaths.iterdir()) == []
    with open_engine(data, children=1, **FAKE) as engine:
        jobs = engine.list_jobs()
        assert len(jobs) == len(VALUES), "clients repeat with their keys: none lost, none twice"
        for job in jobs:
            report = report_of(engine, job.id)
            assert (report["min_count"], report["max_count"]) == (8, 8)
        assert {report_of(engine, job.id)["sums"] for job in jobs} == {quiet[v] for v in VALUES}
        wait_until(lambda: audited(engine) == [], 10)


def test_the_service_may_die_around_a_commit(tmp_path: Path, quiet: dict[float, str]) -> None:
    died_everywhere(tmp_path / "data", ("uncommitted_complete", "committed_commit_merge"), quiet)


@pytest.mark.slow
def test_the_service_may_die_at_every_step(tmp_path: Path, quiet: dict[float, str]) -> None:
    died_everywhere(tmp_path / "data", SERVICE_STEPS, quiet)
