"""Direct light against closed forms."""

import numpy as np
import pytest
from render_build import FLOOR, assert_agrees, look_at_point, measure

from matiere import _core

ALBEDO = 0.6


def rectangle_irradiance(a: float, b: float, h: float) -> float:
    """Irradiance over radiance at a point below one corner of a parallel a x b rectangle at height
    h (Howell, A Catalog of Radiation Heat Transfer Configuration Factors, B-3), times pi."""
    x, y = a / h, b / h
    p, q = np.sqrt(1 + x * x), np.sqrt(1 + y * y)
    return 0.5 * (x / p * np.arctan(y / p) + y / q * np.arctan(x / q))


def floor_scene() -> _core.RenderDescription:
    d = look_at_point((0, 0, 0), (3, 4, 0), size=8)
    d.add_mesh(*FLOOR, material=d.add_material("lambert", {"albedo": ALBEDO}))
    return d


@pytest.mark.parametrize("strategy", ["mis", "light", "bsdf"])
def test_rectangle_over_a_floor(strategy: str) -> None:
    d = floor_scene()
    d.add_rectangle_light((0, 1.5, 0), (1, 0, 0), (0, 0, 2), (1, 2, 3))
    mean, error = measure(_core.Scene(d), 8, spp=1024, max_depth=1, strategy=strategy)
    expected = ALBEDO / np.pi * rectangle_irradiance(1, 2, 1.5) * np.array([1, 2, 3])
    assert_agrees(mean, expected, error)


def test_rectangle_is_dark_behind() -> None:
    d = floor_scene()
    d.add_rectangle_light((0, 1.5, 0), (0, 0, 2), (1, 0, 0), (1, 1, 1))  # faces up
    mean, _ = measure(_core.Scene(d), 8, spp=64, max_depth=1)
    assert np.all(mean == 0)


@pytest.mark.parametrize("strategy", ["mis", "light", "bsdf"])
def test_sphere_light_over_a_floor(strategy: str) -> None:
    """A uniform sphere of radius r at distance d straight above: E = pi L (r / d)^2."""
    d = floor_scene()
    light = d.add_material("lambert", {"albedo": 0.0}, emission=[4.0, 2.0, 1.0])
    d.add_sphere((0, 2, 0), 0.5, light)
    mean, error = measure(_core.Scene(d), 8, spp=1024, max_depth=1, strategy=strategy)
    expected = ALBEDO * (0.5 / 2) ** 2 * np.array([4.0, 2.0, 1.0])
    if strategy == "light":  # the cone sampler is nearly exact: only the cosine varies
        assert np.all(error < 1e-3 * expected)
    assert_agrees(mean, expected, error)


@pytest.mark.parametrize("strategy", ["mis", "light", "bsdf"])
def test_mesh_light_equals_the_rectangle(strategy: str) -> None:
    d = floor_scene()
    light = d.add_material("lambert", {"albedo": 0.0}, emission=1.0, two_sided=False)
    corners = [[0, 1.5, 0], [1, 1.5, 0], [1, 1.5, 2], [0, 1.5, 2]]
    d.add_mesh(corners, [[0, 1, 2], [0, 2, 3]], material=light)
    mean, error = measure(_core.Scene(d), 8, spp=1024, max_depth=1, strategy=strategy)
    expected = ALBEDO / np.pi * rectangle_irradiance(1, 2, 1.5)
    assert_agrees(mean, expected, error)


def test_point_light() -> None:
    d = floor_scene()
    d.add_point_light((3, 4, 0), (50, 25, 5))
    mean, _ = measure(_core.Scene(d), 8, spp=16, max_depth=1)
    cosine, distance2 = 4 / 5, 25
    expected = ALBEDO / np.pi * np.array([50, 25, 5]) * cosine / distance2
    assert mean == pytest.approx(expected, rel=2e-5)


def test_directional_light() -> None:
    d = floor_scene()
    d.add_directional_light((1, -1, 0), (3, 2, 1))
    mean, _ = measure(_core.Scene(d), 8, spp=16, max_depth=1)
    assert mean == pytest.approx(ALBEDO / np.pi * np.array([3, 2, 1]) / np.sqrt(2), rel=2e-5)


@pytest.mark.parametrize("strategy", ["mis", "light", "bsdf"])
def test_constant_environment_over_a_floor(strategy: str) -> None:
    d = floor_scene()
    d.set_constant_environment((1, 0.5, 0.25))
    mean, error = measure(_core.Scene(d), 8, spp=1024, strategy=strategy)
    expected = ALBEDO * np.array([1, 0.5, 0.25])
    assert_agrees(mean, expected, error)


def test_occluder_casts_a_shadow() -> None:
    d = floor_scene()
    d.add_point_light((0, 4, 0), (50, 50, 50))
    d.add_sphere((0, 2, 0), 0.3, 0)
    mean, _ = measure(_core.Scene(d), 8, spp=16, max_depth=1)
    assert np.all(mean == 0)


def test_two_lights_add_up() -> None:
    def lit(first: bool, second: bool) -> tuple[np.ndarray, np.ndarray]:
        d = floor_scene()
        if first:
            d.add_point_light((3, 4, 0), (50, 50, 50))
        if second:
            d.add_rectangle_light((0, 1.5, 0), (1, 0, 0), (0, 0, 2), (1, 1, 1))
        return measure(_core.Scene(d), 8, spp=1024, max_depth=1)

    (a, ea), (b, eb), (both, e) = lit(True, False), lit(False, True), lit(True, True)
    assert_agrees(both, a + b, np.sqrt(e**2 + ea**2 + eb**2))
