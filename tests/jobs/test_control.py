"""Pause, resume, requeue, priority, dependencies, deadlines: the rows, then real children."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from conftest_jobs import FAKE, SCENE, report_of, stored, submit_sweep, wait_until

from matiere.errors import SceneValidationError
from matiere.jobs import Engine, JobState, open_engine
from matiere.jobs.deadline import parse
from matiere.jobs.errors import IllegalTransition
from matiere.jobs.job import AGEING_S, JobError, queue_rank
from matiere.jobs.store import control, events, films, jobs, tables, views
from matiere.jobs.store.database import Database
from matiere.jobs.store.files import Blob
from matiere.jobs.store.films import Claim, Merged, Report

SLOW = SCENE | {"chunk_s": 0.05, "value": 2.0}


@pytest.fixture
def db(tmp_path: Path, store: str) -> Iterator[Database]:
    path = tmp_path / "store.sqlite"
    database = Database(path, stored(path).get("database_url"))
    database.write(lambda c: films.void_dead(c, "first", 1))
    yield database
    database.close()


def submit(db: Database, key: str = "a", priority: int = 50, **more: Any) -> str:
    film = jobs.FilmSpec(key, "g", {"w": 1}, {}, 8, 8, 2)
    spec = jobs.JobSpec(film, {"spp": 64}, 64, {}, priority, "label", **more)
    return db.write(lambda c: jobs.submit_job(c, spec))


def get(db: Database, job_id: str) -> Any:
    return db.read(lambda c: views.get_job(c, job_id))


def queue(db: Database) -> list[int]:
    return db.read(lambda c: films.next_films(c, 20))


def fail(db: Database, job_id: str) -> None:
    db.write(lambda c: jobs.fail_job(c, job_id, JobError("signal", "crashed", "", "log")))


def succeed(db: Database, job_id: str) -> None:
    facts = {"spp": 64, "seconds": 1.0, "relmse": 0.1, "lower": 0.1, "upper": 0.1}
    facts |= {"reason": "spp", "cached": False}
    blob = Blob("f" * 64, 3)
    db.write(lambda c: jobs.end_job(c, job_id, facts, blob))
    assert db.write(lambda c: jobs.finish_job(c, job_id, {"image.png": blob}))


# -- ageing -------------------------------------------------------------------------------------
def test_a_minute_of_waiting_weighs_a_point(db: Database) -> None:
    old, new, urgent = submit(db, "a", 50), submit(db, "b", 51), submit(db, "c", 90)
    assert queue(db) == [3, 2, 1]
    _queued_before(db, old, 1.5 * AGEING_S)
    assert queue(db) == [3, 1, 2]
    _queued_before(db, old, 41 * AGEING_S)
    assert queue(db) == [1, 3, 2], "nothing starves: any priority is overtaken in time"
    assert 90.9 < get(db, old).effective_priority < 91.2
    assert get(db, new).priority == 51 and get(db, urgent).effective_priority < 90.1


def _queued_before(db: Database, job_id: str, seconds: float) -> None:
    moment = time.time() - seconds
    rank = queue_rank(get(db, job_id).priority, moment)
    change = sa.update(tables.job).where(tables.job.c.id == job_id)
    db.write(lambda c: c.execute(change.values(queued=moment, rank=rank)))


def test_a_changed_priority_keeps_the_time_waited(db: Database) -> None:
    first, second = submit(db, "a"), submit(db, "b")
    _queued_before(db, first, 10 * AGEING_S)
    assert db.write(lambda c: control.set_priority(c, first, 42))
    assert queue(db) == [1, 2]
    assert db.write(lambda c: control.set_priority(c, first, 39))
    assert queue(db) == [2, 1]
    kinds = [e.kind for e in db.read(lambda c: events.read_events(c, 0, first, None, 9))]
    assert kinds == ["queued", "priority", "priority"]
    fail(db, second)
    assert not db.write(lambda c: control.set_priority(c, second, 1))


# -- pause --------------------------------------------------------------------------------------
def test_nobody_claims_for_a_paused_job_and_what_is_rendered_is_kept(db: Database) -> None:
    job_id = submit(db)
    token = db.write(lambda c: films.claim(c, Claim(1, [0], "first", 1, 30.0)))
    assert token is not None
    assert db.write(lambda c: control.pause_job(c, job_id))
    assert not db.write(lambda c: control.pause_job(c, job_id)), "twice is harmless"
    assert queue(db) == []
    assert db.write(lambda c: films.claim(c, Claim(1, [1], "first", 1, 30.0))) is None
    assert db.write(lambda c: films.complete(c, Report(token, 1, Blob("1" * 64, 5), 0.1, 64)))
    db.write(lambda c: films.drop_unmerged(c, 1))
    assert db.read(lambda c: films.load_film(c, 1)).done == {0: token}
    assert db.write(lambda c: control.resume_job(c, job_id))
    assert (get(db, job_id).state, queue(db)) == ("queued", [1])


def test_a_merge_that_ends_a_paused_job_is_not_lost(db: Database) -> None:
    job_id = submit(db)
    token = db.write(lambda c: films.claim(c, Claim(1, [0], "first", 1, 30.0)))
    assert token is not None
    db.write(lambda c: films.complete(c, Report(token, 1, Blob("1" * 64, 5), 0.1, 64)))
    db.write(lambda c: control.pause_job(c, job_id))
    facts = {"spp": 64, "seconds": 1.0, "relmse": 0.5, "lower": 0.4, "upper": 0.6}
    ended = [{"job_id": job_id, "reason": "spp", "cached": False, **facts}]
    db.write(lambda c: films.commit_merge(c, Merged(1, 0, 1, Blob("9" * 64, 9), facts, ended, {})))
    assert get(db, job_id).state is JobState.PAUSED
    assert db.read(jobs.jobs_to_develop) == []
    db.write(lambda c: control.resume_job(c, job_id))
    assert db.read(jobs.jobs_to_develop) == [job_id]


@pytest.mark.parametrize("action", [control.pause_job, control.resume_job])
def test_what_has_ended_can_be_neither_paused_nor_resumed(db: Database, action: Any) -> None:
    job_id = submit(db)
    fail(db, job_id)
    with pytest.raises(IllegalTransition):
        db.write(lambda c: action(c, job_id))


# -- requeue ------------------------------------------------------------------------------------
def test_a_requeue_is_a_new_attempt_that_remembers_the_last(db: Database) -> None:
    job_id = submit(db)
    for attempt in (2, 3):
        fail(db, job_id)
        assert db.write(lambda c: control.requeue_job(c, job_id)) == [job_id]
        assert db.write(lambda c: control.requeue_job(c, job_id)) == [], "twice is harmless"
        job = get(db, job_id)
        assert (job.state, job.attempt, job.error) == ("queued", attempt, None)
        assert (job.started, job.finished, job.spp) == (None, None, 0)
    assert [line["attempt"] for line in job.history] == [1, 2]
    assert [line["state"] for line in job.history] == ["failed", "failed"]
    assert job.history[0]["error_code"] == "signal" and job.history[0]["error_log"] == "log"
    succeed(db, job_id)
    with pytest.raises(IllegalTransition, match="succeeded job cannot become queued"):
        db.write(lambda c: control.requeue_job(c, job_id))


def test_images_made_for_an_earlier_attempt_are_refused(db: Database) -> None:
    job_id = submit(db)
    facts = {"spp": 64, "seconds": 1.0, "relmse": 0.1, "lower": 0.1, "upper": 0.1}
    facts |= {"reason": "spp", "cached": False}
    prefix, image = Blob("f" * 64, 3), {"image.png": Blob("e" * 64, 3)}
    db.write(lambda c: jobs.end_job(c, job_id, facts, prefix))
    db.write(lambda c: jobs.cancel_job(c, job_id))
    db.write(lambda c: control.requeue_job(c, job_id))
    assert not db.write(lambda c: jobs.finish_job(c, job_id, image, 1)), "it is queued"
    db.write(lambda c: jobs.end_job(c, job_id, facts, prefix))
    assert not db.write(lambda c: jobs.finish_job(c, job_id, image, 1)), "of attempt 1"
    assert db.write(lambda c: jobs.finish_job(c, job_id, image, 2))
    assert get(db, job_id).state is JobState.SUCCEEDED


def test_a_requeued_sweep_is_open_again(db: Database) -> None:
    sweep_id = submit_sweep(db, 3, "k")
    ids = [job.id for job in db.read(lambda c: views.list_jobs(c, None, sweep_id, None, 9))]
    assert db.write(lambda c: control.pause_sweep(c, sweep_id)) == 3
    assert db.write(lambda c: control.set_sweep_priority(c, sweep_id, 9)) == 3
    assert db.read(jobs.finished_sweeps) == [], "paused cells have not ended"
    assert db.write(lambda c: control.resume_sweep(c, sweep_id)) == 3
    succeed(db, ids[0])
    db.write(lambda c: jobs.cancel_sweep(c, sweep_id))
    db.write(lambda c: jobs.finish_sweep(c, sweep_id, None))
    assert db.write(lambda c: control.requeue_sweep(c, sweep_id)) == ids[1:]
    sweep = db.read(lambda c: views.get_sweep(c, sweep_id))
    assert (sweep.finished, sweep.counts["queued"], sweep.counts["succeeded"]) == (None, 2, 1)
    assert {get(db, i).priority for i in ids} == {9}
    kinds = [e.kind for e in db.read(lambda c: events.read_events(c, 0, None, sweep_id, 99))]
    assert {"sweep_paused", "sweep_resumed", "sweep_priority", "sweep_finished"} < set(kinds)


# -- dependencies -------------------------------------------------------------------------------
def test_a_job_begins_when_all_that_it_needs_has_succeeded(db: Database) -> None:
    one, two = submit(db, "a"), submit(db, "b")
    last = submit(db, "c", after=(one, two, one))
    assert queue(db) == [1, 2]
    assert (get(db, last).waiting_for, get(db, last).after) == (2, tuple(sorted((one, two))))
    succeed(db, one)
    assert (get(db, last).waiting_for, queue(db)) == (1, [2])
    succeed(db, two)
    assert (get(db, last).waiting_for, queue(db)) == (0, [3])


def test_a_failure_cancels_all_that_wait_for_it_and_a_requeue_brings_them_back(
    db: Database,
) -> None:
    first = submit(db, "a")
    chain = [first]
    for n in range(30):
        chain.append(submit(db, f"k{n}", after=(chain[-1],)))
    fail(db, first)
    last = get(db, chain[-1])
    assert last.state is JobState.CANCELLED and last.error is not None
    assert (last.error.code, last.error.pointer) == ("dependency_failed", "/after")
    assert chain[-2] in last.error.message
    with pytest.raises(IllegalTransition, match="requeue that first"):
        db.write(lambda c: control.requeue_job(c, chain[1]))
    assert set(db.write(lambda c: control.requeue_job(c, first))) == set(chain)
    assert {get(db, i).state for i in chain} == {JobState.QUEUED}
    assert [get(db, i).waiting_for for i in chain] == [0, *[1] * 30]
    late = submit(db, "late", after=(chain[-1],))
    fail(db, first)
    assert get(db, late).state is JobState.CANCELLED
    after = submit(db, "after", after=(first,))
    assert get(db, after).state is JobState.CANCELLED, "as if it had been submitted before"


def test_a_sweep_can_wait_and_be_waited_for(db: Database) -> None:
    first = submit(db, "a")
    sweep_id = submit_sweep(db, 2, "s", after=(first,))
    last = submit(db, "z", after=(sweep_id,))
    assert queue(db) == [1]
    assert db.read(lambda c: views.get_sweep(c, sweep_id)).waiting_for == 1
    succeed(db, first)
    assert db.read(lambda c: views.get_sweep(c, sweep_id)).waiting_for == 0
    assert queue(db) == [2, 3]
    for job in db.read(lambda c: views.list_jobs(c, None, sweep_id, None, 9)):
        succeed(db, job.id)
    assert get(db, last).waiting_for == 1, "its contact sheet is still to be drawn"
    db.write(lambda c: jobs.finish_sweep(c, sweep_id, None))
    assert queue(db) == [4]


def test_only_what_is_there_can_be_waited_for_so_no_cycle_can_be_made(db: Database) -> None:
    with pytest.raises(SceneValidationError) as caught:
        submit(db, "a", after=("nobody",))
    assert [(f.pointer, f.code) for f in caught.value.faults] == [("/after/0", "not_found")]
    assert db.read(lambda c: views.list_jobs(c, None, None, None, 9)) == []


# -- deadlines ----------------------------------------------------------------------------------
def test_deadlines_are_seconds_or_moments() -> None:
    assert parse(None, 1e9) is None
    assert parse(90, 1e9) == 1e9 + 90
    assert parse("2001-09-09T01:47:40Z", 1e9) == parse("2001-09-09T03:47:40+02:00", 1e9) == 1e9 + 60
    for bad in (0, -1, float("nan"), 1e12, "soon", "2001-09-09T01:47:40", "2001-09-09T01:46:00Z"):
        with pytest.raises(SceneValidationError) as caught:
            parse(bad, 1e9)
        assert caught.value.faults[0].pointer == "/deadline"


def test_a_late_job_with_nothing_expires_with_words(db: Database) -> None:
    job_id = submit(db, deadline=time.time() + 1)
    paused = submit(db, "b", deadline=time.time() + 2)
    db.write(lambda c: control.pause_job(c, paused))
    assert db.read(lambda c: control.due(c, time.time())) == []
    assert db.read(lambda c: control.due(c, time.time() + 5)) == [(job_id, 1), (paused, 2)]
    for late in (job_id, paused):
        assert db.write(control.expire_job, late)
        job = get(db, late)
        assert job.error is not None
        assert (job.state, job.error.code, job.error.pointer) == (
            "expired",
            "deadline",
            "/deadline",
        )
    assert db.read(lambda c: control.due(c, time.time() + 5)) == []


# -- with children ------------------------------------------------------------------------------
def test_a_paused_job_goes_on_where_it_was(engine: Engine, tmp_path: Path) -> None:
    job = engine.submit_job(SLOW, stop={"spp": 32})
    wait_until(lambda: engine.get_job(job.id).progress > 0.1)
    assert engine.pause_job(job.id).state is JobState.PAUSED
    wait_until(lambda: not any(child["claims"] for child in engine.status()["children"]))
    rendered = engine.status()["counters"]["chunks_rendered"]
    time.sleep(0.5)
    assert engine.status()["counters"]["chunks_rendered"] == rendered
    assert engine.status()["jobs"]["paused"] == 1
    assert engine.resume_job(job.id).state is JobState.QUEUED
    ended = engine.wait_job(job.id, 60)
    assert (ended.state, ended.spp) == ("succeeded", 32)
    counters = engine.status()["counters"]
    assert counters["chunks_rendered"] == 12 * 6, "nothing was rendered twice"
    assert (counters["jobs_paused"], counters["jobs_resumed"]) == (1, 1)
    with open_engine(tmp_path / "quiet", children=1, **FAKE) as quiet:
        other = quiet.wait_job(quiet.submit_job(SLOW | {"chunk_s": 0}, stop={"spp": 32}).id, 60)
        assert report_of(quiet, other.id)["sums"] == report_of(engine, job.id)["sums"]


def test_a_failed_job_succeeds_when_requeued(engine: Engine, tmp_path: Path) -> None:
    flag = tmp_path / "mended"
    misdeed = {"kind": "raise", "chunk": 3, "unless": str(flag)}
    job = engine.submit_job(SCENE | {"misdeed": misdeed})
    then = engine.submit_job(SCENE | {"value": 5.0}, after=[job.id])
    assert engine.wait_job(job.id, 60).state == "failed"
    assert engine.wait_job(then.id, 60).state == "cancelled"
    flag.touch()
    assert engine.requeue_job(job.id).attempt == 2
    assert engine.wait_job(job.id, 60).state == "succeeded"
    then = engine.wait_job(then.id, 60)
    assert (then.state, then.attempt, then.history[0]["error_code"]) == (
        "succeeded", 2, "dependency_failed",
    )  # fmt: skip


def test_at_its_deadline_a_job_keeps_what_it_has(engine: Engine) -> None:
    wait_until(lambda: engine.readiness().ready)
    job = engine.submit_job(SLOW | {"chunk_s": 0.004}, stop={"spp": 2**16}, deadline=6)
    never = engine.submit_job(SLOW | {"value": 3.0, "chunk_s": 1000.0}, deadline=1.5, priority=0)
    never = engine.wait_job(never.id, 60)
    assert never.error is not None
    assert (never.state, never.error.code, never.artifacts) == ("expired", "deadline", ())
    job = engine.wait_job(job.id, 60)
    assert (job.state, job.stop_reason, job.error) == ("expired", "deadline", None)
    report = report_of(engine, job.id)
    assert report["min_count"] == report["max_count"] == job.spp > 0
    assert engine.requeue_job(job.id).deadline is None, "a deadline that has passed is dropped"
    engine.cancel_job(job.id)
