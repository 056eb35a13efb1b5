"""The report's plots: valid SVG, the same page as pixels, delta lobes and both sides shown."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

import matiere as mt
from matiere.canvas import Canvas
from matiere.stability.draw import draw_plots

SVG = "{http://www.w3.org/2000/svg}"


def words(svg: str) -> str:
    return " | ".join(node.text or "" for node in ET.fromstring(svg).iter(f"{SVG}text"))


def test_glass_is_drawn_from_both_sides() -> None:
    plots = mt.check({"type": "dielectric", "alpha": 0.2}).plots()
    assert set(plots) == {"albedo", "polar"}
    assert "outside" in words(plots["albedo"]) and "inside" in words(plots["albedo"])
    assert "degrees" in words(plots["albedo"]) and "/ sr" in words(plots["polar"])
    assert "180" in words(plots["polar"])


def test_delta_lobes_are_told() -> None:
    text = words(mt.check({"type": "plastic", "alpha": 0.0}).plots()["polar"])
    assert "delta reflected" in text and "180" not in text


@pytest.mark.parametrize("alpha", [1e-4, 0.1])
def test_a_narrow_lobe_is_met_by_the_curve(alpha: float) -> None:
    pages = draw_plots(mt.check({"type": "conductor", "metal": "Ag", "alpha": alpha}))
    d = 1 / (np.pi * alpha**2)  # D at its peak; f cos = F D / 4 for a viewer above
    label = next(x.text for x in pages["polar"].labels if x.text.startswith("viewer at 0 "))
    peak = float(label.split("peak ")[1].split()[0])
    assert peak == pytest.approx(d / 4, rel=0.1)


def test_files_are_written(tmp_path: Path) -> None:
    files = mt.check({"type": "lambert"}).save_plots(tmp_path / "new")
    assert sorted(f.name for f in files) == ["albedo.png", "albedo.svg", "polar.png", "polar.svg"]
    for file in files:
        if file.suffix == ".png":
            pixels = mt.read_image(file).pixels
            assert pixels.shape[2] == 3 and 0.8 < pixels.mean() < 0.999


def test_pixels_follow_the_lines() -> None:
    page = Canvas(40, 30)
    page.line([(5, 15), (35, 15)], "#ff0000", 4)
    page.line([(5, 5), (35, 5)], "#000000", 2, (4, 4))
    page.dot((20, 24), "#0000ff", 3)
    pixels = page.pixels(1.0)
    assert pixels.shape == (30, 40, 3)
    assert pixels[15, 20] == pytest.approx([1, 0, 0], abs=0.01)
    assert pixels[24, 20] == pytest.approx([0, 0, 1], abs=0.01)
    dashes = pixels[5, 6:34, 0] < 0.5
    assert dashes.sum() >= 12 and (~dashes).sum() >= 5
    assert pixels[10, 20] == pytest.approx([1, 1, 1])
