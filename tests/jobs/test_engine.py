"""The engine over real child processes that render numpy chunks."""

from __future__ import annotations

import hashlib
import time
from pathlib import Path
from typing import Any

import pytest
from conftest_jobs import FAKE, SCENE, open_engine, report_of, wait_until

from matiere.errors import SceneValidationError
from matiere.jobs import Engine, JobState
from matiere.jobs.errors import (
    AssetMismatch,
    AssetMissing,
    DataDirLocked,
    Draining,
    IdempotencyConflict,
    JobNotFound,
    NotReadyYet,
)
from matiere.jobs.job import IMAGES
from matiere.jobs.rules import Rules

pytestmark = pytest.mark.usefixtures("store")

SLOW = SCENE | {"chunk_s": 0.05, "value": 2.0}  # 12 tiles x 10 ranges x 50 ms = 6 s of one thread


def run(engine: Engine, scene: dict[str, Any], **more: Any) -> Any:
    job = engine.submit_job(scene, **more)
    return engine.wait_job(job.id, 30)


def test_a_job_renders_every_sample_once(engine: Engine) -> None:
    job = run(engine, SCENE)
    assert (job.state, job.spp, job.stop_reason, job.progress) == ("succeeded", 64, "spp", 1.0)
    report = report_of(engine, job.id)
    assert (report["min_count"], report["max_count"]) == (64, 64)
    assert set(job.artifacts) == set(IMAGES)
    assert engine.status()["counters"]["chunks_rendered"] == 12 * 10


def test_requested_spp_is_rounded_up_to_a_boundary(engine: Engine) -> None:
    job = run(engine, SCENE, stop={"spp": 17})
    assert (job.spp, job.stop["spp"]) == (24, 17)


def test_chunk_files_are_freed_after_merging(engine: Engine) -> None:
    job = run(engine, SCENE)
    folder = engine.data_dir / "artifacts"
    wait_until(lambda: len([p for p in folder.rglob("*") if p.is_file()]) == 7)
    # prefix, five results, signature
    names = {p.name for p in folder.rglob("*") if p.is_file()}
    assert {engine.artifact(job.id, kind).digest for kind in job.artifacts} < names


def test_the_same_request_is_answered_from_the_store(engine: Engine) -> None:
    first = run(engine, SCENE)
    again = engine.submit_job(SCENE)
    assert (again.state, again.cached) == ("succeeded", True)
    assert again.id != first.id
    pairs = [engine.artifact(j.id, "image.png").digest for j in (first, again)]
    assert pairs[0] == pairs[1]


def test_a_finer_request_continues_the_stored_film(engine: Engine) -> None:
    run(engine, SCENE, stop={"spp": 16})
    before = engine.status()["counters"]["chunks_rendered"]
    finer = run(engine, SCENE, stop={"spp": 64})
    assert finer.cached is False
    assert engine.status()["counters"]["chunks_rendered"] == before + 12 * 6
    cached = run(engine, SCENE, stop={"spp": 32})
    assert (cached.cached, cached.spp) == (True, 64)
    with open_engine(engine.data_dir.parent / "other", children=1, **FAKE) as fresh:
        straight = run(fresh, SCENE, stop={"spp": 64})
        assert report_of(fresh, straight.id)["sums"] == report_of(engine, finer.id)["sums"]


def test_jobs_share_a_film_and_end_at_their_own_stop_rules(engine: Engine) -> None:
    small = engine.submit_job(SLOW, stop={"spp": 8})
    large = engine.submit_job(SLOW, stop={"spp": 24})
    error = engine.submit_job(SLOW, stop={"target_error": {"relmse": 0.08}, "spp": 64})
    small, large, error = (engine.wait_job(j.id, 30) for j in (small, large, error))
    assert (small.spp, large.spp, error.spp) == (8, 24, 16)
    assert (small.stop_reason, error.stop_reason) == ("spp", "target_error")
    assert report_of(engine, small.id)["max_count"] == 8
    assert report_of(engine, error.id)["min_count"] == 16


def test_cancelling_a_job_never_stops_a_film_another_wants(engine: Engine) -> None:
    wanted = engine.submit_job(SLOW, stop={"spp": 16})
    other = engine.submit_job(SLOW, stop={"spp": 64})
    wait_until(lambda: engine.get_job(wanted.id).state == "running")
    assert engine.cancel_job(other.id).state is JobState.CANCELLED
    ended = engine.wait_job(wanted.id, 30)
    assert (ended.state, ended.spp) == ("succeeded", 16)
    assert report_of(engine, ended.id)["max_count"] == 16
    with pytest.raises(JobNotFound):
        engine.artifact(other.id, "image.png")


def at_work(engine: Engine) -> list[Any]:
    """Return the claims that children work on."""
    children = [slot.child for slot in engine._scheduler.slots if slot.child is not None]
    return [held for child in children for held in list(child.inflight.values())[:1]]


def test_cancel_stops_a_running_child_quickly(engine: Engine) -> None:
    job = engine.submit_job(SCENE | {"chunk_s": 30.0})
    wait_until(lambda: any(c["claims"] for c in engine.status()["children"]))
    wait_until(lambda: {held.phase for held in at_work(engine)} == {"working"})
    start = time.monotonic()
    engine.cancel_job(job.id)
    wait_until(lambda: not any(c["claims"] for c in engine.status()["children"]))
    elapsed = time.monotonic() - start
    print(f"cancelled in {elapsed * 1000:.0f} ms")
    assert elapsed < 0.9, "within the flag's time, before SIGTERM"
    assert engine.status()["counters"].get("children_lost", 0) == 0
    assert engine.cancel_job(job.id).state is JobState.CANCELLED, "twice is harmless"


def test_a_seconds_rule_ends_near_its_time(engine: Engine) -> None:
    job = run(engine, SLOW | {"value": 3.0}, stop={"seconds": 1.0})
    assert job.stop_reason == "seconds"
    assert job.seconds >= 1.0
    assert report_of(engine, job.id)["min_count"] == job.spp


def test_urgent_jobs_go_first(engine: Engine) -> None:
    jobs = [
        engine.submit_job(SLOW | {"value": 10.0 + i}, stop={"spp": 4}, priority=p)
        for i, p in enumerate([10, 10, 10, 90])
    ]
    ended = [engine.wait_job(job.id, 30) for job in jobs]
    finished = [job.finished or 0.0 for job in ended]
    assert finished[3] < max(finished[1:3])


# -- failures -----------------------------------------------------------------------------------
def test_a_crash_is_tried_again(engine: Engine, tmp_path: Path) -> None:
    misdeed = {"kind": "SIGSEGV", "chunk": 3, "once": str(tmp_path / "once")}
    job = run(engine, SCENE | {"misdeed": misdeed})
    assert job.state == "succeeded"
    assert report_of(engine, job.id)["max_count"] == 64
    assert wait_until(lambda: engine.status()["counters"].get("children_lost")) == 1


@pytest.mark.parametrize(("kind", "code"), [("SIGSEGV", "signal"), ("raise", "python_error")])
def test_a_film_that_always_fails_stops_after_three_attempts(
    engine: Engine, kind: str, code: str
) -> None:
    bad = engine.submit_job(SCENE | {"misdeed": {"kind": kind, "chunk": 5}})
    good = engine.submit_job(SCENE)
    bad, good = engine.wait_job(bad.id, 30), engine.wait_job(good.id, 30)
    assert bad.error is not None
    assert (bad.state, bad.error.code) == ("failed", code)
    assert "3 attempts" in bad.error.message
    words = "Segmentation fault" if kind == "SIGSEGV" else "told to raise"
    assert words in bad.error.log_tail
    assert good.state == "succeeded"


def test_a_crash_of_the_utility_child_is_tried_again(engine: Engine, tmp_path: Path) -> None:
    misdeed = {"kind": "SIGSEGV", "chunk": -1, "once": str(tmp_path / "once")}
    assert run(engine, SCENE | {"misdeed": misdeed}).state == "succeeded"
    always = run(engine, SCENE | {"misdeed": {"kind": "SIGSEGV", "chunk": -1}})
    assert always.error is not None
    assert (always.state, always.error.code) == ("failed", "signal")


def test_a_damaged_chunk_file_is_rendered_again_and_never_used(engine: Engine) -> None:
    job = engine.submit_job(SLOW | {"value": 4.0}, stop={"spp": 8})
    folder = engine.data_dir / "artifacts"
    found = wait_until(lambda: [p for p in folder.glob("??/??/*") if p.is_file()])
    with found[0].open("r+b") as file:  # same size: only the digest tells
        file.write(b"x" * 40)
    job = engine.wait_job(job.id, 30)
    assert job.state == "succeeded"
    assert engine.status()["counters"]["files_damaged"] == 1
    with open_engine(engine.data_dir.parent / "other", children=1, **FAKE) as fresh:
        quiet = run(fresh, SLOW | {"value": 4.0}, stop={"spp": 8})
        assert report_of(fresh, quiet.id)["sums"] == report_of(engine, job.id)["sums"]


def test_a_damaged_prefix_is_rendered_again_and_never_used(engine: Engine) -> None:
    first = run(engine, SCENE, stop={"spp": 16})
    prefix = max(
        (p for p in (engine.data_dir / "artifacts").glob("??/??/*")), key=lambda p: p.stat().st_size
    )
    prefix.write_bytes(b"x" * prefix.stat().st_size)
    finer = run(engine, SCENE, stop={"spp": 32})
    assert (finer.state, finer.spp) == ("succeeded", 32)
    again = run(engine, SCENE, stop={"spp": 16}, label="again")
    assert engine.artifact(again.id, "image.png") == engine.artifact(first.id, "image.png")
    assert engine.status()["counters"]["files_damaged"] == 1
    with open_engine(engine.data_dir.parent / "other", children=1, **FAKE) as fresh:
        quiet = run(fresh, SCENE, stop={"spp": 32})
        assert report_of(fresh, quiet.id)["sums"] == report_of(engine, finer.id)["sums"]


def test_a_damaged_film_is_rendered_again_before_it_is_shown(engine: Engine) -> None:
    run(engine, SCENE, stop={"spp": 16})
    prefix = max(
        (p for p in (engine.data_dir / "artifacts").glob("??/??/*")), key=lambda p: p.stat().st_size
    )
    prefix.unlink()
    shown = run(engine, SCENE | {"output": {"exposure": 1}}, stop={"spp": 16})
    assert (shown.state, shown.spp) == ("succeeded", 16)
    assert report_of(engine, shown.id)["max_count"] == 16


def test_files_nobody_heard_of_are_removed_at_the_next_start(tmp_path: Path) -> None:
    with open_engine(tmp_path, children=1, **FAKE) as engine:
        job = run(engine, SCENE)
        digest, _ = engine._data.artifacts.write([b"written just before the kill"])
        (tmp_path / "artifacts" / "tmp" / "half").write_bytes(b"x")
        kept = Path(engine.artifact(job.id, "image.png").path)
    time.sleep(0.05)
    with open_engine(tmp_path, children=1, rules=Rules(grace_hours=0.0), **FAKE) as engine:
        left = engine._data.artifacts.path(digest)
        wait_until(lambda: not left.exists())
        assert kept.exists()
        assert list((tmp_path / "artifacts" / "tmp").glob("*")) == []


# -- requests -----------------------------------------------------------------------------------
def test_a_bad_scene_is_refused_and_leaves_nothing(engine: Engine) -> None:
    with pytest.raises(SceneValidationError) as caught:
        engine.submit_job(SCENE | {"width": -1, "value": 0})
    assert {f.pointer for f in caught.value.faults} == {"/width", "/value"}
    with pytest.raises(SceneValidationError) as caught:
        engine.submit_job(SCENE, stop={"sps": 3}, priority=101)
    assert {f.pointer for f in caught.value.faults} == {"/stop/sps", "/priority"}
    assert engine.list_jobs() == []


def test_files_are_read_before_a_job_is_accepted(engine: Engine) -> None:
    with pytest.raises(SceneValidationError) as caught:
        engine.submit_job(SCENE | {"mesh": "broken"})
    assert [(f.pointer, f.code) for f in caught.value.faults] == [("/mesh", "asset_unreadable")]
    with pytest.raises(SceneValidationError, match="3 attempts to read its files"):
        engine.submit_job(SCENE | {"mesh": "crash"})
    axes = [{"pointer": "/mesh", "values": ["good", "broken"]}]
    with pytest.raises(SceneValidationError) as caught:
        engine.submit_sweep(SCENE, axes)
    assert [f.pointer for f in caught.value.faults] == ["/axes/0/values/1"]
    assert engine.list_jobs() == []


def test_an_endless_reader_holds_up_neither_submissions_nor_other_jobs(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    from matiere.jobs import utility_queue

    wait_until(lambda: all(child["ready"] for child in engine.status()["children"]))
    monkeypatch.setattr("matiere.jobs.questions.CHECK_S", 0.3)
    monkeypatch.setitem(utility_queue.LIMIT_S, utility_queue.CHECK, 1.0)
    job = engine.submit_job(SCENE | {"mesh": "endless"})
    assert engine.wait_job(job.id, 30).state == "succeeded", "the stand-in renders without it"
    assert engine.status()["counters"]["children_lost"] == 1


def test_a_film_above_the_memory_limit_is_refused(tmp_path: Path) -> None:
    with open_engine(tmp_path, children=1, max_film_bytes=10_000, **FAKE) as engine:
        with pytest.raises(SceneValidationError, match="GiB") as caught:
            engine.submit_job(SCENE)
        assert caught.value.faults[0].code == "memory_limit"


def test_idempotency_keys(engine: Engine) -> None:
    first = engine.submit_job(SCENE, idempotency_key="k")
    assert engine.submit_job(SCENE, idempotency_key="k").id == first.id
    with pytest.raises(IdempotencyConflict):
        engine.submit_job(SCENE | {"value": 9.0}, idempotency_key="k")
    sweep = engine.submit_sweep(SCENE, [{"pointer": "/value", "values": [1]}], idempotency_key="s")
    again = engine.submit_sweep(SCENE, [{"pointer": "/value", "values": [1]}], idempotency_key="s")
    assert again.id == sweep.id


def test_a_sweep_renders_every_cell_and_a_sheet(engine: Engine) -> None:
    axes = [{"pointer": "/value", "linspace": [1, 2, 3]}, {"pointer": "/x", "values": ["a", "b"]}]
    sweep = engine.submit_sweep(SCENE, axes, stop={"spp": 8}, label="six")
    sweep = engine.wait_sweep(sweep.id, 30)
    assert sweep.counts["succeeded"] == sweep.cells == 6
    cells = engine.list_jobs(sweep_id=sweep.id)
    assert [c.cell for c in cells] == list(range(6))
    assert cells[3].parameters == {"value": 1.5, "x": "b"}
    rest = engine.list_jobs(sweep_id=sweep.id, after=cells[3].id)
    assert [c.cell for c in rest] == [4, 5]
    sheet = Path(engine.sweep_artifact(sweep.id).path).read_text()
    assert sheet.count("true") == 6


def test_a_sweep_with_a_bad_cell_is_refused_whole_and_points_at_the_value(engine: Engine) -> None:
    axes = [{"pointer": "/value", "values": [1, -2, 3]}]
    with pytest.raises(SceneValidationError) as caught:
        engine.submit_sweep(SCENE, axes)
    assert [f.pointer for f in caught.value.faults] == ["/axes/0/values/1"]
    assert engine.list_jobs() == [] and engine.list_sweeps() == []


def test_a_cancelled_sweep_still_closes_with_what_it_has(engine: Engine) -> None:
    axes = [{"pointer": "/value", "linspace": [1, 2, 12]}]
    sweep = engine.submit_sweep(SLOW, axes, stop={"spp": 16})
    wait_until(lambda: engine.get_sweep(sweep.id).counts["succeeded"] >= 1, 30)
    sweep = engine.cancel_sweep(sweep.id)
    assert sweep.counts["cancelled"] > 0
    ended = engine.wait_sweep(sweep.id, 30)
    assert ended.finished is not None
    assert ended.counts["succeeded"] + ended.counts["cancelled"] == 12
    sheet = Path(engine.sweep_artifact(sweep.id).path).read_text()
    assert sheet.count("true") == ended.counts["succeeded"]


def test_events_rise_without_repeats_and_can_be_waited_for(engine: Engine) -> None:
    job = run(engine, SCENE)
    seen = engine.events(0, job_id=job.id)
    kinds = [e.kind for e in seen]
    assert (kinds[0], kinds[1], kinds[-1]) == ("queued", "running", "succeeded")
    assert "look" in kinds
    numbers = [e.seq for e in seen]
    assert numbers == sorted(set(numbers))
    assert engine.events(numbers[-1], job_id=job.id) == []
    start = time.monotonic()
    assert engine.events(10**9, wait_s=0.2) == []
    assert 0.2 <= time.monotonic() - start < 2.0


def test_artifacts_say_when_they_are_not_there(engine: Engine) -> None:
    job = engine.submit_job(SLOW)
    with pytest.raises(NotReadyYet):
        engine.artifact(job.id, "image.png")
    with pytest.raises(JobNotFound):
        engine.get_job("nobody")
    with pytest.raises(JobNotFound):
        engine.get_sweep("nobody")
    engine.cancel_job(job.id)


# -- assets -------------------------------------------------------------------------------------
def put(engine: Engine, data: bytes) -> str:
    digest = hashlib.sha256(data).hexdigest()
    engine.put_asset(digest, [data[:2], data[2:]])
    return digest


def test_assets_are_stored_by_digest_and_pinned(engine: Engine) -> None:
    digest = hashlib.sha256(b"mesh").hexdigest()
    scene = SCENE | {"files": ["ball.glb"]}
    assert engine.missing_assets([digest, digest]) == [digest]
    with pytest.raises(AssetMissing, match=digest):
        engine.submit_job(scene, assets={"ball.glb": digest})
    with pytest.raises(AssetMismatch):
        engine.put_asset(digest, [b"mush"])
    assert engine.missing_assets([digest]) == [digest], "a wrong upload leaves nothing"
    assert engine.put_asset(digest, [b"me", b"sh"]) is True
    assert engine.put_asset(digest, [b"mesh"]) is False
    assert run(engine, scene, assets={"ball.glb": digest}).state == "succeeded"
    other = put(engine, b"hsem")
    assert run(engine, scene, assets={"ball.glb": other}).cached is False, "other bytes, other film"


@pytest.mark.parametrize("name", ["../x", "/etc/passwd", "a\0b", "n" * 300, "http://x/y", "", "."])
def test_hostile_asset_names_reach_no_file(engine: Engine, name: str) -> None:
    digest = put(engine, b"mesh")
    engine.submit_job(SCENE, assets={name: digest})
    with pytest.raises(AssetMissing):
        engine.submit_job(SCENE, assets={"good": "../../../etc/passwd"})
    with pytest.raises(AssetMismatch):
        engine.put_asset("../x", [b"x"])
    assert engine.missing_assets(["../x"]) == ["../x"]
    inside = {p.name for p in (engine.data_dir / "views").rglob("*") if p.is_file()}
    assert inside == set()


def test_a_file_of_the_asset_folder_can_be_named_and_a_missing_one_is_pointed_at(
    engine: Engine,
) -> None:
    with pytest.raises(SceneValidationError) as caught:
        engine.submit_job(SCENE | {"files": ["no.hdr"]})
    assert caught.value.faults[0].pointer == "/files/0"
    (engine.data_dir / "assets" / "studio.hdr").write_bytes(b"light")
    digest = put(engine, b"mesh")
    scene = SCENE | {"files": ["studio.hdr", "ball.glb"]}
    assert run(engine, scene, assets={"ball.glb": digest}).state == "succeeded"


def test_a_file_that_changes_after_submission_fails_the_job(engine: Engine) -> None:
    file = engine.data_dir / "assets" / "studio.hdr"
    file.write_bytes(b"light")
    blockers = [engine.submit_job(SLOW | {"value": 20.0 + i}, stop={"spp": 4}) for i in range(4)]
    job = engine.submit_job(SCENE | {"files": ["studio.hdr"]}, priority=0)
    file.write_bytes(b"other")
    job = engine.wait_job(job.id, 30)
    assert job.error is not None
    assert (job.state, job.error.code) == ("failed", "asset_changed")
    assert all(engine.wait_job(b.id, 30).state == "succeeded" for b in blockers)


# -- the directory ------------------------------------------------------------------------------
def test_a_second_opener_is_told_who_holds_the_directory(engine: Engine) -> None:
    import os

    engine.announce("http://127.0.0.1:8470")
    with pytest.raises(DataDirLocked, match="8470") as caught:
        open_engine(engine.data_dir, **FAKE)
    assert (caught.value.url, caught.value.pid) == ("http://127.0.0.1:8470", os.getpid())


def test_the_data_directory_is_private_and_closing_leaves_no_note(tmp_path: Path) -> None:
    with open_engine(tmp_path / "data", children=1, **FAKE) as engine:
        assert (engine.data_dir.stat().st_mode & 0o777) == 0o700
        pids = [c["pid"] for c in engine.status()["children"]]
        wait_until(lambda: engine.readiness().ready)
    assert not (tmp_path / "data" / "server.json").exists()
    from conftest_jobs import alive

    assert not any(alive(pid) for pid in pids if pid)
    engine.close()


def test_draining_refuses_new_work_and_lets_claims_end(engine: Engine) -> None:
    job = engine.submit_job(SLOW)
    wait_until(lambda: engine.get_job(job.id).state == "running")
    start = time.monotonic()
    assert engine.drain(8.0) is True
    print(f"drained in {time.monotonic() - start:.2f} s")
    with pytest.raises(Draining):
        engine.submit_job(SCENE)
    assert engine.readiness().checks["accepting"].ok is False
    engine.close()
    with open_engine(engine.data_dir, children=2, **FAKE) as again:
        assert again.wait_job(job.id, 30).state == "succeeded"
