"""`matiere sweep` without a service: the same queue in the command's own process."""

from __future__ import annotations

import csv
import json
import signal
import time
from pathlib import Path

import psutil
import pytest
from serving import command, serve


@pytest.fixture
def sweep_file(tmp_path: Path) -> Path:
    """Write a sweep of 6 cells, each a fraction of a second."""
    scene = {"width": 16, "height": 16, "value": 1, "chunk_s": 0.02, "render": {"spp": 16}}
    axes = [{"pointer": "/value", "values": [0.1, 0.2, 0.3, 0.4, 0.5, 0.6], "label": "value"}]
    path = tmp_path / "sweep.json"
    path.write_text(json.dumps({"version": 1, "base": scene, "axes": axes, "columns": 3}))
    return path


def table(folder: Path) -> list[dict[str, str]]:
    """Read the table."""
    with (folder / "table.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def cells(folder: Path) -> int:
    """Count the cells whose image is there."""
    return len(list((folder / "cells").glob("*.png"))) if (folder / "cells").exists() else 0


@pytest.mark.slow
def test_killed_in_the_middle_the_same_command_finishes(tmp_path: Path, sweep_file: Path) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    arguments = ("sweep", sweep_file, "-o", out, "--data", data, "--children", 2)
    with command(*arguments) as first:
        end = time.monotonic() + 60
        while cells(out) < 2:
            assert time.monotonic() < end and first.process.poll() is None, first.output()
            time.sleep(0.01)
        children = psutil.Process(first.process.pid).children(recursive=True)
        first.process.send_signal(signal.SIGKILL)
        first.process.wait(10)
        _, alive = psutil.wait_procs(children, 10)
        assert not alive, "children outlived a killed command"
    done_before = cells(out)
    with command(*arguments) as second:
        said = second.output()
        assert second.process.wait(10) == 0, said
    assert "6/6 cells" in said and str(out / "contact-sheet.png") in said
    rows = table(out)
    assert [row["value"] for row in rows] == ["0.1", "0.2", "0.3", "0.4", "0.5", "0.6"]
    assert {row["state"] for row in rows} == {"succeeded"}
    assert cells(out) == 6
    for row in rows:
        report = json.loads((out / row["image"]).with_suffix(".json").read_text())
        assert report["min_count"] == report["max_count"] == int(row["spp"])
    assert not list(out.rglob("*.part"))
    print(f"{done_before} of 6 cells were done at the kill")


def test_while_one_sweep_holds_the_data_another_says_so(tmp_path: Path, sweep_file: Path) -> None:
    slow = json.loads(sweep_file.read_text())
    slow["base"]["chunk_s"] = 1.0
    sweep_file.write_text(json.dumps(slow))
    data = tmp_path / "data"
    with command("sweep", sweep_file, "-o", tmp_path / "a", "--data", data) as first:
        first.line("sweep: 6 cells")
        with command("sweep", sweep_file, "-o", tmp_path / "b", "--data", data) as second:
            said = second.output()
            assert second.process.wait(10) == 2
        assert str(first.process.pid) in said and str(data) in said
        assert "Traceback" not in said
        first.process.send_signal(signal.SIGINT)
        said = first.output()
        assert first.process.wait(20) == 130
        assert "the same command goes on from there" in said


def test_a_running_service_does_the_work(tmp_path: Path, sweep_file: Path) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    with serve(data, "--children", 2) as (serving, client):
        with command("sweep", sweep_file, "-o", out, "--data", data) as sweep:
            said = sweep.output()
            assert sweep.process.wait(30) == 0, said
        assert f"rendered by {serving.url}" in said
        assert len(list(client.jobs())) == 6
    assert cells(out) == 6


def test_a_sweep_with_a_budget_marks_what_it_left(tmp_path: Path, sweep_file: Path) -> None:
    asked = json.loads(sweep_file.read_text())
    del asked["base"]["render"]
    asked["axes"] = [{"pointer": "/hard", "values": [1, 200], "label": "hard"}]
    asked["base"]["hard"] = 1
    asked["budget"] = {"seconds": 1.0, "target_error": {"relmse": 0.3}}
    sweep_file.write_text(json.dumps(asked))
    out = tmp_path / "out"
    with command("sweep", sweep_file, "-o", out, "--data", tmp_path / "data") as run:
        said = run.output()
        assert run.process.wait(60) == 0, said
    assert "1 of 2 cells did not reach the target error within 1 s" in said
    assert "of 1 s spent" in said
    assert [row["state"] for row in table(out)] == ["succeeded", "unfinished"]
    assert [row["stop_reason"] for row in table(out)] == ["target_error", "budget"]
    assert all(float(row["relmse"]) > 0 for row in table(out)) and cells(out) == 2
    page = (out / "index.html").read_text()
    assert "unfinished" in page and "relMSE 0.3" in page and " of 1 s" in page
