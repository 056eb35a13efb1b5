"""Surfaces that let light straight through: exact means, by every strategy, at any depth."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render_build import render

from matiere import _core

SQUARE = np.array([[-5, -5, 0], [5, -5, 0], [5, 5, 0], [-5, 5, 0]], float)
TRIANGLES = [[0, 1, 2], [0, 2, 3]]
UV = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)


def view() -> Any:
    d = _core.RenderDescription()
    d.set_film(4, 4, "box")
    d.set_camera("pinhole", (0.01, 0.02, 8), (0.01, 0.02, 0), (0, 1, 0), 1)
    return d


def sheet(d: Any, z: float, m: int) -> None:
    d.add_mesh(SQUARE + np.array([0, 0, z]), TRIANGLES, uv=UV, material=m)


def measured(d: Any, **more: Any) -> tuple[np.ndarray, np.ndarray]:
    image, _ = render(_core.Scene(d), **more)
    return image.mean((0, 1)), image.reshape(-1, 3).std(0, ddof=1) / 4


def close(got: tuple[np.ndarray, np.ndarray], expected: float) -> None:
    mean, error = got
    assert np.all(np.abs(mean - expected) < 4.5 * error + 1e-5), (mean, expected, error)


@pytest.mark.parametrize("max_depth", [0, 3])
def test_black_sheets_pass_what_opacity_leaves(max_depth: int) -> None:
    """Passing is no event: it happens at max_depth 0 too, and each sheet decides for itself."""
    d = view()
    d.set_constant_environment((1, 1, 1))
    black = d.add_material("lambert", {"albedo": 0.0}, opacity=0.5)
    for z in (0.0, -1.0, -2.0):
        sheet(d, z, black)
    close(measured(d, spp=4096, max_depth=max_depth), 0.125)


@pytest.mark.parametrize("strategy", ["mis", "light", "bsdf"])
def test_light_reaches_a_floor_through_sheets(strategy: str) -> None:
    """Irradiance of a rectangle through two sheets: direct and shadowed paths agree."""
    d = view()
    floor = d.add_material("lambert", {"albedo": 0.8})
    black = d.add_material("lambert", {"albedo": 0.0}, opacity=0.4)
    veil = d.add_material(
        "mix", {"a": {"type": "null"}, "b": {"type": "lambert", "albedo": 0.0}, "weight": 0.3}
    )
    sheet(d, 0, floor)
    d.set_camera("pinhole", (0.01, 0.02, 0.5), (0.01, 0.02, 0), (0, 1, 0), 1)
    sheet(d, 1.0, black)
    sheet(d, 1.5, veil)
    d.add_rectangle_light((-20, -20, 2), (0, 40, 0), (40, 0, 0), (1, 1, 1))
    plain = view()
    plain.set_camera("pinhole", (0.01, 0.02, 0.5), (0.01, 0.02, 0), (0, 1, 0), 1)
    sheet(plain, 0, plain.add_material("lambert", {"albedo": 0.8}))
    plain.add_rectangle_light((-20, -20, 2), (0, 40, 0), (40, 0, 0), (1, 1, 1))
    through, error = measured(d, spp=8192, strategy=strategy, max_depth=1)
    bare, bare_error = measured(plain, spp=8192, strategy=strategy, max_depth=1)
    # Sheets 10 m wide at 1 m cut off some of the slant light: compare inside their shadow only.
    beyond = _beyond()
    expected = bare * (beyond + (1 - beyond) * 0.6 * 0.7)
    slack = 4.5 * np.hypot(error, bare_error) + 0.02 * bare
    assert np.all(np.abs(through - expected) < slack), (through, expected, error)


def _beyond() -> float:
    """Return the share of the light's cosine-weighted directions that miss both sheets."""
    x, y = np.meshgrid(*[np.linspace(-20, 20, 1001)] * 2)
    w = 1 / (x**2 + y**2 + 4) ** 2
    low = np.maximum(np.abs(x), np.abs(y)) / 2 < 5
    return float(w[~low].sum() / w.sum())


def test_a_mask_cuts_a_hole() -> None:
    d = view()
    d.set_constant_environment((1, 1, 1))
    mask = d.add_texture(np.array([[[0.0] * 3, [1.0] * 3]], np.float32), "clamp")
    m = d.add_material("lambert", {"albedo": 0.0}, opacity=("texture", mask))
    sheet(d, 0, m)
    d.set_film(8, 2, "box")
    d.set_camera("pinhole", (0.0, 0.02, 8), (0.0, 0.02, 0), (0, 1, 0), 15)
    image, _ = render(_core.Scene(d), spp=64, width=8, height=2)
    columns = image.mean((0, 2))
    assert columns[0] > 0.95 and columns[-1] < 0.05


def test_half_transparent_glass_keeps_its_inside() -> None:
    """A pass through the surface of a medium still enters it: absorption, no unmatched exits."""
    d = view()
    d.set_constant_environment((1, 1, 1))
    glass = d.add_material("dielectric", {"eta": 1.0, "sigma_a": 0.35}, opacity=0.5)
    d.add_sphere((0.01, 0.02, 0), 1.0, glass)
    mean, error = measured(d, spp=256)
    assert mean == pytest.approx([np.exp(-0.7)] * 3, rel=2e-3), (mean, error)
