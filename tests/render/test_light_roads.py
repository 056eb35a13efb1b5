"""Lamps by way of sharp things, by paths from the lights and without them: the same means."""

from typing import Any

import numpy as np
import pytest
from light_scenes import BALLS, N, ball_on_floor, by_both_roads
from render_build import FLOOR

from matiere import _core


@pytest.mark.parametrize("ball", BALLS)
def test_materials(ball: str) -> None:
    by_both_roads(_core.Scene(ball_on_floor(*BALLS[ball])))


@pytest.mark.parametrize("lens", ["thin_lens", "orthographic", "panorama"])
def test_every_camera_sees_it(lens: str) -> None:
    """A gaussian filter, borders and, of the panorama, its seam and poles."""
    by_both_roads(_core.Scene(ball_on_floor("mirror", {"F0": 0.9}, lens)), depth=2)


def test_a_bumpy_glass_with_smooth_normals() -> None:
    """Shading normals: the adjoint has other cosines than the camera's paths."""
    rng = np.random.default_rng(3)
    n = 12
    x, z = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n))
    y = 0.8 + 0.06 * rng.random((n, n))
    p = np.stack([x, y, z], -1).reshape(-1, 3)
    i = np.arange(n * n).reshape(n, n)
    a, b, c, e = i[:-1, :-1].ravel(), i[:-1, 1:].ravel(), i[1:, 1:].ravel(), i[1:, :-1].ravel()
    triangles = np.concatenate([np.stack([a, c, b], 1), np.stack([a, e, c], 1)])
    normals = np.stack([-np.gradient(y, axis=1), 0 * y + 2 / (n - 1), -np.gradient(y, axis=0)], -1)
    d = _core.RenderDescription()
    d.set_film(N, N)
    d.set_camera("pinhole", (0, 0.6, 4), (0, 0.2, 0), (0, 1, 0), 40)
    d.add_mesh(*FLOOR, material=d.add_material("lambert", {"albedo": 0.6}))
    sheet = d.add_material("thin_dielectric", {"eta": 2.0})
    d.add_mesh(p, triangles, normals=normals.reshape(-1, 3), material=sheet)
    back = d.add_material("conductor", {"eta": 0.2, "k": 3.5, "alpha": 0.1})
    d.add_mesh(p - np.array([0, 0.3, 0]), triangles, normals=normals.reshape(-1, 3), material=back)
    d.add_rectangle_light((-0.2, 2, 0), (0.2, 0, 0), (0, 0, 0.2), [60, 60, 60])
    by_both_roads(_core.Scene(d), spp=2048, depth=6)


def nested() -> Any:
    """A lamp inside coloured glass that holds another glass, and one lamp outside."""
    d = ball_on_floor("dielectric", {"eta": 1.5, "sigma_a": (0.3, 0.6, 1.2)})
    core = d.add_material("dielectric", {"eta": 1.2, "sigma_a": (1.0, 0.2, 0.1)}, priority=1)
    d.add_sphere((0.1, 0.7, 0.2), 0.35, core)
    lamp = d.add_material("lambert", {"albedo": 0.0}, emission=(300.0, 250.0, 200.0))
    d.add_sphere((-0.3, 1.1, 0), 0.08, lamp)
    return d


def textured_lamps() -> Any:
    """A mesh and a sphere that glow unevenly, before a mirror."""
    d = ball_on_floor("mirror", {"F0": 0.9})
    glow = np.zeros((4, 4, 3), np.float32)
    glow[::2, 1::2], glow[1::2, ::2] = (200, 100, 50), (50, 100, 200)
    lamp = d.add_material("lambert", {"albedo": 0.2}, emission=("texture", d.add_texture(glow)))
    corners = np.array([[-2, 1, 0], [-2, 1, 0.3], [-2, 1.4, 0.3], [-2, 1.4, 0]])
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    d.add_mesh(corners, [[0, 2, 1], [0, 3, 2]], uv=uv, material=lamp)
    d.add_sphere((0.3, 2.6, 1.4), 0.15, lamp)
    return d


@pytest.mark.parametrize("scene", [nested, textured_lamps])
def test_where_lamps_stand_and_how_they_glow(scene: Any) -> None:
    by_both_roads(_core.Scene(scene()))
