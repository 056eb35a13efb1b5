"""Material checks in the utility child: one at a time, within a limit, and nothing else suffers."""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path
from typing import Any

import pytest
from conftest_jobs import SCENE

from matiere.errors import SceneValidationError
from matiere.jobs import utility_queue
from matiere.jobs.engine import Engine, open_engine
from matiere.jobs.errors import Busy, JobsError


def test_a_report_comes_back(engine: Engine) -> None:
    report = engine.check_material({"type": "good"}, seed=3)
    assert report == {"verdict": "pass", "material": {"type": "good"}, "seed": 3}


def test_one_check_at_a_time(engine: Engine) -> None:
    first = threading.Thread(target=engine.check_material, args=({"type": "slow", "seconds": 1.5},))
    first.start()
    busy = 0
    while first.is_alive():
        try:
            engine.check_material({"type": "good"})
        except Busy:
            busy += 1
            first.join(0.05)
    assert busy > 3
    assert engine.check_material({"type": "good"})["verdict"] == "pass"


def test_a_check_that_takes_too_long_is_ended(
    engine: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(utility_queue.LIMIT_S, utility_queue.STABILITY, 0.5)
    with pytest.raises(Busy, match="took longer than"):
        engine.check_material({"type": "slow", "seconds": 1e6})
    monkeypatch.setitem(utility_queue.LIMIT_S, utility_queue.STABILITY, 5.0)
    assert engine.check_material({"type": "good"})["verdict"] == "pass"
    job = engine.submit_job(SCENE)
    assert engine.wait_job(job.id, 30).state == "succeeded"


def test_a_crash_is_told_once(engine: Engine) -> None:
    with pytest.raises(JobsError, match="SIGSEGV") as caught:
        engine.check_material({"type": "crash"})
    assert caught.value.code == "signal"
    assert engine.check_material({"type": "good"})["verdict"] == "pass"


def checked(engine: Engine, material: dict[str, Any], **options: Any) -> dict[str, Any]:
    """Check a material, asking again while a loaded machine has no time for it."""
    for _ in range(9):
        with contextlib.suppress(Busy):
            return engine.check_material(material, **options)
    return engine.check_material(material, **options)


@pytest.mark.slow
def test_a_real_material_is_checked_and_a_wrong_one_refused(tmp_path: Path) -> None:
    with open_engine(tmp_path / "data", children=1) as real:
        report = checked(real, {"type": "plastic", "alpha": 0.0}, plots=True)
        assert report["verdict"] == "pass" and report["limits"][0]["pointer"] == "/alpha"
        assert report["plots"]["polar"].startswith("<svg")
        with pytest.raises(SceneValidationError) as caught:
            checked(real, {"type": "plastic", "alpha": 2})
        assert caught.value.errors[0]["pointer"] == "/alpha"
