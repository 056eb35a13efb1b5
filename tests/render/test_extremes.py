"""Extreme scenes through the front door: sizes, places, powers, depths and sample counts."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from film_scenes import scenes

import matiere as mt

Scene = dict[str, Any]
BASE = [0.5, 0.45, 0.4]


def studio(scale: float = 1.0, offset: float = 0.0, power: float = 1.0, spp: int = 128) -> Scene:
    """Glass, rough metal and a floor under every kind of lamp, `scale` times as large, `offset`
    (in its own units) away: moved by transforms, with intensities that follow the size."""

    def place(p: list[float]) -> list[float]:
        return [scale * (p[0] + offset), scale * p[1], scale * (p[2] - offset)]

    def grown(v: list[float]) -> list[float]:
        return [scale * x for x in v]

    steps = [{"scale": scale}, {"translate": place([0, 0, 0])}]
    ball = {"type": "sphere", "radius": 0.8 * scale}
    corners = [[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]]
    lamp = {"type": "rectangle", "corner": place([-1, 4, -1]), "edge_u": grown([2, 0, 0])}
    sun = {"type": "directional", "direction": [0.3, -1, -0.2], "irradiance": 0.5 * power}
    return {
        "version": 1,
        "camera": {"type": "pinhole", "origin": place([0, 1.6, 5]), "target": place([0, 0.9, 0]),
                   "up": [0, 1, 0], "vfov_deg": 35},
        "film": {"width": 24, "height": 24},
        "materials": {
            "glass": {"type": "dielectric", "eta": 1.5, "sigma_a": [0.2 / scale, 0.1 / scale, 0]},
            "metal": {"type": "conductor", "metal": "Au", "alpha": 0.2},
            "floor": {"type": "lambert", "albedo": BASE}},
        "shapes": [
            {**ball, "center": place([-0.9, 0.8, 0]), "material": "glass"},
            {**ball, "center": place([0.9, 0.8, 0]), "material": "metal"},
            {"type": "mesh", "positions": corners, "triangles": [[0, 2, 1], [0, 3, 2]],
             "material": "floor", "transform": steps}],
        "lights": [
            {**lamp, "edge_v": grown([0, 0, 2]), "radiance": [5 * power, 4 * power, 3 * power]},
            {"type": "point", "position": place([2, 3, 2]), "intensity": 8 * power * scale**2},
            sun],
        "environment": {"radiance": [0.1 * power, 0.12 * power, 0.15 * power]},
        "render": {"spp": spp, "seed": 3},
    }  # fmt: skip


def replicates(scene: Scene) -> np.ndarray:
    """Return the images of the replicates, (R, H, W, 3)."""
    film = mt.render(mt.load(scene))
    assert film.report["rejected_total"] == 0
    images = film.replicate_means
    assert np.isfinite(images).all()
    return images


def assert_same_picture(a: np.ndarray, b: np.ndarray) -> None:
    """The same mean of each third of the picture and of the whole, within four standard errors."""
    for rows in (slice(0, 8), slice(8, 16), slice(16, 24), slice(0, 24)):
        x, y = (image[:, rows].mean((1, 2)) for image in (a, b))
        error = np.sqrt((x.var(0, ddof=1) + y.var(0, ddof=1)) / len(x))
        gap = np.abs(x.mean(0) - y.mean(0))
        assert np.all(gap <= 4 * error + 1e-3 * y.mean(0)), (rows, gap, error, y.mean(0))


@pytest.fixture(scope="module")
def usual() -> np.ndarray:
    """The studio at one metre, with many samples."""
    scene = studio(spp=1024)
    scene["render"] |= {"replicates": 16, "seed": 1}
    return replicates(scene)


@pytest.mark.parametrize(
    ("scale", "offset"),
    [(1e-6, 0), (1e6, 0), (1e9, 0), (1, 1e6), (1e-6, 1e6), (1e6, 1e3)],
)
def test_size_and_place_do_not_change_the_picture(
    usual: np.ndarray, scale: float, offset: float
) -> None:
    scene = studio(scale, offset, spp=256)
    scene["render"]["replicates"] = 16
    assert_same_picture(replicates(scene), usual)


@pytest.mark.parametrize("power", [1e-12, 1e-6, 1e6, 1e12])
def test_pictures_follow_the_power_of_the_lights(power: float) -> None:
    one, scaled = replicates(studio()), replicates(studio(power=power))
    assert np.median(np.abs(scaled / power - one) / (one + 1e-6)) < 1e-4
    assert scaled.mean() / power == pytest.approx(one.mean(), rel=2e-2)


def test_a_long_mean_of_a_constant_keeps_its_digits() -> None:
    scene = scenes(1)["diffuse"] | {"shapes": [], "lights": [], "environment": {"radiance": 0.7}}
    scene["film"] = {"width": 1, "height": 1}
    scene["render"] = {"spp": 1 << 20, "replicates": 4}
    film = mt.render(mt.load(scene), spp=10_000_000)
    assert film.spp >= 10_000_000
    assert film.mean[0, 0] == pytest.approx(0.7, rel=1e-6)


def test_a_closed_white_box_ends() -> None:
    """No light gets out and none is absorbed: only roulette and the depth guard end a path."""
    scene = copy.deepcopy(scenes(8)["interior"])
    scene["materials"] = {name: {"type": "lambert", "albedo": 1.0} for name in scene["materials"]}
    a, b, c, d = [-1, 0, 4], [1, 0, 4], [1, 2, 4], [-1, 2, 4]
    front = {"type": "mesh", "positions": [a, b, c, d], "triangles": [[0, 1, 2], [0, 2, 3]]}
    scene["shapes"].append({**front, "material": "white"})
    scene["render"] = {"spp": 16, "max_depth": 10_000}
    image = replicates(scene)
    assert np.isfinite(image).all() and image.mean() > 0


def test_a_camera_on_a_surface_sees_what_is_in_front_of_it() -> None:
    scene = studio(spp=64)
    scene["camera"] |= {"origin": [3, 0, 3], "target": [3, 4, -8]}  # on the floor
    on = replicates(scene)
    scene["camera"]["origin"] = [3, 1e-4, 3]
    above = replicates(scene)
    assert_same_picture(on, above)


def test_coincident_faces_show_one_of_them() -> None:
    scene = studio(spp=64)
    floor = scene["shapes"][2]
    before = replicates(scene)
    scene["shapes"].append(copy.deepcopy(floor))
    scene["shapes"].append(copy.deepcopy(scene["shapes"][1]))
    twice = replicates(scene)
    assert_same_picture(twice, before)
