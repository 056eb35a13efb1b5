"""The contact sheet: every cell is drawn, sized and labelled; nothing is hidden."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from matiere import contact_sheet, imageio
from matiere.drawtext import TextMark, draw_text, text_width


def solid(path: Path, color: tuple[float, ...], width: int = 40, height: int = 40) -> Path:
    """Write an image of one colour."""
    pixels = np.broadcast_to(np.asarray(color, np.float32), (height, width, len(color)))
    names = ("R", "G", "B", "A")[: len(color)]
    stored = imageio.Stored(imageio.quantise(pixels, 8), names, {})
    imageio.write_stored(path, stored, "uint8")
    return path


def decode(png: bytes, tmp_path: Path) -> npt.NDArray[np.float32]:
    """Return the pixels of PNG bytes."""
    path = tmp_path / "sheet-decoded.png"
    path.write_bytes(BytesIO(png).getvalue())
    return imageio.read_image(path).pixels


def cells_of(tmp_path: Path, count: int) -> list[dict[str, Any]]:
    """Return cells whose red value counts up."""
    return [
        {
            "image": solid(tmp_path / f"{i}.png", (0.21 + 0.1 * i, 0.5, 0.1)),
            "label": f"cell {i}",
            "sublabel": "relMSE 1e-3 [9e-4, 1.1e-3]\n2.0 s",
        }
        for i in range(count)
    ]


def test_every_cell_is_drawn_in_row_major_order(tmp_path: Path) -> None:
    sheet = decode(contact_sheet.make(cells_of(tmp_path, 6), 3, "six"), tmp_path)
    seen = []
    for i in range(6):
        wanted = np.float32(np.floor((0.21 + 0.1 * i) * 255 + 0.5) / 255)
        match = np.abs(sheet - np.array([wanted, 128 / 255, 26 / 255])).max(axis=2) < 0.003
        assert match.sum() == 40 * 40, f"cell {i}: {match.sum()} pixels"
        rows, columns = np.nonzero(match)
        seen.append((int(rows.min()), int(columns.min())))
    assert seen == sorted(seen)
    assert len({row for row, _ in seen}) == 2 and len({column for _, column in seen}) == 3


def test_text_is_drawn_under_each_cell(tmp_path: Path) -> None:
    cells = cells_of(tmp_path, 2)
    plain = [{"image": c["image"], "label": "", "sublabel": ""} for c in cells]
    with_text = decode(contact_sheet.make(cells, 2, "t"), tmp_path)
    without = decode(contact_sheet.make(plain, 2, "t"), tmp_path)
    assert with_text.shape[0] > without.shape[0] + 25
    assert (with_text.min(axis=2) > 0.6).sum() > (without.min(axis=2) > 0.6).sum() + 40


def test_a_cell_without_image_is_hatched_and_says_so(tmp_path: Path) -> None:
    cells = [{"image": None, "label": "broken", "sublabel": "failed: asset_changed"}]
    sheet = decode(contact_sheet.make(cells, 1, "failures", cell_width=96), tmp_path)
    warm = (sheet[..., 0] > 0.7) & (sheet[..., 2] < 0.6)
    assert warm.sum() > 20, "no warning text"
    hatch = np.abs(sheet - np.asarray(contact_sheet.HATCH)).max(axis=2) < 0.005
    assert hatch.sum() > 96 * 96 * 0.3


def test_headers_must_match_the_grid(tmp_path: Path) -> None:
    cells = cells_of(tmp_path, 4)
    with pytest.raises(ValueError, match="3 column headers for 2 columns"):
        contact_sheet.make(cells, 2, "x", column_headers=["a", "b", "c"])
    with pytest.raises(ValueError, match="1 row headers for 2 rows"):
        contact_sheet.make(cells, 2, "x", row_headers=["a"])
    with pytest.raises(ValueError, match="needs cells and columns"):
        contact_sheet.make([], 2, "x")


@pytest.mark.slow
def test_large_images_shrink_and_large_grids_stay_within_the_limit(tmp_path: Path) -> None:
    image = solid(tmp_path / "big.png", (0.3, 0.6, 0.9), 400, 200)
    sheet = decode(contact_sheet.make([{"image": image}] * 2, 2, "x", cell_width=100), tmp_path)
    blue = np.abs(sheet - np.array([77, 153, 230]) / 255).max(axis=2) < 0.006
    assert blue.sum() == 2 * 100 * 50, blue.sum()
    for columns, rows in ((60, 1), (1, 60), (200, 1)):
        cells = [{"image": image, "label": "a", "sublabel": "b\nc"}] * (columns * rows)
        many = decode(contact_sheet.make(cells, columns, "x"), tmp_path)
        assert max(many.shape) <= contact_sheet.MAX_EDGE, many.shape


def test_transparent_images_lie_over_the_panel(tmp_path: Path) -> None:
    image = solid(tmp_path / "clear.png", (1.0, 0.0, 0.0, 0.0))
    sheet = decode(contact_sheet.make([{"image": image}], 1, "x", cell_width=40), tmp_path)
    panel = np.abs(sheet - np.asarray(contact_sheet.PANEL)).max(axis=2) < 0.005
    assert panel.sum() == 40 * 40


def test_area_average_keeps_the_mean() -> None:
    rng = np.random.default_rng(1)
    image = rng.random((37, 53, 3)).astype(np.float32)
    small = contact_sheet.fit_inside(image, 20, 20)
    assert small.shape == (14, 20, 3)
    assert abs((small**2).mean() - (image**2).mean()) < 1e-3


def test_long_labels_are_cut_to_the_width() -> None:
    short = contact_sheet.shorten("a very long label that cannot fit below a picture", 90, 12)
    assert short.endswith("...") and text_width(short, 12) <= 90
    assert contact_sheet.shorten("fits", 90, 12) == "fits"


def test_numbers_shrink_before_they_are_cut() -> None:
    text = "relMSE 1.2e-05 (0.9e-05 to 1.5e-05)"
    size = contact_sheet.legible(text, 192, 12)
    assert text_width(text, size) <= 192 and contact_sheet.shorten(text, 192, size) == text
    assert contact_sheet.legible("x", 192, 12) == 12
    assert contact_sheet.legible(text, 10, 12) == contact_sheet.SMALLEST_TEXT


def test_characters_the_font_lacks_are_spelled_or_marked() -> None:
    blank = np.zeros((40, 200, 3), np.float32)

    def draw(text: str) -> npt.NDArray[np.float32]:
        return draw_text(blank, [TextMark((5, 25), text, 14, (1.0, 1.0, 1.0))])

    assert np.array_equal(draw("α 0.1"), draw("alpha 0.1"))
    assert np.array_equal(draw("\u91d1"), draw("?"))
    assert draw("x").sum() > 0.0
    assert draw("  ").sum() == 0.0
