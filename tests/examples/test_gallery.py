"""The gallery: every sheet small, the page made of the sweeps, each picture that it names there."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import matiere as mt

ROOT = Path(__file__).resolve().parents[2]
SHEETS = ROOT / "docs" / "images" / "gallery"


@pytest.fixture(scope="module")
def gallery(example: Callable[[str], ModuleType]) -> ModuleType:
    """Return the script."""
    return example("gallery.py")


def test_sheets_are_shrunk_to_the_limit(gallery: ModuleType, tmp_path: Path) -> None:
    noise = np.random.default_rng(1).random((260, 360, 3), dtype=np.float32)
    mt.write_image(tmp_path / "sheet.png", noise * 0.5)
    size = gallery.shrink(tmp_path / "sheet.png", tmp_path / "new" / "sheet.jpg")
    assert size == (tmp_path / "new" / "sheet.jpg").stat().st_size <= gallery.MAX_BYTES
    back = mt.read_image(tmp_path / "new" / "sheet.jpg").pixels
    assert back.shape == noise.shape and back.mean() == pytest.approx(0.25, abs=0.02)


def test_the_page_shows_every_sweep_in_the_order_of_the_models(gallery: ModuleType) -> None:
    found = gallery.sweeps()
    text = gallery.page(found)
    heads = re.findall(r"^## (\w+)$", text, re.M)
    assert heads == [path.stem for path in found]
    order = [row["type"] for row in mt.materials()]
    models = [head for head in heads if head in order]
    assert models == sorted(models, key=order.index)
    for path in found:
        assert f"(images/gallery/{path.stem}.jpg)" in text


def test_an_unknown_sweep_is_refused(gallery: ModuleType) -> None:
    with pytest.raises(SystemExit, match="wood"):
        gallery.sweeps(["wood"])


def test_committed_sheets_are_small_and_of_sweeps_that_exist() -> None:
    for sheet in SHEETS.glob("*"):
        assert sheet.stat().st_size <= 60_000, sheet
        assert (ROOT / "examples" / "materials" / f"{sheet.stem}.json").exists(), sheet
