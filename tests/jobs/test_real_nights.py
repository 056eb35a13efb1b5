"""Nights of real renders: from the queue's cells to the comparison, restarts and cached cells."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from matiere.jobs import open_engine
from matiere.jobs.errors import NotReadyYet

ROOT = Path(__file__).resolve().parents[2]
AXES = [{"pointer": "/materials/ball/alpha", "values": [0.1, 0.3], "label": "alpha"}]


def scene(seed: int = 1, floor: float = 0.35) -> dict[str, Any]:
    """Return a small scene."""
    base: dict[str, Any] = json.loads((ROOT / "examples/scenes/first.json").read_text())
    base["film"] = {"width": 16, "height": 16}
    base["render"] = {"spp": 16, "seed": seed}
    base["materials"]["floor"]["albedo"] = floor
    return base


def sweep(engine: Any, base: dict[str, Any]) -> str:
    """Run a sweep to its end and return its id."""
    found = engine.wait_sweep(engine.submit_sweep(base, AXES, label="night").id, 120)
    assert found.counts["succeeded"] == 2 and found.finished is not None, found
    return str(found.id)


def test_nights_outlive_a_restart_and_tell_what_changed(tmp_path: Path) -> None:
    with open_engine(tmp_path, children=1, min_free_bytes=0) as engine:
        first = sweep(engine, scene())
        again = sweep(engine, scene())
        assert all(job.cached for job in engine.list_jobs(sweep_id=again))
        other = sweep(engine, scene(floor=0.37))
        noisy = sweep(engine, scene(seed=2))
    with open_engine(tmp_path, children=1, min_free_bytes=0) as engine:
        same = engine.compare_sweeps(first, again)
        assert same["cells"]["identical"] == 2 and same["exit_code"] == 0
        changed = engine.compare_sweeps(first, other)
        assert changed["cells"]["changed"] == 2 and changed["cells"]["paired"] == 2
        assert changed["changes"][0]["percent"] > 0
        quiet = engine.compare_sweeps(first, noisy)
        assert quiet["exit_code"] == 0 and quiet["cells"]["paired"] == 0
        head, pages = engine.night(first)
        assert head["name"] == "night" and len(pages) == 1 and Path(pages[0].path).exists()


def test_an_unfinished_sweep_has_no_night_yet(tmp_path: Path) -> None:
    with open_engine(tmp_path, children=1, min_free_bytes=0) as engine:
        base = scene()
        base["render"]["spp"] = 2**20
        sweep_id = engine.submit_sweep(base, AXES).id
        with pytest.raises(NotReadyYet):
            engine.night(sweep_id)
        engine.cancel_sweep(sweep_id)
        engine.wait_sweep(sweep_id, 60)
        found = engine.compare_sweeps(sweep_id, sweep_id)
        assert found["exit_code"] == 3 and found["cells"]["failed"] == 2


def test_cells_queued_again_make_the_night_anew(tmp_path: Path) -> None:
    with open_engine(tmp_path, children=1, min_free_bytes=0) as engine:
        good = sweep(engine, scene())
        base = scene(floor=0.37)
        sweep_id = engine.submit_sweep(base, AXES).id
        engine.cancel_sweep(sweep_id)
        engine.wait_sweep(sweep_id, 60)
        assert engine.compare_sweeps(good, sweep_id)["cells"]["failed"] == 2
        engine.requeue_sweep(sweep_id)
        with pytest.raises(NotReadyYet):
            engine.night(sweep_id)
        engine.wait_sweep(sweep_id, 60)
        assert engine.compare_sweeps(good, sweep_id)["cells"]["changed"] == 2
