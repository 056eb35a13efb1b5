"""The demo: its sweep, its progress figures, its summary, and one small run of the whole."""

from __future__ import annotations

import copy
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import matiere as mt
from matiere.service.client import JobStatus
from matiere.service.lockfile import read_announcement

ROOT = Path(__file__).resolve().parents[2]
FILES_OF_A_CELL = 4


@pytest.fixture(scope="module")
def demo() -> Iterator[ModuleType]:
    """Return examples/demo.py with the modules beside it."""
    sys.path.insert(0, str(ROOT / "examples"))
    try:
        import demo as module

        yield module
    finally:
        sys.path.remove(str(ROOT / "examples"))


@pytest.fixture(scope="module")
def study(demo: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the demo's own study at 16 pixels."""
    return demo.demo_sweep.own_study(tmp_path_factory.mktemp("study"), 16, 4)


def job(**changes: Any) -> JobStatus:
    """Return a job of 10 x 10 pixels that wants 64 spp."""
    facts = {"id": "x", "state": "running", "width": 10, "height": 10, "spp": 16}
    stop = {"spp": 64, "seconds": None, "target_error": None}
    return JobStatus(**{**facts, "stop": stop, "progress": 0.25, "seconds": 1.0, **changes})


def test_sweep_has_24_valid_cells(demo: ModuleType, study: Any) -> None:
    axes = demo.demo_sweep.axes(64, study.glass_file)
    assert [len(axis["values"]) for axis in axes] == [24] * len(axes)
    scene = copy.deepcopy(study.base)
    for i in range(24):
        scene["materials"]["ball"] = axes[0]["values"][i]
        scene["render"]["spp"] = axes[1]["values"][i]
        scene["shapes"][0]["file"] = axes[2]["values"][i]
        assert mt.load(scene, asset_root=study.folder).model.render.spp >= 64
    kinds = [value.get("metal", value["type"]) for value in axes[0]["values"]]
    assert len({kind for kind in kinds if kind in mt.metals()}) >= 3
    assert {"plastic", "dielectric"} <= set(kinds)
    assert len({value["alpha"] for value in axes[0]["values"]}) == 4


def test_progress_counts_samples_not_cells(demo: ModuleType) -> None:
    waiting = job(state="queued", spp=0)
    early = job(state="succeeded", spp=32)  # reached its target before its cap
    assert demo.samples([job(), waiting]) == (1600, 12800)
    assert demo.samples([early, waiting]) == (6400, 12800)
    assert demo.samples([]) == (0, 0)


def test_slugs_are_file_names(demo: ModuleType) -> None:
    assert demo.demo_report.slug("Gold, alpha 0.02") == "gold-alpha-0.02"
    assert demo.demo_report.slug("../../etc") == "etc"
    assert demo.demo_report.slug("\u91d1") == "cell"


def test_a_service_that_cannot_start_says_why(demo: ModuleType, tmp_path: Path) -> None:
    blocked = tmp_path / "data"
    blocked.write_text("a file where a folder should be")
    with (
        pytest.raises(SystemExit, match="`matiere serve` ended with code"),
        demo.service(blocked, tmp_path / "serve.log", 1),
    ):
        pass


def run_demo(out: Path, *more: str) -> str:
    """Run the demo small and return what it printed."""
    command = [sys.executable, str(ROOT / "examples" / "demo.py"), "--out", str(out)]
    command += ["--size", "16", "--spp", "4", "--children", "1", *more]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=300, check=False, env=dict(os.environ)
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
def test_demo_runs_end_to_end_and_again_from_the_store(tmp_path: Path) -> None:
    out = tmp_path / "demo-out"
    first = run_demo(out)
    cells = sorted((out / "cells").iterdir())
    assert len(cells) == 24 * FILES_OF_A_CELL, [path.name for path in cells]
    assert all(path.stat().st_size > 0 for path in cells)
    for name in ("contact-sheet.png", "error-against-time.svg", "report.html", "report.json"):
        assert (out / name).stat().st_size > 0
        assert str(out / name) in first.replace("\n", "")
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert [cell["state"] for cell in report["cells"]] == ["succeeded"] * 24
    assert all(cell["relmse"] > 0.0 and cell["seconds"] > 0.0 for cell in report["cells"])
    images = {p.name: p.read_bytes() for p in cells if p.suffix == ".exr"}
    again = run_demo(out)
    assert "24 from the store" in again, again
    assert all((out / "cells" / name).read_bytes() == data for name, data in images.items())
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.count("<tr>") == 25


@pytest.mark.slow
def test_a_terminated_demo_stops_its_service(tmp_path: Path) -> None:
    out = tmp_path / "demo-out"
    command = [sys.executable, str(ROOT / "examples" / "demo.py"), "--out", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    deadline = time.monotonic() + 120
    found = None
    while found is None and time.monotonic() < deadline:
        time.sleep(0.2)
        found = read_announcement(out / "data")
    assert found is not None, "the service did not start"
    process.terminate()
    said, _ = process.communicate(timeout=120)
    assert process.returncode == 1 and "run ./dev demo again to go on" in said, said
    assert read_announcement(out / "data") is None, "the service is still there"
