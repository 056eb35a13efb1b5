"""Sweeps whose cells share render seconds: who gets them, what is kept, who is marked."""

from __future__ import annotations

import statistics
import time
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from conftest_jobs import FAKE, SCENE, Service, open_engine, report_of

from matiere.errors import SceneValidationError
from matiere.jobs import Engine
from matiere.jobs.budget import Wish, ahead, in_turn, need_s, parse_budget
from matiere.jobs.store.audit import audit
from matiere.jobs.store.tables import attempt

BASE: dict[str, Any] = {**SCENE, "width": 16, "height": 16, "hard": 1}
HARD = [{"pointer": "/hard", "values": [1, 2, 4, 8, 16, 32], "label": "hard"}]
TARGET = {"relmse": 0.05}


def wish(film_id: int, share: float | None, seconds: float = 1.0, spp: int = 8) -> Wish:
    """Return a cell of 10 x 10 pixels."""
    return Wish(film_id, "g", 10, 10, 2, spp, seconds, 100 * spp, share)


def run(engine: Engine, seconds: float, target: float = 0.05, **more: Any) -> Any:
    """Submit the sweep of six cells, from easy to hard, and wait for its end."""
    budget = {"seconds": seconds, "target_error": {"relmse": target}}
    sweep = engine.submit_sweep({**BASE, **more}, HARD, budget=budget)
    return engine.wait_sweep(sweep.id, 400)


# -- whose turn it is ---------------------------------------------------------------------------
def test_the_worst_cell_that_can_be_finished_comes_first() -> None:
    cells = [wish(1, 0.9), wish(2, 0.2), wish(3, 0.5), wish(4, 0.001), wish(5, None, spp=0)]
    assert [w.film_id for w in in_turn(cells, 10.0)] == [5, 2, 3, 1, 4]
    assert need_s(cells[3]) == pytest.approx(999.0)


def test_when_no_cell_can_be_finished_the_worst_is_made_better() -> None:
    cells = [wish(1, 0.3), wish(2, 0.1), wish(3, 0.2)]
    assert [w.film_id for w in in_turn(cells, 0.5)] == [2, 3, 1]


def test_a_cell_of_unknown_error_takes_nothing_from_others() -> None:
    cells = [wish(1, None), wish(2, 0.001), wish(3, None, spp=4)]
    assert [w.film_id for w in in_turn(cells, 10.0)] == [2, 3, 1]


def test_a_cell_is_looked_at_before_it_could_have_too_many_samples() -> None:
    assert ahead(wish(1, 0.01)) == 4.0
    assert 1.0 < ahead(wish(1, 0.6)) < 1.0 / 0.6
    assert ahead(wish(1, 0.95)) == ahead(wish(1, None)) == 1.0


# -- what is asked for --------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("budget", "pointer"),
    [
        (3, "/budget"),
        ({"seconds": 1}, "/budget/target_error"),
        ({"seconds": 0, "target_error": {"relmse": 1}}, "/budget/seconds"),
        ({"seconds": True, "target_error": {"relmse": 1}}, "/budget/seconds"),
        ({"seconds": 1, "target_error": 0.1}, "/budget/target_error"),
        ({"seconds": 1, "target_error": {"relmse": -1}}, "/budget/target_error/relmse"),
        ({"seconds": 1, "target_error": {"relmse": 1}, "spp": 4}, "/budget/spp"),
    ],
)
def test_a_wrong_budget_is_refused_where_it_is_wrong(budget: Any, pointer: str) -> None:
    found, faults = parse_budget(budget)
    assert found is None and [f.pointer for f in faults] == [pointer]


def test_a_budget_and_another_end_of_the_cells_exclude_each_other(engine: Engine) -> None:
    budget = {"seconds": 1.0, "target_error": TARGET}
    with pytest.raises(SceneValidationError) as caught:
        engine.submit_sweep(BASE, HARD, budget=budget, stop={"spp": 4})
    assert [f.pointer for f in caught.value.faults] == ["/stop"]
    spp = [{"pointer": "/render/spp", "values": [4, 8]}]
    with pytest.raises(SceneValidationError) as caught:
        engine.submit_sweep(BASE, spp, budget=budget)
    assert [f.pointer for f in caught.value.faults] == ["/budget"]


# -- in the queue -------------------------------------------------------------------------------
@pytest.mark.usefixtures("store")
def test_all_cells_reach_the_target_within_an_ample_budget(tmp_path: Path) -> None:
    with open_engine(tmp_path, children=2, **FAKE) as engine:
        sweep = run(engine, 600.0)
        assert sweep.counts["succeeded"] == 6 and sweep.counts["unfinished"] == 0
        jobs = engine.list_jobs(sweep_id=sweep.id)
        assert {job.stop_reason for job in jobs} == {"target_error"}
        assert all(job.relmse_interval and job.relmse_interval[1] <= 0.05 for job in jobs)
        spps = [job.spp for job in jobs]
        assert spps == sorted(spps) and spps[-1] >= 16 * spps[0]
        assert sweep.budget is not None and not sweep.budget.closed
        assert 0.0 < sweep.budget.spent_s < 600.0 and sweep.budget.needed_s == 0.0
        assert engine._db.read(audit) == []


def lateness(engine: Engine) -> float:
    """Return by how much the last claim of either child took longer than such claims do here."""
    took = sa.select(attempt.c.chunks, attempt.c.seconds).where(attempt.c.seconds.is_not(None))
    rows = engine._db.read(lambda c: c.execute(took.order_by(attempt.c.ended)).all())
    usual = statistics.median(seconds / chunks for chunks, seconds in rows)
    return sum(max(0.0, seconds - usual * chunks) for chunks, seconds in rows[-2:])


@pytest.mark.usefixtures("store")
def test_a_short_budget_is_kept_and_shared_out_evenly(tmp_path: Path) -> None:
    """Each chunk takes 50 ms of either child, much more than what a busy machine adds."""
    with open_engine(tmp_path, children=2, **FAKE) as engine:
        begin = time.monotonic()
        sweep = run(engine, 6.0, 0.005, chunk_s=0.05)
        print(f"{time.monotonic() - begin:.1f} s, {sweep.budget}")
        late = lateness(engine)
        assert sweep.budget.closed and 4.0 < sweep.budget.spent_s <= 6.6 + late, late
        jobs = engine.list_jobs(sweep_id=sweep.id)
        states = {str(job.state) for job in jobs}
        assert "unfinished" in states <= {"unfinished", "succeeded"}
        left = [job for job in jobs if job.state == "unfinished"]
        for job in left:
            assert job.stop_reason == "budget" and job.relmse_interval is not None
            assert job.relmse == job.parameters["hard"] / job.spp > 0.005
            assert job.artifacts and job.error is None
            assert report_of(engine, job.id)["min_count"] == job.spp
        spent = [job.spp for job in jobs]
        print([(job.parameters["hard"], str(job.state), job.spp, job.relmse) for job in jobs])
        assert sum(spent[3:]) > 1.2 * sum(spent[:3])  # samples went where the error is
        assert engine._db.read(audit) == []
        events = engine.events(sweep_id=sweep.id, limit=10_000)
        assert sum(event.kind == "budget_spent" for event in events) == 1


def test_a_larger_budget_goes_on_where_the_smaller_ended(engine: Engine) -> None:
    first = run(engine, 0.1, 0.3, chunk_s=0.01)
    before = [job.spp for job in engine.list_jobs(sweep_id=first.id)]
    assert first.counts["unfinished"]
    second = run(engine, 600.0, 0.3, chunk_s=0.01)
    after = engine.list_jobs(sweep_id=second.id)
    assert second.counts["succeeded"] == 6
    assert all(job.spp >= spp for job, spp in zip(after, before, strict=True))


def test_the_same_samples_give_the_same_bits(engine: Engine, tmp_path: Path) -> None:
    short = run(engine, 1.0, 0.01, chunk_s=0.01)
    begun = [job for job in engine.list_jobs(sweep_id=short.id) if job.spp]
    assert begun  # of a loaded machine the budget may leave some cells without a sample
    for job in begun:
        scene = {**BASE, "hard": job.parameters["hard"]}
        with open_engine(tmp_path / str(job.cell), children=1, **FAKE) as other:
            alone = other.wait_job(other.submit_job(scene, stop={"spp": job.spp}).id, 400)
            assert alone.spp == job.spp
            mine, its = (report_of(e, j.id)["sums"] for e, j in ((engine, job), (other, alone)))
            assert mine == its


@pytest.mark.usefixtures("store")
def test_a_killed_service_goes_on_with_what_is_left(tmp_path: Path) -> None:
    budget = {"seconds": 2.0, "target_error": {"relmse": 0.002}}
    scene = {**BASE, "chunk_s": 0.01}
    script = (
        f"sweep = engine.submit_sweep({scene!r}, {HARD!r}, budget={budget!r})\n"
        "while engine.get_sweep(sweep.id).budget.spent_s < 0.3: time.sleep(0.01)"
    )
    service = Service(tmp_path, script, children=2, **FAKE)
    service.kill()
    with open_engine(tmp_path, children=2, **FAKE) as engine:
        sweep_id = engine.list_sweeps()[0].id
        before = engine.get_sweep(sweep_id).budget
        sweep = engine.wait_sweep(sweep_id, 400)
        print(before, sweep.budget)
        assert before is not None and sweep.budget is not None
        assert 0.0 < before.spent_s < 2.0 and before.spent_s < sweep.budget.spent_s <= 2.2
        assert sweep.counts["unfinished"] > 0 and sweep.done
        for job in engine.list_jobs(sweep_id=sweep_id):
            report = report_of(engine, job.id)
            assert report["min_count"] == report["max_count"] == job.spp
        assert engine._db.read(audit) == []


def test_a_budget_too_small_for_any_sample_marks_every_cell(engine: Engine) -> None:
    run(engine, 600.0, 0.5, chunk_s=0.05, geometry="g")  # tells what a sample takes
    sweep = run(engine, 0.01, 0.05, chunk_s=0.05, geometry="g", seed=5)
    assert sweep.done and sweep.counts["unfinished"] == 6


def test_one_chunk_tells_what_samples_cost_before_more_are_given_out(engine: Engine) -> None:
    sweep = run(engine, 0.3, 0.05, chunk_s=0.2, width=64, height=64)  # a range: 6.4 s
    assert sweep.done and sweep.counts["unfinished"] == 6
    assert sweep.budget.spent_s <= 0.3
    assert {job.spp for job in engine.list_jobs(sweep_id=sweep.id)} == {0}


@pytest.mark.slow
def test_cells_beyond_the_first_slice_get_their_turn(engine: Engine) -> None:
    axes = [{"pointer": "/value", "linspace": [1.0, 2.0, 262]}]
    budget = {"seconds": 600.0, "target_error": {"relmse": 0.6}}
    sweep = engine.submit_sweep({**BASE, "width": 8, "height": 8}, axes, budget=budget)
    sweep = engine.wait_sweep(sweep.id, 400)
    assert sweep.counts["succeeded"] == 262
