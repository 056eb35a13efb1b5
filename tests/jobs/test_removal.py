"""Deleting jobs and sweeps: all of it goes, nothing of others does, whatever is going on."""

from __future__ import annotations

import itertools
import time
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from conftest_jobs import FAKE, SCENE, open_engine, report_of, wait_until

from matiere.errors import SceneValidationError
from matiere.jobs import Engine
from matiere.jobs.errors import DeletionRefused, JobNotFound
from matiere.jobs.rules import Rules
from matiere.jobs.storage import open_storage
from matiere.jobs.store import dependencies, files, jobs, removal, tables, views
from matiere.jobs.store.audit import audit, audit_files

LONG = SCENE | {"chunk_s": 0.05, "render": {"spp": 4096}}
SMALL: dict[str, Any] = {"width": 8, "height": 8, "value": 1.0, "render": {"spp": 16}}
AXES = [{"pointer": "/value", "linspace": [1, 24, 24], "label": "v"}]


def on_disk(engine: Engine) -> list[str]:
    """Return the artifacts that lie on the disk."""
    folder = engine.data_dir / "artifacts"
    return sorted(path.name for path in folder.glob("??/??/*") if path.is_file())


def count(engine: Engine, table: Any) -> int:
    rows = sa.select(sa.func.count()).select_from(table)
    return engine._db.read(lambda c: c.scalar(rows) or 0)


def gone(engine: Engine) -> bool:
    """Tell whether no file is left, and of the rows only what keeps numbers from coming again."""
    rows = [tables.job, tables.sweep, tables.chunk, tables.reference, tables.idempotency,
            tables.dependency, tables.job_history]  # fmt: skip
    return not on_disk(engine) and not any(count(engine, table) for table in rows)


def check(engine: Engine) -> None:
    """Audit rows and files once no child is at work."""
    wait_until(engine._scheduler.idle, 60)
    assert engine._db.read(audit) == []
    assert engine._db.read(lambda c: audit_files(c, engine._data.artifacts)) == []


@pytest.mark.usefixtures("store")
def test_an_ended_job_leaves_nothing_but_one_event(engine: Engine) -> None:
    job = engine.wait_job(engine.submit_job(SCENE, idempotency_key="k").id, 60)
    assert len(on_disk(engine)) >= 5
    engine.delete_job(job.id)
    with pytest.raises(JobNotFound):
        engine.get_job(job.id)
    wait_until(lambda: gone(engine), 60)
    assert [event.kind for event in engine.events(job_id=job.id)] == ["deleted"]
    engine.delete_job(job.id)  # sent again
    assert engine.status()["counters"]["jobs_deleted"] == 1
    with pytest.raises(JobNotFound):
        engine.delete_job("01980cf2-0000-7000-8000-000000000000")
    check(engine)
    again = engine.wait_job(engine.submit_job(SCENE, idempotency_key="k").id, 60)
    assert again.id != job.id and not again.cached and again.state.value == "succeeded"


def test_a_running_job_is_stopped_and_removed(engine: Engine) -> None:
    job = engine.submit_job(LONG)
    wait_until(lambda: engine.get_job(job.id).spp > 0, 60)
    engine.delete_job(job.id)
    wait_until(lambda: gone(engine) and engine._scheduler.idle(), 60)
    check(engine)


def test_another_job_on_the_same_film_keeps_what_it_has(engine: Engine) -> None:
    kept = engine.wait_job(engine.submit_job(SCENE, stop={"spp": 8}).id, 60)
    before = report_of(engine, kept.id)
    finer = engine.submit_job(SCENE | {"chunk_s": 0.0}, stop={"spp": 64})
    same = engine.submit_job(SCENE, stop={"spp": 8})
    engine.delete_job(same.id)
    engine.delete_job(finer.id)
    assert report_of(engine, kept.id) == before
    wait_until(lambda: count(engine, tables.job) == 1 and engine._scheduler.idle(), 60)
    more = engine.wait_job(engine.submit_job(SCENE, stop={"spp": 16}).id, 60)
    assert more.state.value == "succeeded"
    check(engine)


def test_asked_for_again_at_once_it_is_the_same_image(engine: Engine) -> None:
    first = engine.wait_job(engine.submit_job(SCENE).id, 60)
    wanted = report_of(engine, first.id)["sums"]
    for _ in range(6):  # its film is found again, or has gone already
        engine.delete_job(first.id)
        first = engine.wait_job(engine.submit_job(SCENE).id, 60)
        assert report_of(engine, first.id)["sums"] == wanted
    check(engine)


def test_no_claim_and_no_film_has_the_number_of_one_before(engine: Engine) -> None:
    seen: list[tuple[int, int]] = []
    for _ in range(4):
        job = engine.wait_job(engine.submit_job(SCENE).id, 60)
        newest = [sa.select(sa.func.max(t.c.id)) for t in (tables.film, tables.attempt)]
        seen.append(engine._db.read(lambda c: tuple(c.scalar(n) for n in newest)))  # noqa: B023
        engine.delete_job(job.id)
        wait_until(lambda: gone(engine), 60)
    for before, after in itertools.pairwise(seen):
        assert after[0] > before[0] and after[1] > before[1], seen


@pytest.mark.usefixtures("store")
@pytest.mark.parametrize("wait", [True, False], ids=["ended", "running"])
def test_a_sweep_goes_with_its_cells(engine: Engine, wait: bool) -> None:
    base = SMALL if wait else SMALL | {"chunk_s": 0.05}
    sweep = engine.submit_sweep(base, AXES)
    cells = engine.list_jobs(sweep_id=sweep.id)
    if wait:
        engine.wait_sweep(sweep.id, 60)
        engine.artifact(cells[0].id, "image.png")
    else:
        wait_until(lambda: engine.get_sweep(sweep.id).counts["running"], 60)
    engine.delete_sweep(sweep.id)
    with pytest.raises(JobNotFound):
        engine.get_sweep(sweep.id)
    with pytest.raises(JobNotFound):
        engine.get_job(cells[3].id)
    wait_until(lambda: gone(engine) and engine._scheduler.idle(), 60)
    assert [event.kind for event in engine.events(sweep_id=sweep.id)] == ["sweep_deleted"]
    engine.delete_sweep(sweep.id)
    wait_until(lambda: engine.readiness().checks["children"].ok, 60)


def test_a_large_sweep_is_hidden_at_once_and_goes_slice_by_slice(tmp_path: Path) -> None:
    """Its rows go in short transactions: others may write between, and a crash may come."""
    data = tmp_path / "data"
    with open_engine(data, children=1, **FAKE) as engine:
        sweep = engine.wait_sweep(engine.submit_sweep(SMALL, AXES, idempotency_key="k").id, 60)
        cells = engine.list_jobs(sweep_id=sweep.id)
    with open_storage(data, Rules()) as storage:
        write, read = storage._db.write, storage._db.read
        assert write(removal.delete_sweep, sweep.id)
        assert not write(removal.delete_sweep, sweep.id), "sent again"
        assert write(removal.remove_hidden, 10)  # then the process dies
        with pytest.raises(JobNotFound):
            read(views.get_sweep, sweep.id)
        with pytest.raises(JobNotFound):
            storage.pin(sweep.id, True)
        with pytest.raises(SceneValidationError, match="no job or sweep"):
            read(dependencies.check, [sweep.id])
        there = read(lambda c: c.execute(sa.select(tables.job.c.id)).scalars().all())
        assert len(there) == 14 and set(there) < {cell.id for cell in cells}
        with pytest.raises(JobNotFound):
            read(views.get_job, there[0])
        assert read(views.list_jobs, None, None, None, 100) == []
        assert read(views.list_jobs, None, sweep.id, None, 100) == []
        assert read(views.list_sweeps, None, 100) == []
    with open_engine(data, children=1, **FAKE) as engine:
        again = engine.submit_sweep(SMALL, AXES, idempotency_key="k")
        assert again.id != sweep.id
        engine.wait_sweep(again.id, 60)
        engine.delete_sweep(again.id)
        wait_until(lambda: gone(engine), 60)
        kinds = [event.kind for event in engine.events()]
        assert kinds.count("sweep_deleted") == 2
        check(engine)


def test_a_pack_stays_while_another_sweep_has_films_in_it(engine: Engine) -> None:
    first = engine.wait_sweep(engine.submit_sweep(SMALL, AXES).id, 60)
    second = engine.wait_sweep(engine.submit_sweep(SMALL, AXES, label="again").id, 60)
    engine.delete_sweep(first.id)
    cell = engine.list_jobs(sweep_id=second.id)[5]
    assert Path(engine.artifact(cell.id, "image.png").path).is_file()
    engine.delete_sweep(second.id)
    wait_until(lambda: gone(engine), 60)


def test_what_is_pinned_waited_for_or_a_cell_is_refused(engine: Engine) -> None:
    sweep = engine.submit_sweep(SMALL | {"chunk_s": 0.05}, AXES)
    cell = engine.list_jobs(sweep_id=sweep.id)[2]
    job = engine.submit_job(LONG)
    waiter = engine.submit_job(LONG | {"value": 2.0}, after=[job.id])

    def refused(delete: Any, name: str, code: str) -> None:
        with pytest.raises(DeletionRefused) as error:
            delete(name)
        assert error.value.code == code

    refused(engine.delete_job, cell.id, "part_of_sweep")
    refused(engine.delete_job, job.id, "waited_for")
    engine.storage.pin(cell.id, True)
    refused(engine.delete_sweep, sweep.id, "pinned")
    engine.storage.pin(waiter.id, True)
    refused(engine.delete_job, waiter.id, "pinned")
    for name in (cell.id, waiter.id):
        engine.storage.pin(name, False)
    engine.delete_job(waiter.id)
    engine.delete_job(job.id)
    engine.delete_sweep(sweep.id)
    wait_until(lambda: gone(engine) and engine._scheduler.idle(), 60)


def test_files_made_for_what_is_gone_are_not_kept(engine: Engine) -> None:
    """Images, sheets and nights may be in the making when their owner is deleted."""
    job = engine.wait_job(engine.submit_job(SCENE).id, 60)
    engine.delete_job(job.id)
    late = [files.Blob(*engine._data.artifacts.write([text])) for text in (b"a", b"b", b"c")]
    engine._db.write(lambda c: files.add_references(c, ("job", job.id), {"image.png": late[0]}))
    assert not engine._db.write(lambda c: jobs.finish_job(c, job.id, {"image.png": late[1]}))
    engine._db.write(lambda c: jobs.finish_sweep(c, job.id, late[2]))
    assert "sweep_finished" not in [event.kind for event in engine.events()]
    engine._scheduler.garbage()
    wait_until(lambda: gone(engine), 60)


def test_collection_without_a_service_drops_what_was_forgotten(tmp_path: Path) -> None:
    data = tmp_path / "data"
    with open_engine(data, children=1, **FAKE) as engine:
        job = engine.wait_job(engine.submit_job(SCENE).id, 60)
    rules = Rules(grace_hours=24.0)
    with open_storage(data, rules) as storage:
        storage._db.write(removal.delete_job, job.id)
        storage.collect()
    assert not [p for p in (data / "artifacts").glob("??/??/*") if p.is_file()]


def test_what_tells_of_deletions_goes_after_a_day(engine: Engine) -> None:
    job = engine.submit_job(SCENE)
    engine.delete_job(job.id)
    assert engine._db.write(removal.forget_deletions, time.time() - 3600.0, 10) == 0
    assert engine._db.write(removal.forget_deletions, time.time() + 1.0, 10) == 1
