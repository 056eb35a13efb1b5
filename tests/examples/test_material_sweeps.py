"""One sweep per material: every cell is a scene that loads."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import matiere as mt
from matiere.jobs.sweep import expand, parse_axes

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "materials"
SWEEPS = sorted(FOLDER.glob("*.json"))


@pytest.fixture(scope="module")
def stage(example: Callable[[str], ModuleType], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the stage and return its scene."""
    folder = tmp_path_factory.mktemp("stage")
    made: Path = example("make_material_stage.py").write(folder, 16, 4)
    (folder / "measured").mkdir()
    for name in example("make_measured.py").TABLES:  # loading asks only that a file is there
        (folder / "measured" / f"{name}.binary").touch()
    return made


def cells(sweep: dict[str, Any], stage: Path) -> list[dict[str, Any]]:
    """Return the scenes of a sweep."""
    base = json.loads(stage.read_text(encoding="utf-8"))
    mode = sweep.get("mode", "grid")
    return [cell.scene for cell in expand(base, parse_axes(sweep["axes"], base, mode), mode)]


@pytest.mark.parametrize("path", SWEEPS, ids=lambda p: p.stem)
def test_every_cell_of_a_material_sweep_loads(path: Path, stage: Path) -> None:
    sweep = json.loads(path.read_text(encoding="utf-8"))
    assert sweep["base"] == "stage/ball.json"
    found = cells(sweep, stage)
    assert len(found) >= 4
    for scene in found:
        mt.load(scene, asset_root=stage.parent)
    types = {scene["materials"]["ball"]["type"] for scene in found}
    assert path.stem in types, f"{path.name} must show {path.stem}, shows {types}"


def test_every_model_has_a_sweep() -> None:
    """`null` is shown in the sweep of `mix`."""
    assert {p.stem for p in SWEEPS} == {m["type"] for m in mt.materials()} - {"null"}
