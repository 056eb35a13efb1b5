"""`matiere sweep` through a service whose queue is in memory: files, table, plot, resuming."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import httpx
import pytest
from fake_engine import FakeEngine
from test_client_and_submit import finish_soon, run

from matiere.errors import SceneValidationError
from matiere.jobs.job import JobState
from matiere.service.sweepfile import load_sweep

AXES = [{"pointer": "/materials/a/alpha", "values": [0.1, 0.2, 0.3]}]
LOG = [
    {"spp": 4, "wall_s": 0.1, "relmse": 0.1, "lower": 0.08, "upper": 0.12},
    {"spp": 8, "wall_s": 0.2, "relmse": 0.05, "lower": 0.04, "upper": 0.06},
    {"spp": 16, "wall_s": 0.4, "relmse": None, "lower": None, "upper": None},
]


@pytest.fixture(autouse=True)
def reports(engine: FakeEngine, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the queue in memory answer with reports."""
    make = engine._file

    def with_report(kind: str, text: str) -> Any:
        return make(kind, json.dumps({"log": LOG, "of": text}) if kind == "report.json" else text)

    monkeypatch.setattr(engine, "_file", with_report)


@pytest.fixture
def sweep_file(tmp_path: Path) -> Path:
    """Write a sweep file and its base scene."""
    scene = {"version": 1, "render": {"spp": 4, "seed": 1}, "materials": {"a": {"alpha": 1}}}
    (tmp_path / "base.json").write_text(json.dumps(scene))
    path = tmp_path / "alpha.json"
    path.write_text(json.dumps({"version": 1, "base": "base.json", "axes": AXES}))
    return path


def rows(folder: Path) -> list[dict[str, str]]:
    """Read the table."""
    with (folder / "table.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_a_sweep_fills_its_folder(
    capsys: pytest.CaptureFixture[str], engine: FakeEngine, url: str, sweep_file: Path
) -> None:
    finish_soon(engine)
    out = sweep_file.parent / "out"
    code, said, err = run(capsys, "sweep", sweep_file, "-o", out, "--url", url)
    assert code == 0, err
    cells = sorted(path.name for path in (out / "cells").iterdir())
    stems = ["0000_0.1", "0001_0.2", "0002_0.3"]
    endings = (".exr", ".json", ".png", ".svg")
    assert cells == [stem + ending for stem in stems for ending in endings]
    assert (out / "contact-sheet.png").exists()
    assert "<svg" in (out / "error-vs-time.svg").read_text()[:1000]
    table = rows(out)
    assert [row["x"] for row in table] == ["0.1", "0.2", "0.3"]
    assert [row["image"] for row in table] == [f"cells/{stem}.png" for stem in stems]
    assert {row["state"] for row in table} == {"succeeded"}
    assert str(out / "contact-sheet.png") in said and "3/3 cells" in err
    left = [path for path in out.rglob("*") if ".part" in path.name]
    assert not left


def test_the_same_command_again_asks_for_nothing_new(
    capsys: pytest.CaptureFixture[str], engine: FakeEngine, url: str, sweep_file: Path
) -> None:
    finish_soon(engine)
    out = sweep_file.parent / "out"
    run(capsys, "sweep", sweep_file, "-o", out, "--url", url)
    stamp = (out / "cells" / "0000_0.1.png").stat().st_mtime_ns
    (out / "cells" / "0001_0.2.exr").unlink()
    code, _, err = run(capsys, "sweep", sweep_file, "-o", out, "--url", url)
    assert code == 0, err
    assert len(engine.sweeps) == 1 and engine.submissions == 3
    assert (out / "cells" / "0000_0.1.png").stat().st_mtime_ns == stamp
    assert (out / "cells" / "0001_0.2.exr").exists()


def test_a_changed_sweep_replaces_the_old_files_and_no_others(
    capsys: pytest.CaptureFixture[str], engine: FakeEngine, url: str, sweep_file: Path
) -> None:
    finish_soon(engine)
    out = sweep_file.parent / "out"
    run(capsys, "sweep", sweep_file, "-o", out, "--url", url)
    (out / "cells" / "mine.txt").write_text("keep")
    document = json.loads(sweep_file.read_text())
    document["axes"][0]["values"] = [0.5]
    sweep_file.write_text(json.dumps(document))
    code, _, err = run(capsys, "sweep", sweep_file, "-o", out, "--url", url)
    assert code == 0, err
    names = sorted(path.name for path in (out / "cells").iterdir())
    assert names == ["0000_0.5.exr", "0000_0.5.json", "0000_0.5.png", "0000_0.5.svg", "mine.txt"]


def test_failed_cells_are_told_and_tried_again(
    capsys: pytest.CaptureFixture[str], engine: FakeEngine, url: str, sweep_file: Path
) -> None:
    out = sweep_file.parent / "out"
    httpx.get(url + "/healthz")
    original = engine.submit_sweep

    def submit(*args: Any, **more: Any) -> Any:
        sweep = original(*args, **more)
        for job in list(engine.jobs.values()):
            if not job.state.final:
                bad = job.cell == 1 and len(engine.sweeps) == 1
                engine.finish(job.id, JobState.FAILED if bad else JobState.SUCCEEDED)
        return engine.get_sweep(sweep.id)

    engine.submit_sweep = submit  # type: ignore[method-assign]
    code, _, err = run(capsys, "sweep", sweep_file, "-o", out, "--url", url)
    assert code == 1
    assert "crashed 3 times" in err and "1 failed" in err
    assert [row["state"] for row in rows(out)] == ["succeeded", "failed", "succeeded"]
    assert rows(out)[1]["error"] == "the child crashed 3 times"
    code, _, err = run(capsys, "sweep", sweep_file, "-o", out, "--url", url)
    assert code == 0 and len(engine.sweeps) == 2, err
    assert {row["state"] for row in rows(out)} == {"succeeded"}


def test_whole_materials_are_named_by_their_label(
    capsys: pytest.CaptureFixture[str], engine: FakeEngine, url: str, sweep_file: Path
) -> None:
    finish_soon(engine)
    document = json.loads(sweep_file.read_text())
    values = [{"type": "conductor", "metal": "Au"}, {"type": "lambert"}]
    document["axes"] = [{"pointer": "/materials/a", "values": values, "labels": ["gold", "grey"]}]
    sweep_file.write_text(json.dumps(document))
    out = sweep_file.parent / "out"
    code, _, err = run(capsys, "sweep", sweep_file, "-o", out, "--url", url)
    assert code == 0, err
    assert [row["x"] for row in rows(out)] == ["gold", "grey"]


def test_a_sweep_file_in_the_output_folder_stays(
    capsys: pytest.CaptureFixture[str], engine: FakeEngine, url: str, sweep_file: Path
) -> None:
    finish_soon(engine)
    path = sweep_file.rename(sweep_file.with_name("sweep.json"))
    before = path.read_text()
    for _ in range(2):
        code, _, err = run(capsys, "sweep", path, "-o", path.parent, "--url", url)
        assert code == 0, err
    assert path.read_text() == before and (path.parent / "base.json").exists()


def test_a_state_file_cannot_make_us_remove_other_files(
    capsys: pytest.CaptureFixture[str], engine: FakeEngine, url: str, sweep_file: Path
) -> None:
    finish_soon(engine)
    out = sweep_file.parent / "out"
    out.mkdir()
    names = ["../base.json", "cells/../../base.json", str(sweep_file.parent / "base.json"), ".."]
    state = {"version": 1, "sweep": "x", "digest": "y", "fetched": {}, "files": names}
    (out / ".matiere-sweep.json").write_text(json.dumps(state))
    code, _, err = run(capsys, "sweep", sweep_file, "-o", out, "--url", url)
    assert code == 0, err
    assert (sweep_file.parent / "base.json").exists()


@pytest.mark.parametrize("where", ["file", "file/below"])
def test_a_folder_that_cannot_be_is_said_before_any_work(
    capsys: pytest.CaptureFixture[str],
    engine: FakeEngine,
    url: str,
    sweep_file: Path,
    where: str,
) -> None:
    (sweep_file.parent / "file").write_text("x")
    out = sweep_file.parent / where
    code, _, err = run(capsys, "sweep", sweep_file, "-o", out, "--url", url)
    assert code == 2 and "cannot be written" in err and not engine.sweeps
    scene = sweep_file.parent / "base.json"
    code, _, err = run(capsys, "submit", scene, "-o", out / "x.png", "--url", url)
    assert code == 2 and "cannot be written" in err and not engine.jobs


def test_render_overrides_are_laid_over_the_base(sweep_file: Path) -> None:
    document = json.loads(sweep_file.read_text())
    sweep_file.write_text(json.dumps({**document, "render": {"spp": 64}, "columns": 2}))
    loaded = load_sweep(sweep_file)
    assert loaded.base["render"] == {"spp": 64, "seed": 1}
    assert (loaded.columns, loaded.mode, loaded.label) == (2, "grid", "alpha")


@pytest.mark.parametrize(
    ("change", "pointer", "words"),
    [
        ({"version": 2}, "/version", "1"),
        ({"axes": []}, "/axes", "1 to 16 axes"),
        ({"axes": [{"pointer": "/a"}]}, "/axes/0", "exactly one of"),
        (
            {"axes": [{"pointer": "/a", "values": [1], "linspace": [0, 1, 2]}]},
            "/axes/0",
            "not values",
        ),
        ({"axes": [{"pointer": "/a", "linspace": [0, 1]}]}, "/axes/0/linspace/2", "required"),
        ({"axes": [{"pointr": "/a", "values": [1]}]}, "/axes/0/pointer", "required"),
        ({"base": "none.json"}, "/base", "none.json"),
        ({"base": 3}, "/base", ""),
        ({"mode": "zigzag"}, "/mode", "grid"),
        ({"colums": 3}, "/colums", ""),
    ],
)
def test_a_bad_sweep_file_is_told_with_a_pointer(
    capsys: pytest.CaptureFixture[str],
    engine: FakeEngine,
    url: str,
    sweep_file: Path,
    change: dict[str, Any],
    pointer: str,
    words: str,
) -> None:
    sweep_file.write_text(json.dumps({**json.loads(sweep_file.read_text()), **change}))
    with pytest.raises(SceneValidationError) as caught:
        load_sweep(sweep_file)
    assert any(f.pointer == pointer or f.pointer.startswith(pointer) for f in caught.value.faults)
    assert words in str(caught.value)
    out = sweep_file.parent / "out"
    code, _, err = run(capsys, "sweep", sweep_file, "-o", out, "--url", url)
    assert code == 2 and f"{sweep_file}: {pointer}" in err
    assert not out.exists() and not engine.sweeps


def test_errors_of_the_service_point_into_the_sweep_file(
    capsys: pytest.CaptureFixture[str], engine: FakeEngine, url: str, sweep_file: Path
) -> None:
    document = json.loads(sweep_file.read_text())
    document["axes"][0]["pointer"] = "/nowhere"
    sweep_file.write_text(json.dumps(document))
    out = sweep_file.parent / "out"
    code, _, err = run(capsys, "sweep", sweep_file, "-o", out, "--url", url)
    assert (code, err.strip()) == (2, f"{sweep_file}: /axes/0/pointer: no such value")
    assert not out.exists()
