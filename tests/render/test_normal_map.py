"""Normal and bump maps: which way a mapped surface faces, and what happens at its horizon."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render_build import render

from matiere import _core

SQUARE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
TRIANGLES = [[0, 1, 2], [0, 2, 3]]
UV = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
SUN = 0.7  # irradiance facing it


def brightness(
    maps: dict[str, Any],
    sun: tuple[float, float, float],
    pixels: Any,
    uv: np.ndarray = UV,
    scale: float = 1.0,
    side: float = 1.0,
) -> float:
    """Return the radiance over albedo / pi of the middle of a square facing +z, lit by a sun."""
    d = _core.RenderDescription()
    d.set_film(2, 2, "box")
    d.set_camera("pinhole", (0, 0, 5 * scale * side), (0, 0, 0), (0, 1, 0), 1)
    texture = d.add_texture(np.asarray(pixels, np.float32), "repeat")
    named = {k: texture if k != "bump_height" else v for k, v in maps.items()}
    m = d.add_material("lambert", {"albedo": 1.0}, maps=named)
    d.add_mesh(SQUARE * scale, TRIANGLES, uv=uv, material=m)
    d.add_directional_light(tuple(-np.array(sun)), (SUN, SUN, SUN))
    image, _ = render(_core.Scene(d), spp=4, width=2, height=2, max_depth=1)
    return float(image.mean() * np.pi / SUN)


def unit(*v: float) -> np.ndarray:
    return np.array(v) / np.linalg.norm(v)


def encoded(n: Any) -> np.ndarray:
    return np.full((1, 1, 3), (np.asarray(n) + 1) / 2)


@pytest.mark.parametrize("n", [unit(0, 0, 1), unit(0.4, 0, 1), unit(0, 0.4, 1), unit(0.3, -0.5, 1)])
def test_a_normal_map_turns_the_surface(n: np.ndarray) -> None:
    sun = unit(0.3, 0.2, 1)
    got = brightness({"normal_map": 0}, tuple(sun), encoded(n))
    assert got == pytest.approx(float(n @ sun), rel=1e-4)


def test_mirrored_and_turned_uv_turn_the_map_along() -> None:
    n, sun = unit(0.4, 0.2, 1), unit(0.3, 0.5, 1)
    mirrored = UV * (-1, 1)  # u runs against x
    got = brightness({"normal_map": 0}, tuple(sun), encoded(n), mirrored)
    assert got == pytest.approx(float((n * (-1, 1, 1)) @ sun), rel=1e-4)
    turned = UV[:, ::-1] * (1, -1)  # u runs along y, v against x
    got = brightness({"normal_map": 0}, tuple(sun), encoded(n), turned)
    assert got == pytest.approx(float(np.array([-n[1], n[0], n[2]]) @ sun), rel=1e-4)


def ramp(columns: int = 64) -> np.ndarray:
    return np.repeat(np.linspace(0, 1, columns)[None, :, None], 3, axis=2)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("height", [0.5, -0.5])
def test_a_bump_ramp_is_a_slope(scale: float, height: float) -> None:
    """Height rises by `height` over the 2 m of u: the normal of that plane, at any scale."""
    sun = unit(0.5, 0.1, 1)
    slope = height / 2 * (64 / 63)  # of the ramp between texel centres
    n = unit(-slope, 0, 1)
    maps = {"bump_map": 0, "bump_height": height * scale}
    got = brightness(maps, tuple(sun), ramp(), scale=scale)
    assert got == pytest.approx(float(n @ sun), rel=1e-3)


def test_the_back_shows_the_same_relief() -> None:
    """Seen from behind a dent is a bump: the mapped normal is turned over as a whole."""
    n, sun = unit(0.4, 0.0, 1), unit(0.3, 0.0, -1)
    got = brightness({"normal_map": 0}, tuple(sun), encoded(n), side=-1.0)
    assert got == pytest.approx(float(-n @ sun), rel=1e-4)


def test_no_light_leaks_through_a_mapped_surface() -> None:
    """The mapped normal sees the sun, the true surface does not."""
    n = unit(0.9, 0, 0.3)
    assert brightness({"normal_map": 0}, tuple(unit(1, 0, -0.1)), encoded(n)) == 0
    assert brightness({"normal_map": 0}, tuple(unit(1, 0, 0.1)), encoded(n)) > 0


def test_normals_that_point_inwards_stay_outside_and_finite() -> None:
    sun = tuple(unit(0.2, 0.1, 1))
    for n in (unit(0.1, 0, -1), unit(1, 0, 0), np.zeros(3)):
        got = brightness({"normal_map": 0}, sun, encoded(n))
        assert np.isfinite(got) and 0 <= got <= 1
    got = brightness({"bump_map": 0, "bump_height": 1e30}, sun, ramp())
    assert np.isfinite(got) and 0 <= got <= 1


def test_without_uv_the_surface_keeps_its_normal() -> None:
    sun = unit(0.2, 0.1, 1)
    flat = np.zeros_like(UV)
    got = brightness({"normal_map": 0}, tuple(sun), encoded(unit(0.4, 0, 1)), flat)
    assert got == pytest.approx(float(sun[2]), rel=1e-4)
