"""Light that paths from the lights bring, against known values."""

from typing import Any

import numpy as np
import pytest
from light_scenes import CHANCE, N, replicates, worst_p
from render_build import FLOOR

from matiere import _core

ALBEDO = 0.6
TINT = np.array([3.0, 2.0, 1.0])


def floor_from_above(
    height: float = 5.0, width: float = 1.0, x: float = 0.7, scale: float = 1.0, floor: float = 9.0
) -> Any:
    """A floor seen straight from above: image x along +x, image y along -z, `width` metres."""
    d = _core.RenderDescription()
    d.set_film(N, N, "box")
    fov = 2 * np.degrees(np.arctan(0.5 * width / height))
    d.set_camera("pinhole", (x * scale, height * scale, 0), (x * scale, 0, 0), (0, 0, -1), fov)
    corners, triangles = FLOOR
    d.add_mesh(
        np.multiply(corners, scale * floor / 9),
        triangles,
        material=d.add_material("lambert", {"albedo": ALBEDO}),
    )
    return d


def floor_points(width: float = 1.0, x: float = 0.7, fine: int = 8) -> Any:
    at = ((np.arange(N * fine) + 0.5) / (N * fine) - 0.5) * width
    px, pz = np.meshgrid(x + at, at)
    return np.stack([px, 0 * px, pz], -1)


def lit(points: Any, lamp: Any) -> Any:
    """Irradiance over the intensity of a point lamp, and the cosine at which it arrives."""
    to = np.asarray(lamp, float) - points
    d2 = (to**2).sum(-1)
    return to[..., 1] / d2**1.5, to[..., 1] / np.sqrt(d2)


def pixels(fine_image: Any) -> Any:
    fine = len(fine_image) // N
    return ALBEDO / np.pi * fine_image.reshape(N, fine, N, fine).mean((1, 3))[..., None] * TINT


def assert_agrees(images: Any, expected: Any, planted: float = 1.01) -> None:
    assert worst_p(images, expected) > CHANCE
    assert worst_p(images, planted * expected) < CHANCE  # or the test would find nothing


def wall(d: Any, material: int, x: float = -1.0, up: float = 3.0, scale: float = 1.0) -> None:
    corners = [[x, 0, -3], [x, 0, 3], [x, up, 3], [x, up, -3]]
    d.add_mesh(np.multiply(corners, scale), [[0, 1, 2], [0, 2, 3]], material=material)


def slab(d: Any, material: int, low: float, high: float, half: float = 4.0) -> None:
    corners = [(x, y, z) for y in (low, high) for x in (-half, half) for z in (-half, half)]
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    triangles = []
    for a, b, c, e in faces:
        triangles += [(a, b, c), (a, c, e)]
    mid = np.mean(corners, 0)
    for i, t in enumerate(triangles):  # counter-clockwise seen from outside
        p = np.array([corners[k] for k in t])
        if np.cross(p[1] - p[0], p[2] - p[0]) @ (p.mean(0) - mid) < 0:
            triangles[i] = t[::-1]
    d.add_mesh(corners, triangles, material=material)


def test_a_mirror_shows_the_lamp_behind_it() -> None:
    """A point lamp before a wall of mirror: the floor has the light of two lamps."""
    d = floor_from_above()
    wall(d, d.add_material("mirror", {"F0": 1.0}))
    d.add_point_light((0, 1, 0), TINT)
    p = floor_points()
    assert_agrees(replicates(d, 2048), pixels(lit(p, (0, 1, 0))[0] + lit(p, (-2, 1, 0))[0]))


def test_a_spot_and_a_sun_in_a_mirror() -> None:
    p = floor_points()
    sun = np.array([-1.0, -1.0, 0.0]) / np.sqrt(2)  # towards the wall; from above it, too
    d = floor_from_above()
    wall(d, d.add_material("mirror", {"F0": 1.0}), up=8)
    d.add_directional_light(tuple(sun), TINT)
    both = np.full(p.shape[:2], 2 * np.sqrt(0.5))
    assert_agrees(replicates(d, 4096), pixels(both), 1.02)

    d = floor_from_above()
    wall(d, d.add_material("mirror", {"F0": 1.0}))
    aim = np.array([-1.0, -0.55, 0])
    d.add_spot_light((0, 1, 0), tuple(aim), TINT, 0.1, 12)  # all that is seen is the layer's
    to = p - np.array([-2, 1, 0])
    c = (to / np.linalg.norm(to, axis=-1, keepdims=True)) @ (aim * [-1, 1, 1]) / np.linalg.norm(aim)
    t = np.clip(
        (c - np.cos(np.radians(12))) / (np.cos(np.radians(0.1)) - np.cos(np.radians(12))), 0, 1
    )
    assert_agrees(replicates(d, 2048), pixels(lit(p, (-2, 1, 0))[0] * t * t * (3 - 2 * t)))


def fresnel(cosine: Any, eta: float = 1.5) -> Any:
    inside = np.sqrt(1 - (1 - cosine**2) / eta**2)
    a = (cosine - eta * inside) / (cosine + eta * inside)
    b = (eta * cosine - inside) / (eta * cosine + inside)
    return 0.5 * (a**2 + b**2)


def test_a_sheet_of_glass_lets_its_share_through() -> None:
    """Stokes: T = (1 - F) / (1 + F) of light at any angle, and no shift."""
    d = floor_from_above(height=0.9)  # the camera is below the sheet
    sheet = d.add_material("thin_dielectric", {"eta": 1.5})
    corners = [[0, 1, -0.4], [0.7, 1, -0.4], [0.7, 1, 0.4], [0, 1, 0.4]]
    d.add_mesh(corners, [[0, 2, 1], [0, 3, 2]], material=sheet)
    d.add_point_light((0, 2, 0), TINT)
    e, cosine = lit(floor_points(), (0, 2, 0))
    F = fresnel(cosine)
    assert_agrees(replicates(d, 4096), pixels(e * (1 - F) / (1 + F)), 1.02)


@pytest.mark.parametrize("sigma", [0.0, 2.0])
def test_a_slab_of_glass(sigma: float) -> None:
    """Straight below a lamp: images at (h + (2 k + 1) t / n), each with its reflections and its way
    through the absorbing glass."""
    t, n = 0.5, 1.5
    d = floor_from_above(height=0.9, width=0.08, x=0.0)
    slab(d, d.add_material("dielectric", {"eta": n, "sigma_a": sigma}), 1.0, 1.0 + t)
    d.add_spot_light((0, 2.5, 0), (0, -1, 0), TINT, 3, 4)  # nothing reaches the slab's sides
    F = ((n - 1) / (n + 1)) ** 2
    k = np.arange(6)
    way = (2 * k + 1) * t
    e = ((1 - F) ** 2 * F ** (2 * k) * np.exp(-sigma * way) / (2.0 + way / n) ** 2).sum()
    assert_agrees(replicates(d, 4096, depth=16), pixels(np.full((N, N), e)), 1.02)


def test_a_luminaire_in_a_mirror() -> None:
    """What the floor sees in the wall is the luminaire's table, from behind the wall."""
    d = floor_from_above()
    wall(d, d.add_material("mirror", {"F0": 1.0}))
    angles = np.array([0.0, 30, 60, 90, 180], np.float32)
    values = np.array([[0.2, 1.0, 0.4, 0.7, 0.0]], np.float32)
    table = {"vertical_deg": angles, "horizontal_deg": np.zeros(1, np.float32), "values": values}
    d.add_profile_light((0, 1, 0), (0, -1, 0), TINT, table)
    p = floor_points()
    expected = 0.0
    for lamp in ((0, 1, 0), (-2, 1, 0)):
        e, cosine = lit(p, lamp)
        expected = expected + e * np.interp(np.degrees(np.arccos(cosine)), angles, values[0])
    assert_agrees(replicates(d, 2048), pixels(expected))


def test_the_sun_through_glass_inside_another_medium() -> None:
    """Paths from infinity start beside the glass, in the medium around it."""
    t, n, sigma = 0.5, 1.5, 0.8
    d = floor_from_above(height=0.9, x=0.0, floor=0.6)  # nothing else is lit
    slab(d, d.add_material("null", {"sigma_a": sigma}), 0.95, 2.0, half=1.5)
    slab(d, d.add_material("dielectric", {"eta": n}, priority=1), 1.0, 1.0 + t, half=1.0)
    d.add_directional_light((0, -1, 0), TINT)
    F = ((n - 1) / (n + 1)) ** 2
    e = (1 - F) ** 2 * np.exp(-sigma * (1.05 - t))
    assert_agrees(replicates(d, 2048, depth=3), pixels(np.full((N, N), e)), 1.05)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_the_scale_of_the_scene_is_no_matter(scale: float) -> None:
    d = floor_from_above(scale=scale)
    wall(d, d.add_material("mirror", {"F0": 1.0}), scale=scale)
    d.add_point_light((0, scale, 0), TINT * scale**2)
    p = floor_points()
    assert_agrees(replicates(d, 2048), pixels(lit(p, (0, 1, 0))[0] + lit(p, (-2, 1, 0))[0]))
