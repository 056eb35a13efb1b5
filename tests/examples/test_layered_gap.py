"""The map of the gap between the methods of `layered`."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]


def _module(path: Path) -> Any:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module
    spec.loader.exec_module(module)
    return module


gap = _module(ROOT / "examples" / "make_layered_gap.py")


def test_the_one_pass_is_too_dark_by_what_bounces_again() -> None:
    """Smooth coat of 1.5 over white: the walk keeps all, one pass the table of the spec."""
    views = gap.compare(gap.coat({"type": "lambert", "albedo": 1.0}, 1.5, 0.0, 0.0), 20_000)
    assert [v.walk for v in views] == pytest.approx([1.0] * 4, abs=5e-3)
    assert views[0].one_pass == pytest.approx(0.428, abs=0.02)
    assert gap.class_of(gap.worst(views).gap)[2] == "beyond 20 %"


def test_an_opaque_coat_leaves_no_gap() -> None:
    views = gap.compare(gap.coat({"type": "lambert", "albedo": 1.0}, 1.5, 0.0, 50.0), 20_000)
    assert all(abs(v.one_pass - v.walk) < 5 * v.error + 2e-3 for v in views)


def test_the_committed_page_is_of_the_map() -> None:
    page = (ROOT / "docs" / "layered-gap.md").read_text(encoding="utf-8")
    cells = len(gap.ETAS) * len(gap.ALPHAS) * len(gap.TAUS)
    for name in gap.BASES:
        assert f"| {name} | {cells} |" in page and f"### {name}" in page
    assert (ROOT / "docs" / "images" / "layered-gap.svg").stat().st_size < 100_000


def test_one_material_prints_a_table(tmp_path: Path) -> None:
    path = tmp_path / "m.json"
    path.write_text(json.dumps(gap.coat({"type": "lambert"}, 1.3, 0.2, 0.5)), encoding="utf-8")
    command = [sys.executable, gap.__file__, str(path), "-n", "500"]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "one pass" in said and len(said.splitlines()) == 6
