"""Small cells of sweeps: made jobs of as it goes, rendered whole, many to a file."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from conftest_jobs import FAKE, Service, children_of, wait_until

from matiere.jobs import Engine, Sweep, open_engine
from matiere.jobs.errors import JobsError
from matiere.jobs.job import JobState
from matiere.jobs.store.tables import film, reference
from matiere.jobs.submission import FIRST_CELLS

SMALL: dict[str, Any] = {"width": 8, "height": 8, "value": 1.0, "render": {"spp": 16}}
MANY = FIRST_CELLS + 300


def axes(count: int, first: float = 1.0) -> list[dict[str, Any]]:
    return [{"pointer": "/value", "linspace": [first, first + count - 1, count], "label": "v"}]


def swept(engine: Engine, count: int, base: dict[str, Any] = SMALL, **more: Any) -> Sweep:
    sweep = engine.submit_sweep(base, axes(count), **more)
    return engine.wait_sweep(sweep.id, 60)


def images(engine: Engine, sweep: Sweep) -> dict[int | None, bytes]:
    jobs = engine.list_jobs(sweep_id=sweep.id, limit=sweep.cells)
    kind = "image.exr"
    return {job.cell: Path(engine.artifact(job.id, kind).path).read_bytes() for job in jobs}


def films_on_disk(engine: Engine) -> int:
    wanted = (reference.c.owner == "film") & (reference.c.kind == "prefix")
    found = sa.select(sa.func.count(sa.distinct(reference.c.digest))).where(wanted)
    return engine._db.read(lambda c: c.execute(found).scalar_one())


@pytest.fixture
def quiet(tmp_path: Path) -> Iterator[Engine]:
    with open_engine(tmp_path / "quiet", children=2, **FAKE) as opened:
        yield opened


def test_every_cell_of_a_large_sweep_becomes_a_job_and_ends(engine: Engine) -> None:
    sweep = engine.submit_sweep(SMALL, axes(MANY))
    assert sum(sweep.counts.values()) == sweep.cells == MANY
    assert len(engine.list_jobs(sweep_id=sweep.id, limit=MANY)) < MANY, "expanded as it goes"
    done = engine.wait_sweep(sweep.id, 60)
    assert done.counts["succeeded"] == MANY
    jobs = engine.list_jobs(sweep_id=sweep.id, limit=MANY)
    assert [job.cell for job in jobs] == list(range(MANY))
    assert [job.parameters["v"] for job in jobs] == list(range(1, MANY + 1))
    assert all(job.spp == 16 and job.relmse == 1 / 16 and not job.cached for job in jobs)
    assert films_on_disk(engine) < MANY / 4, "many films to a file"
    assert done.finished and "contact-sheet.png" not in done.artifacts, "too many for one sheet"


def test_pixels_are_those_of_a_job_of_its_own(engine: Engine, quiet: Engine) -> None:
    sweep = swept(engine, 12)
    for cell, pixels in images(engine, sweep).items():
        assert cell is not None
        alone = quiet.wait_job(quiet.submit_job(SMALL | {"value": 1.0 + cell}).id, 20)
        assert Path(quiet.artifact(alone.id, "image.exr").path).read_bytes() == pixels


def test_the_same_sweep_again_renders_nothing(engine: Engine) -> None:
    first = swept(engine, MANY)
    rendered = engine.status()["counters"]["chunks_rendered"]
    again = swept(engine, MANY)
    assert again.counts["succeeded"] == MANY
    assert engine.status()["counters"]["chunks_rendered"] == rendered
    jobs = engine.list_jobs(sweep_id=again.id, limit=MANY)
    assert all(job.cached for job in jobs)
    assert engine.artifact(jobs[5].id, "image.png").digest == (
        engine.artifact(engine.list_jobs(sweep_id=first.id, limit=6)[5].id, "image.png").digest
    )


def test_a_finer_sweep_goes_on_with_the_stored_films(engine: Engine, quiet: Engine) -> None:
    swept(engine, 20)
    before = engine.status()["counters"]["chunks_rendered"]
    finer = swept(engine, 20, stop={"spp": 32})
    more = engine.status()["counters"]["chunks_rendered"] - before
    alone = swept(quiet, 20, stop={"spp": 32})
    assert 0 < more < quiet.status()["counters"]["chunks_rendered"]
    assert images(engine, finer) == images(quiet, alone)


def test_a_job_beside_the_sweep_takes_the_film_over(engine: Engine) -> None:
    sweep = swept(engine, 3)
    job = engine.submit_job(SMALL | {"value": 2.0}, stop={"target_error": {"relmse": 0.02}})
    done = engine.wait_job(job.id, 20)
    assert done.state is JobState.SUCCEEDED and done.spp > 16
    cell = engine.list_jobs(sweep_id=sweep.id)[1]
    report = json.loads(Path(engine.artifact(cell.id, "report.json").path).read_text())
    assert report["spp"] == cell.spp == 16, "the cell keeps the film it ended with"


def test_killed_children_and_services_change_no_pixel(tmp_path: Path, quiet: Engine) -> None:
    base = SMALL | {"chunk_s": 0.003}
    expected = images(quiet, swept(quiet, 300, SMALL))
    data = tmp_path / "killed"
    service = Service(data, f"engine.submit_sweep({base!r}, {axes(300)!r})", children=2, **FAKE)
    for _ in range(3):
        time.sleep(0.4)
        for pid in children_of(service.process.pid)[:1]:
            os.kill(pid, signal.SIGKILL)
    service.kill()
    with open_engine(data, children=2, **FAKE) as engine:
        [sweep] = engine.list_sweeps()
        done = engine.wait_sweep(sweep.id, 60)
        assert done.counts["succeeded"] == 300
        assert images(engine, done) == expected
        held = sa.select(sa.func.count(film.c.claim_token))
        assert engine._db.read(lambda c: c.scalar(held)) == 0


@pytest.mark.parametrize("kind", ["SIGSEGV", "raise"])
def test_a_cell_that_kills_its_child_fails_alone(engine: Engine, kind: str) -> None:
    language = {"overrides": [{"when": "v == 7", "set": {"/misdeed": {"kind": kind}}}]}
    sweep = engine.submit_sweep(SMALL, axes(20), **language)
    done = engine.wait_sweep(sweep.id, 60)
    assert done.counts["succeeded"] == 19 and done.counts["failed"] == 1
    [bad] = [j for j in engine.list_jobs(sweep_id=sweep.id) if j.state is JobState.FAILED]
    assert bad.parameters["v"] == 7 and bad.error is not None
    assert bad.error.code == ("signal" if kind == "SIGSEGV" else "python_error")
    assert "3 attempts" in bad.error.message


def test_a_bad_cell_found_late_is_a_failed_job_that_points_at_its_value(engine: Engine) -> None:
    values = [1.0] * 5000
    values[4321] = -1.0
    many = [{"pointer": "/value", "values": values, "label": "v"},
            {"pointer": "/geometry", "values": ["a"], "label": "g"}]  # fmt: skip
    sweep = engine.submit_sweep(SMALL, many, mode="grid")
    done = engine.wait_sweep(sweep.id, 90)
    assert done.counts["succeeded"] == 4999 and done.counts["failed"] == 1
    [bad] = engine.list_jobs(sweep_id=sweep.id, state=JobState.FAILED)
    assert bad.cell == 4321 and bad.error is not None
    assert bad.error.pointer == "/axes/0/values/4321"


def test_a_cancelled_sweep_makes_no_more_jobs(engine: Engine) -> None:
    sweep = engine.submit_sweep(SMALL | {"chunk_s": 0.05}, axes(5000))
    wait_until(lambda: engine.get_sweep(sweep.id).counts["running"])
    start = time.monotonic()
    cancelled = engine.cancel_sweep(sweep.id)
    assert time.monotonic() - start < 5
    assert cancelled.counts["queued"] == 0
    done = engine.wait_sweep(sweep.id, 20)
    assert done.finished and done.counts["cancelled"] > 4000
    assert sum(done.counts.values()) == 5000


def test_a_paused_sweep_makes_no_more_jobs_until_it_is_resumed(engine: Engine) -> None:
    sweep = engine.submit_sweep(SMALL, axes(3000))
    wait_until(lambda: engine.get_sweep(sweep.id).counts["succeeded"])
    engine.pause_sweep(sweep.id)
    wait_until(lambda: not any(c["claims"] for c in engine.status()["children"]))
    time.sleep(0.5)
    wait_until(lambda: not any(c["claims"] for c in engine.status()["children"]))
    before = engine.get_sweep(sweep.id).counts
    time.sleep(0.5)
    assert engine.get_sweep(sweep.id).counts == before
    engine.resume_sweep(sweep.id)
    assert engine.wait_sweep(sweep.id, 60).counts["succeeded"] == 3000


def test_a_damaged_file_is_never_shown_and_rendered_anew_when_asked_again(
    engine: Engine, quiet: Engine
) -> None:
    good = images(quiet, swept(quiet, 5))
    sweep = swept(engine, 5)  # no images yet
    job = engine.list_jobs(sweep_id=sweep.id)[2]
    find = sa.select(reference.c.digest).where(
        reference.c.owner == "job", reference.c.owner_id == job.id, reference.c.kind == "film"
    )
    digest = engine._db.read(lambda c: c.execute(find).scalar_one())
    path = engine._data.artifacts.path(digest)
    path.write_bytes(path.read_bytes()[:-8] + bytes(8))
    with pytest.raises(JobsError) as caught:
        engine.artifact(job.id, "image.png")
    assert caught.value.code == "damaged_file"
    anew = swept(engine, 5)
    assert images(engine, anew) == good


def test_a_sweep_with_a_dependency_waits_and_then_expands(engine: Engine) -> None:
    first = engine.submit_job(SMALL | {"chunk_s": 0.2, "width": 32})
    sweep = engine.submit_sweep(SMALL, axes(400), after=[first.id])
    time.sleep(0.3)
    assert engine.get_sweep(sweep.id).counts["queued"] == 400
    assert engine.wait_sweep(sweep.id, 60).counts["succeeded"] == 400


def test_what_a_broken_dependency_cancels_makes_no_jobs_later(engine: Engine) -> None:
    first = engine.submit_job(SMALL | {"misdeed": {"kind": "raise"}, "width": 32})
    sweep = engine.submit_sweep(SMALL, axes(400), after=[first.id])
    done = engine.wait_sweep(sweep.id, 60)
    assert done.counts["cancelled"] == 400
