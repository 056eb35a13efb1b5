"""Many lights: the tree finds each with the probability it states, and changes no picture."""

from typing import Any

import numpy as np
import pytest
from render_build import FLOOR, assert_agrees, look_at_point, render

from matiere import _core

GRID = 12  # 144 lamps


def lamps(kind: str, tree: bool = True, seed: int = 3) -> Any:
    """A lit floor seen from above under a field of lamps of very different power."""
    rng = np.random.default_rng(seed)
    d = _core.RenderDescription()
    d.set_film(16, 16, "box")
    d.set_camera("pinhole", (0, 9, 0), (0, 0, 0), (0, 0, -1), 45)
    d.add_material("lambert", {"albedo": 0.5})
    black = d.add_material("lambert", {"albedo": 0.0}, emission=2.0, two_sided=False)
    both = d.add_material("lambert", {"albedo": 0.0}, emission=2.0, two_sided=True)
    d.add_mesh(np.float32(FLOOR[0]), np.uint32(FLOOR[1]), material=0)
    for i in range(GRID * GRID):
        x, z = 8 * (np.array([i % GRID, i // GRID]) + rng.random(2)) / GRID - 4
        y, power = 0.2 + 0.8 * rng.random(), float(10 ** rng.uniform(-3, 0))
        which = ("point", "spot", "rectangle", "sphere", "mesh")[i % 5] if kind == "all" else kind
        if which == "point":
            d.add_point_light((x, y, z), (power,) * 3)
        elif which == "spot":
            d.add_spot_light((x, y, z), tuple(rng.normal(size=3)), (9 * power,) * 3, 10, 40)
        elif which == "rectangle":
            e = 0.1 * rng.normal(size=3)
            f = np.cross(e, rng.normal(size=3))
            f *= 0.1 / np.linalg.norm(f)
            d.add_rectangle_light((x, y, z), tuple(e), tuple(f), (50 * power,) * 3)
        elif which == "sphere":
            d.add_sphere((x, y, z), 0.03 + 0.05 * power, black)
        else:
            p = np.array([x, y, z]) + 0.1 * rng.normal(size=(4, 3))
            d.add_mesh(np.float32(p), np.uint32([[0, 1, 2], [0, 2, 3]]), material=both)
    d.light_tree = tree
    return _core.Scene(d, 2)


@pytest.mark.parametrize("kind", ["point", "spot", "rectangle", "sphere", "mesh", "all"])
def test_the_tree_changes_no_mean(kind: str) -> None:
    """Tiles of direct light with and without the tree, by Welch's test."""
    images = []
    for tree in (True, False):
        scene = lamps(kind, tree)
        runs = [
            render(scene, spp=64 if tree else 256, seed=s, max_depth=1, width=16, height=16)[0]
            for s in range(8)
        ]
        images.append(np.stack(runs)[..., 0].reshape(8, 4, 4, 4, 4).mean(axis=(2, 4)))
    a, b = images
    error = np.sqrt(a.var(0, ddof=1) / 8 + b.var(0, ddof=1) / 8)
    z = (a.mean(0) - b.mean(0)) / error
    assert np.abs(z).max() < 5.5, z  # 16 tiles, t with about 12 degrees of freedom: 0.2 %
    whole = np.stack([i.mean(axis=(1, 2)) for i in images])
    assert_agrees(whole[0].mean(), whole[1].mean(), np.hypot(*(whole.std(1, ddof=1) / 8**0.5)))


def test_light_sampling_and_bsdf_sampling_agree_under_the_tree() -> None:
    """The density that a chance hit is weighed with is the one the tree samples with."""
    scene = lamps("rectangle")
    means, errors = [], []
    for strategy, spp in (("mis", 256), ("light", 256), ("bsdf", 4096)):
        runs = [
            render(scene, spp=spp, seed=s, max_depth=1, strategy=strategy, width=16, height=16)[0]
            for s in range(6)
        ]
        totals = np.stack(runs)[..., 0].mean(axis=(1, 2))
        means.append(totals.mean())
        errors.append(totals.std(ddof=1) / 6**0.5)
    assert_agrees(means[0], means[1], np.hypot(errors[0], errors[1]))
    assert_agrees(means[0], means[2], np.hypot(errors[0], errors[2]))


@pytest.mark.parametrize(("kind", "share"), [("point", 0.2), ("spot", 0.5), ("rectangle", 0.45)])
def test_the_tree_pays(kind: str, share: float) -> None:
    """Variance per sample of the middle pixel, as a share of that of choosing by power."""
    spread = []
    for tree in (True, False):
        scene = lamps(kind, tree)
        runs = [
            render(scene, spp=16, seed=s, max_depth=1, width=16, height=16)[0][..., 0]
            for s in range(12)
        ]
        spread.append(np.stack(runs).var(axis=0, ddof=1))
    assert np.median(spread[0] / spread[1]) < share


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (1e-6, 1e-6, 1e-6), (1e3, 0.0, -1e3)])
def test_lamps_in_one_place(place: tuple[float, float, float]) -> None:
    """Coincident lights add up; nothing is lost at the lamps, near them or far away."""
    x, y, z = place
    totals = []
    for count in (1, 7):
        d = look_at_point((x, y, z), (x, y + 2.0, z))
        d.add_material("lambert", {"albedo": 1.0})
        corners = np.float32([[x + a, y, z + b] for a, b in ((-9, -9), (9, -9), (9, 9), (-9, 9))])
        d.add_mesh(corners, np.uint32([[0, 2, 1], [0, 3, 2]]), material=0)
        for _ in range(count):
            d.add_point_light((x, y + 1.0, z), (7.0 / count,) * 3)
        totals.append(render(_core.Scene(d, 1), spp=16, max_depth=1)[0].mean())
    assert totals[0] == pytest.approx(7 / np.pi, rel=1e-3)
    assert totals[1] == pytest.approx(totals[0], rel=1e-5)


@pytest.mark.parametrize("inner", [0.0, 20.0, 40.0])
def test_a_spot_has_its_cone(inner: float) -> None:
    """Irradiance at points below a spot, on the axis, in the fade and outside, in closed form."""
    for degrees in (0.0, 10.0, 25.0, 39.0, 41.0):
        x = float(np.tan(np.radians(degrees)))
        d = look_at_point((x, 0, 0), (x, 2, 0))
        d.add_material("lambert", {"albedo": 1.0})
        d.add_mesh(np.float32(FLOOR[0]), np.uint32(FLOOR[1]), material=0)
        d.add_spot_light((0, 1, 0), (0, -2, 0), (3.0, 3.0, 3.0), inner, 40.0)
        mean = render(_core.Scene(d, 1), spp=16, max_depth=1)[0].mean()
        c, outer, within = (np.cos(np.radians(a)) for a in (degrees, 40.0, inner))
        t = np.clip((c - outer) / max(within - outer, 1e-12), 0, 1) if degrees > inner else 1.0
        share = t * t * (3 - 2 * t)
        assert mean == pytest.approx(3 / np.pi * share * c**3, rel=1e-4, abs=1e-7), degrees
