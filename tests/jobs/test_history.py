"""What a job's log and its list of claims tell."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from conftest_jobs import SCENE

from matiere.jobs import Engine
from matiere.jobs.errors import JobNotFound

SMALL: dict[str, Any] = {"width": 8, "height": 8, "value": 1.0, "render": {"spp": 16}}


def test_a_crash_is_told_with_what_the_process_printed(engine: Engine, tmp_path: Path) -> None:
    crash = {"kind": "SIGSEGV", "chunk": 3, "once": str(tmp_path / "once")}
    other = engine.submit_job(SCENE | {"value": 2.0})
    job = engine.wait_job(engine.submit_job(SCENE | {"misdeed": crash}).id, 40)
    assert job.state.value == "succeeded"
    made = engine.attempts(job.id)
    tokens = [one.token for one in made]
    assert tokens == sorted(tokens) and len(set(tokens)) == len(tokens)
    failed = [one for one in made if one.error_class == "signal"]
    assert failed and "Segmentation fault" in failed[0].printed and failed[0].pid > 0
    assert all(one.ended is not None and one.ended >= one.started for one in made)
    text = engine.log(job.id, 2**16)
    assert "(signal): crashed with SIGSEGV" in text and "| Fatal Python error" in text
    lines = [line for line in text.splitlines() if not line.startswith("    ")]
    moments = [line.split()[0] for line in lines]
    assert moments == sorted(moments) and moments[0].endswith("Z")
    assert lines[0].endswith(" queued") and any(" succeeded" in line for line in lines[-3:])
    told = engine.log(job.id, 300)
    assert text.endswith(told) and 0 < len(told) <= 300
    engine.wait_job(other.id, 40)
    assert not set(tokens) & {one.token for one in engine.attempts(other.id)}
    assert [one.token for one in engine.attempts(job.id, after=tokens[0])] == tokens[1:]
    assert [one.token for one in engine.attempts(job.id, newest=True, limit=2)] == tokens[-2:]
    with pytest.raises(JobNotFound):
        engine.log("nobody", 100)


def test_what_a_good_process_prints_is_in_the_log_of_its_job_alone(engine: Engine) -> None:
    chatter = {"kind": "whisper", "chunk": 0}
    job = engine.wait_job(engine.submit_job(SCENE | {"misdeed": chatter}).id, 40)
    quiet = engine.wait_job(engine.submit_job(SCENE | {"value": 3.0}).id, 40)
    assert "| a strange  normal line" in engine.log(job.id, 2**16)
    assert "normal" not in engine.log(quiet.id, 2**16)


def test_cells_that_were_rendered_together_name_their_claim(engine: Engine) -> None:
    axes = [{"pointer": "/value", "linspace": [1, 6, 6], "label": "v"}]
    sweep = engine.wait_sweep(engine.submit_sweep(SMALL, axes).id, 40)
    for cell in engine.list_jobs(sweep_id=sweep.id):
        (claim,) = engine.attempts(cell.id)
        assert claim.films >= 1 and claim.chunks == 0 and claim.state == "merged"
        assert f"claim {claim.token} merged" in engine.log(cell.id, 2**16)
