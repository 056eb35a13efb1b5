"""Pre-filtered textures in pictures: the right mean, less noise, and lights that agree."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render_build import FLOOR, assert_agrees, measure, render

from matiere import _core

QUAD = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
TRIANGLES = [[0, 1, 2], [0, 2, 3]]
UV = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)


def checker(n: int) -> np.ndarray:
    return (np.indices((n, n)).sum(0) % 2 * 255).astype(np.uint8)


def far_checker(filter_: str, seed: int) -> np.ndarray:
    """A floor of small squares to the horizon under a white sky: every pixel sees many of them."""
    d = _core.RenderDescription()
    d.set_film(24, 24, "box")
    d.set_camera("pinhole", (0, 1, 0), (0, 0.6, -3), (0, 1, 0), 25)
    uv = np.array(FLOOR[0])[:, [0, 2]] * 7.3
    texture = d.add_texture(checker(16), "repeat", filter=filter_, srgb=True)
    m = d.add_material("lambert", {"albedo": ("texture", texture)})
    d.add_mesh(np.array(FLOOR[0]) * 3, FLOOR[1], material=m, uv=uv)
    d.set_constant_environment((1, 1, 1))
    image, _ = render(
        _core.Scene(d), spp=16, seed=seed, width=24, height=24, max_depth=1, replicates=4
    )
    return image[14:, :, 0]  # floor only


def test_a_far_checker_has_the_same_mean_and_less_noise() -> None:
    seeds = range(12)
    sharp = np.array([far_checker("bilinear", s) for s in seeds])
    soft = np.array([far_checker("trilinear", s) for s in seeds])
    noise = [float(films.var(axis=0, ddof=1).mean()) for films in (sharp, soft)]
    assert noise[1] < 0.35 * noise[0], noise
    means, errors = zip(
        *((f.mean(), f.mean(axis=(1, 2)).std(ddof=1) / np.sqrt(12)) for f in (sharp, soft)),
        strict=True,
    )
    assert abs(means[0] - means[1]) < 4 * np.hypot(*errors) + 5e-4, (means, errors)
    assert means[1] == pytest.approx(0.5, rel=0.02)


@pytest.mark.parametrize("camera", ["pinhole", "orthographic"])
@pytest.mark.parametrize("distance", [2.0, 50.0])
def test_the_footprint_is_half_a_pixel(camera: str, distance: float) -> None:
    """Seen straight on, the level is that of half a pixel in texels: here an exact power of 2."""
    d = _core.RenderDescription()
    size = 8
    view = 2 * np.degrees(np.arctan(1 / distance))  # the quad fills the film
    d.set_film(size, size, "box", 1e-3)
    d.set_camera(camera, (0, 0, distance), (0, 0, 0), (0, 1, 0), view, height=2.0)
    image = np.random.default_rng(1).random((64, 64)).astype(np.float32)
    texture = d.add_texture(image, "clamp", filter="trilinear")
    m = d.add_material("lambert", {"albedo": ("texture", texture)})
    d.add_mesh(QUAD, TRIANGLES, material=m, uv=UV)
    d.set_constant_environment((1, 1, 1))
    got, _ = render(_core.Scene(d), spp=256, width=size, height=size, max_depth=1)
    # Half of a pixel is 4 texels: level 2, whose texels the pixel's centre lies between.
    level = _core.probe.Texture(image, "clamp", "trilinear").level(2)
    coarse = _core.probe.Texture(np.ascontiguousarray(level), "clamp")
    for y in range(size):
        for x in range(size):
            expected = coarse.lookup((x + 0.5) / size, 1 - (y + 0.5) / size)[0]
            assert got[y, x, 0] == pytest.approx(expected, abs=2e-3), (x, y)


def test_pictures_are_the_same_for_any_threads_and_kernel() -> None:
    films = []
    for threads, kernel in ((1, ""), (2, ""), (2, "full")):
        d = _core.RenderDescription()
        d.set_film(16, 16)
        d.set_camera("pinhole", (0, 1, 4), (0, 0.5, 0), (0, 1, 0), 40)
        texture = d.add_texture(checker(32), filter="trilinear", srgb=True)
        m = d.add_material("plastic", {"albedo": ("texture", texture)})
        d.add_mesh(*FLOOR, material=m, uv=np.array(FLOOR[0])[:, [0, 2]])
        d.add_sphere((0, 0.6, 0), 0.6, m)
        d.add_rectangle_light((-1, 3, -1), (2, 0, 0), (0, 0, 2), (9, 9, 9))
        film = _core.Film(16, 16, 4)
        _core.render(_core.Scene(d), _core.Settings(3, kernel=kernel), film, {"spp": 16}, threads)
        films.append(np.asarray(film.sums).tobytes())
    assert films[0] == films[1] == films[2]


@pytest.mark.parametrize("shape", ["sphere", "mesh"])
def test_textured_lights_are_the_same_by_every_strategy(shape: str) -> None:
    """Light sampling and light met read the same texel, unfiltered."""
    d = _core.RenderDescription()
    d.set_film(4, 4, "box")
    d.set_camera("pinhole", (1.2, 4, 0.9), (1.2, 0, 0.9), (0, 0, 1), 1e-3)
    grey = d.add_material("lambert", {"albedo": 0.8})
    d.add_mesh(*FLOOR, material=grey)
    glow = np.zeros((4, 8, 3), np.float32)
    glow[2:, 6:] = (8, 3, 1)  # one bright patch, low on the side that is seen
    glow[0, 2] = (1, 9, 1)
    texture = d.add_texture(glow, "repeat", filter="trilinear")
    lamp = d.add_material("lambert", {"albedo": 0.0}, emission=("texture", texture))
    if shape == "sphere":
        d.add_sphere((0, 1.2, 0), 0.8, lamp)
    else:
        turned = QUAD[:, [0, 2, 1]] + (0, 1.2, 0)
        d.add_mesh(turned, [[0, 1, 2], [0, 2, 3]], material=lamp, uv=UV)
    scene = _core.Scene(d)
    keys: dict[str, Any] = {"spp": 4096, "max_depth": 1, "size": 6}
    expected, error = measure(scene, strategy="bsdf", **keys)
    assert expected[0] > 0.02
    for strategy in ("light", "mis"):
        got, own = measure(scene, strategy=strategy, **keys)
        assert_agrees(got, expected, np.hypot(error, own))


def test_the_second_uv_set_is_chosen_by_the_texture() -> None:
    left = np.array([[[1, 0, 0], [0, 1, 0]]], np.float32)
    colours = {}
    for uv_set in (0, 1):
        d = _core.RenderDescription()
        d.set_film(2, 2, "box")
        d.set_camera("pinhole", (0, 0, 5), (0, 0, 0), (0, 1, 0), 1)
        texture = d.add_texture(left, "clamp", filter="nearest", uv_set=uv_set)
        m = d.add_material("lambert", {"albedo": ("texture", texture)})
        d.add_mesh(QUAD, TRIANGLES, material=m, uv=UV * 0.1, uv1=UV * 0.1 + 0.8)
        d.set_constant_environment((1, 1, 1))
        image, _ = render(_core.Scene(d), spp=4, width=2, height=2, max_depth=1)
        colours[uv_set] = image.mean(axis=(0, 1))
    assert colours[0] == pytest.approx([1, 0, 0], abs=1e-4)
    assert colours[1] == pytest.approx([0, 1, 0], abs=1e-4)


def test_a_turned_normal_map_turns_its_normals() -> None:
    """The map's x runs along its own u on the surface, wherever the transform puts it."""
    n = np.array([0.5, 0.0, 1.0]) / np.sqrt(1.25)
    sun = np.array([0.1, 0.6, 1.0]) / np.linalg.norm([0.1, 0.6, 1.0])
    quarter = (0.0, 1.0, -1.0, 0.0, 0.0, 0.0)  # u' = v, v' = -u
    d = _core.RenderDescription()
    d.set_film(2, 2, "box")
    d.set_camera("pinhole", (0, 0, 5), (0, 0, 0), (0, 1, 0), 1)
    texture = d.add_texture(np.full((1, 1, 3), (n + 1) / 2).astype(np.float32), transform=quarter)
    m = d.add_material("lambert", {"albedo": 1.0}, maps={"normal_map": texture})
    d.add_mesh(QUAD, TRIANGLES, material=m, uv=UV)
    d.add_directional_light(tuple(-sun), (1, 1, 1))
    image, _ = render(_core.Scene(d), spp=4, width=2, height=2, max_depth=1)
    turned = np.array([0.0, n[0], n[2]])  # u' grows along y
    assert float(image.mean() * np.pi) == pytest.approx(float(turned @ sun), rel=1e-4)
