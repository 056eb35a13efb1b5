"""Hits and self-intersection at every scale; repeatable hierarchies."""

from typing import Any

import numpy as np
import pytest
from render_build import render

from matiere import _core


def bumpy_mesh(n: int = 60) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    x, z = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n), indexing="ij")
    p = np.stack([x, 0.1 * rng.standard_normal(x.shape), z], -1).reshape(-1, 3)
    i = np.arange(n * n).reshape(n, n)
    a, b, c, e = i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]
    t = np.concatenate([np.stack(k, -1).reshape(-1, 3) for k in ((a, c, b), (a, e, c))])
    return p, t


def rays(n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    origins = rng.uniform(-2, 2, (n, 3))
    directions = rng.uniform(-1, 1, (n, 3)) * 0.7 - origins
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_twenty_rebuilds_give_the_same_hits() -> None:
    """At 1 and 2 build threads, hit for hit: the ground that bit-equal renders stand on."""
    positions, triangles = bumpy_mesh()
    origins, directions = rays(20000)
    first = None
    for build in range(20):
        d = _core.RenderDescription()
        d.set_camera("pinhole", (0, 0, 4), (0, 0, 0), (0, 1, 0), 40)
        m = d.add_material("lambert", {})
        d.add_mesh(positions, triangles, material=m)
        d.add_sphere((0.3, 0.2, 0.1), 0.3, m)
        hits = _core.Scene(d, 1 + build % 2).intersect(origins, directions)
        if first is None:
            first = hits
            assert 0.2 < np.isfinite(hits["t"]).mean() < 1
            assert len(np.unique(hits["geometry"])) == 3
        for key in first:
            assert np.array_equal(first[key], hits[key], equal_nan=True), (build, key)


@pytest.mark.parametrize("radius", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("distance", [2.0, 1e4])
def test_sphere_hits_lie_on_the_sphere(radius: float, distance: float) -> None:
    d = _core.RenderDescription()
    d.set_camera("pinhole", (0, 0, 4), (0, 0, 0), (0, 1, 0), 40)
    d.add_sphere((0, 0, 0), radius, d.add_material("lambert", {}))
    rng = np.random.default_rng(1)
    normal = rng.standard_normal((5000, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    aside = rng.uniform(-0.9, 0.9, (5000, 1)) * np.cross(normal, np.roll(normal, 1, 1))
    origins = ((normal * distance + aside) * radius).astype(np.float32)
    hits = _core.Scene(d).intersect(origins, -normal)
    assert np.isfinite(hits["t"]).all()
    exact = np.linalg.norm(hits["position"].astype(float), axis=1)
    assert np.abs(exact / radius - 1).max() < 3e-7
    along = origins.astype(float) - hits["t"][:, None].astype(float) * normal
    assert (
        np.abs(np.linalg.norm(along, axis=1) / radius - 1).max() < 5e-7 * distance
    )  # 8 roundings of t


SCALES = [1e-6, 1.0, 1e6, 1e9]


def scaled_scene(scale: float) -> Any:
    d = _core.RenderDescription()
    d.set_film(24, 24)
    d.set_camera("pinhole", (0, 1.5 * scale, 4 * scale), (0, 0.5 * scale, 0), (0, 1, 0), 40)
    grey = d.add_material("lambert", {"albedo": 0.6})
    d.add_sphere((-0.5 * scale, 0.5 * scale, 0), 0.5 * scale, grey)
    d.add_sphere(
        (0.6 * scale, 0.4 * scale, 0.2 * scale),
        0.4 * scale,
        d.add_material("dielectric", {"eta": 1.5}),
    )
    floor = np.array([[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]], float) * scale
    d.add_mesh(floor, [[0, 2, 1], [0, 3, 2]], material=grey)
    d.add_rectangle_light(
        (-scale, 3 * scale, -scale), (2 * scale, 0, 0), (0, 0, 2 * scale), (5, 5, 5)
    )
    return _core.Scene(d)


def test_scale_does_not_change_the_picture() -> None:
    """From a micrometre to a million kilometres: same seed, same picture within rounding.

    With the guide to caustics the same but for the noise: which photons share a region is a matter
    of rounding.
    """
    for guide in (False, True):
        images = [
            render(scaled_scene(s), 64, width=24, height=24, guide_caustics=guide)[0]
            for s in SCALES
        ]
        for s, image in zip(SCALES, images, strict=True):
            difference = np.abs(image - images[1])
            typical = np.median(difference / (images[1] + 1e-3))
            assert typical < (1e-2 if guide else 1e-4), (s, typical)
            assert abs(image.mean() / images[1].mean() - 1) < 2e-2, s


def test_no_self_shadowing_on_a_tilted_floor_far_from_the_origin() -> None:
    """A lit plane must be lit everywhere: acne shows as dark pixels."""
    for offset in (0.0, 100.0, 10000.0):
        d = _core.RenderDescription()
        d.set_film(32, 32, "box")
        d.set_camera("pinhole", (offset, 3, 6), (offset, 0, 0), (0, 1, 0), 30)
        m = d.add_material("lambert", {"albedo": 0.5})
        y = 0.37
        corners = [
            [offset - 30, -y, -30],
            [offset + 30, y, -30],
            [offset + 30, y, 30],
            [offset - 30, -y, 30],
        ]
        d.add_mesh(corners, [[0, 2, 1], [0, 3, 2]], material=m)
        d.add_directional_light((0.1, -1, 0.05), (1, 1, 1))
        image, _ = render(_core.Scene(d), 16, width=32, height=32)
        assert image.min() > 0.9 * image.max() > 0, offset


def test_needles_and_degenerate_triangles_do_no_harm() -> None:
    d = _core.RenderDescription()
    d.set_film(16, 16)
    d.set_camera("pinhole", (0, 1, 4), (0, 0, 0), (0, 1, 0), 40)
    m = d.add_material("lambert", {"albedo": 0.5})
    positions = [
        [-2, 0, 0],
        [2, 0, 0],
        [0, 1e-7, 0],
        [0, 0, 0],
        [0, 0, 0],
        [1, 1, 0],
        [1, 1, 1e-20],
        [1, 2, 0],
    ]
    d.add_mesh(positions, [[0, 1, 2], [3, 4, 5], [5, 6, 7], [3, 3, 3]], material=m)
    d.add_mesh(
        [[-9, -1, -9], [9, -1, -9], [9, -1, 9], [-9, -1, 9]], [[0, 2, 1], [0, 3, 2]], material=m
    )
    d.set_constant_environment((1, 1, 1))
    image, report = render(_core.Scene(d), 64, width=16, height=16)
    assert np.isfinite(image).all()
    assert report["log"][-1]["rejected"] == 0


@pytest.mark.parametrize(
    ("change", "code"),
    [
        ({"positions": [[0, 0, np.nan], [1, 0, 0], [0, 1, 0]]}, "not_finite"),
        ({"triangles": [[0, 1, 7]]}, "index_range"),
        ({"normals": [[0, 0, 1]]}, "normals"),
        ({"uv": [[0, 0]]}, "uv"),
    ],
)
def test_bad_meshes_are_refused(change: dict[str, Any], code: str) -> None:
    d = _core.RenderDescription()
    d.set_camera("pinhole", (0, 0, 4), (0, 0, 0), (0, 1, 0), 40)
    m = d.add_material("lambert", {})
    mesh: dict[str, Any] = {
        "positions": [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
        "triangles": [[0, 1, 2]],
        "pointer": "/shapes/0",
    }
    d.add_mesh(**(mesh | change), material=m)
    with pytest.raises(_core.SceneError) as caught:
        _core.Scene(d)
    assert caught.value.code == code
    assert caught.value.pointer.startswith("/shapes/0/")
