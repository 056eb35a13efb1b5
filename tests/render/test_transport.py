"""The path integrator: depth, strategies, background, random numbers."""

import itertools
from typing import Any

import numpy as np
import pytest
from render_build import FLOOR, look_at_point, measure, render

from matiere import _core


def cornell(width: int = 24, height: int = 24) -> Any:
    """A closed box with two inner blocks (spheres) and a ceiling light."""
    d = _core.RenderDescription()
    d.set_film(width, height)
    d.set_camera("pinhole", (0, 1, 3.9), (0, 1, 0), (0, 1, 0), 39)
    white, red, green = (
        d.add_material("lambert", {"albedo": a})
        for a in ([0.73, 0.73, 0.73], [0.63, 0.06, 0.05], [0.14, 0.45, 0.09])
    )

    def quad(corners: list[list[float]], material: int) -> None:
        d.add_mesh(corners, [[0, 1, 2], [0, 2, 3]], material=material)

    quad([[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]], white)
    quad([[-1, 2, 1], [-1, 2, -1], [1, 2, -1], [1, 2, 1]], white)
    quad([[-1, 0, -1], [1, 0, -1], [1, 2, -1], [-1, 2, -1]], white)
    quad([[-1, 0, 1], [-1, 0, -1], [-1, 2, -1], [-1, 2, 1]], red)
    quad([[1, 0, 1], [1, 2, 1], [1, 2, -1], [1, 0, -1]], green)
    d.add_sphere((-0.4, 0.4, -0.3), 0.4, white)
    d.add_sphere((0.45, 0.3, 0.2), 0.3, d.add_material("cook_torrance", {"alpha": 0.2, "F0": 0.9}))
    d.add_rectangle_light((-0.3, 1.98, -0.3), (0.6, 0, 0), (0, 0, 0.6), (12, 10, 8))
    return d


def replicate_means(scene: Any, strategy: str, spp: int, max_depth: int = -1) -> np.ndarray:
    film = _core.Film(24, 24, 8)
    _core.render(scene, _core.Settings(11, max_depth, strategy), film, {"spp": spp}, 2)
    return np.asarray(film.sums)[..., :3] / (film.spp / 8)


@pytest.mark.parametrize("other", ["light", "bsdf"])
def test_mis_agrees_with_each_technique_alone(other: str) -> None:
    """Image and 4 x 4 tiles, z-tests from the replicates with Sidak's correction."""
    scene = _core.Scene(cornell())
    a = replicate_means(scene, "mis", 512, 6)
    b = replicate_means(scene, other, 512 if other == "light" else 2048, 6)

    def tiles(x: np.ndarray) -> np.ndarray:
        return x.reshape(8, 4, 6, 4, 6, 3).mean((2, 4)).reshape(8, -1)

    for name, view in (("image", lambda x: x.mean((1, 2))), ("tiles", tiles)):
        x, y = view(a), view(b)
        gap = x.mean(0) - y.mean(0)
        error = np.sqrt(x.var(0, ddof=1) / 8 + y.var(0, ddof=1) / 8)
        z = np.abs(gap / error)
        from scipy import stats

        p = 2 * stats.t.sf(z, 10)
        assert p.min() > 1 - (1 - 0.01) ** (1 / p.size), (name, z.max(), p.min())


def test_depth_counts_scattering_events() -> None:
    """0 shows emitters alone, 1 adds direct light, each further event adds light."""
    scene = _core.Scene(cornell())
    means = [render(scene, 64, max_depth=k, width=24, height=24)[0] for k in (0, 1, 2, 3, -1)]
    seen = means[0][..., 0]
    lit = seen > 0
    assert 0 < lit.mean() < 0.2
    assert np.all(seen[lit] <= 12 * (1 + 1e-6))
    totals = [m.mean() for m in means]
    assert all(b > a for a, b in itertools.pairwise(totals)), totals


def test_transparent_background_has_alpha_zero() -> None:
    d = _core.RenderDescription()
    d.set_film(16, 16)
    d.set_camera("pinhole", (0, 0, 4), (0, 0, 0), (0, 1, 0), 40)
    d.add_sphere((0, 0, 0), 0.5, d.add_material("lambert", {"albedo": 0.5}))
    d.set_constant_environment((1, 1, 1))
    scene = _core.Scene(d)
    film = _core.Film(16, 16, 4)
    _core.render(scene, _core.Settings(0, -1, "mis", True), film, {"spp": 64}, 1)
    rgba = np.asarray(film.sums).sum(0) / film.spp
    assert rgba[0, 0].max() == 0
    assert rgba[8, 8, 3] == 1
    assert rgba[8, 8, 0] == pytest.approx(0.5, abs=0.05)


def test_same_numbers_for_every_thread_count() -> None:
    scene = _core.Scene(cornell())
    one, _ = render(scene, 16, threads=1, width=24, height=24)
    two, _ = render(scene, 16, threads=2, width=24, height=24)
    assert np.array_equal(one, two)


def test_sweep_cells_share_their_random_numbers() -> None:
    """Common random numbers: a small step of a parameter changes the image far less than noise."""

    def image(albedo: float) -> np.ndarray:
        d = look_at_point((0, 0, 0), (3, 4, 0), 8)
        d.add_mesh(*FLOOR, material=d.add_material("lambert", {"albedo": albedo}))
        d.add_rectangle_light((0, 1.5, 0), (1, 0, 0), (0, 0, 2), (1, 1, 1))
        return render(_core.Scene(d), 4, width=8, height=8)[0]

    a, b = image(0.5), image(0.505)
    assert np.std(b - a) < 0.02 * np.std(a)


def test_empty_scene_is_black_and_ends() -> None:
    d = look_at_point((0, 0, 0), (0, 0, 1), up=(0, 1, 0))
    mean, _ = measure(_core.Scene(d), spp=16)
    assert np.all(mean == 0)


def test_depth_guard_counts_endless_paths() -> None:
    """Inside a lossless mirror ball a path never ends by itself."""
    d = look_at_point((0, 0, 0), (0, 0, 0.5), up=(0, 1, 0))
    d.add_sphere((0, 0, 0), 1, d.add_material("mirror", {"F0": 1.0}))
    film = _core.Film(4, 4, 4)
    _core.render(_core.Scene(d), _core.Settings(0), film, {"spp": 4}, 1)
    assert film.counters["depth_guard"] == 4 * 16
