"""The guide to light that comes by way of mirrors and lenses: no mean changes, only the noise."""

from typing import Any

import numpy as np
import pytest
from render_build import FLOOR
from scipy import stats

from matiere import _core

SIZE, REPLICATES = 24, 8
BALLS: dict[str, tuple[str, dict[str, Any]]] = {
    "rough metal": ("cook_torrance", {"alpha": 0.05, "F0": 0.9}),
    "smooth glass": ("dielectric", {"eta": 1.5}),
    "rough glass": ("dielectric", {"eta": 1.5, "alpha": 0.1}),
}


def ball_on_floor(
    material: str, params: dict[str, Any], floor: str = "lambert", lamp: float = 0.25
) -> Any:
    """A ball under a small strong lamp (edge in metres, 5 W/sr along its axis) and a dim sky."""
    d = _core.RenderDescription()
    d.set_film(SIZE, SIZE)
    d.set_camera("pinhole", (0, 3, 5), (0.2, 0.3, 0), (0, 1, 0), 40)
    ground = d.add_material(floor, {"albedo": 0.6})
    d.add_mesh(*FLOOR, material=ground)
    d.add_sphere((0, 0.8, 0), 0.8, d.add_material(material, params))
    radiance = [power / lamp**2 for power in (5.6, 5.0, 3.8)]
    d.add_rectangle_light((1.4, 3.5, 0.2), (lamp, 0, 0), (0, 0, lamp), radiance)
    d.set_constant_environment((0.2, 0.2, 0.25))
    return d


def replicates(scene: Any, guide: bool, spp: int, seed: int = 3, strategy: str = "mis") -> Any:
    film = _core.Film(SIZE, SIZE, REPLICATES)
    settings = _core.Settings(seed, 24, strategy, guide_caustics=guide)
    _core.render(scene, settings, film, {"spp": spp}, 2)
    return np.asarray(film.sums)[..., :3] / (film.spp / REPLICATES)


def tiles(x: Any) -> Any:
    return x.reshape(REPLICATES, 4, 6, 4, 6, 3).mean((2, 4, 5)).reshape(REPLICATES, -1)


@pytest.mark.parametrize("floor", ["lambert", pytest.param("plastic", marks=pytest.mark.slow)])
@pytest.mark.parametrize("ball", BALLS)
def test_the_guide_changes_no_mean(ball: str, floor: str) -> None:
    """Guided and unguided tiles agree: Welch's test from the replicates, Sidak's correction."""
    scene = _core.Scene(ball_on_floor(*BALLS[ball], floor))
    assert scene.stats()["caustic_photons"] > 1000
    a, b = (tiles(replicates(scene, g, spp)) for g, spp in ((True, 512), (False, 2048)))
    p = stats.ttest_ind(a, b, equal_var=False).pvalue
    assert p.min() > 1 - (1 - 0.01) ** (1 / p.size), (p.min(), a.mean(), b.mean())


def test_guided_techniques_agree() -> None:
    """The material's own directions alone find the same light as both techniques together."""
    scene = _core.Scene(ball_on_floor(*BALLS["rough metal"], lamp=1.5))
    assert scene.stats()["caustic_photons"] > 1000
    a, b = (tiles(replicates(scene, True, 2048, 5, s)) for s in ("mis", "bsdf"))
    p = stats.ttest_ind(a, b, equal_var=False).pvalue
    assert p.min() > 1 - (1 - 0.01) ** (1 / p.size), p.min()


@pytest.mark.parametrize(
    ("ball", "most"), [("rough metal", 0.15), ("smooth glass", 0.45), ("rough glass", 0.65)]
)
def test_the_guide_takes_noise_away(ball: str, most: float) -> None:
    """At equal samples the variance of the lower half (mostly floor) falls to this share.

    Rare bright paths rule it: one seed's ratio for rough glass runs from 0.3 to 1.2 around 0.47,
    for smooth glass from 0.2 to 0.7 around 0.25.
    """
    scene = _core.Scene(ball_on_floor(*BALLS[ball]))
    guided, plain = (
        np.mean([replicates(scene, g, 1024, seed)[:, 12:].var(0, ddof=1) for seed in range(3, 7)])
        for g in (True, False)
    )
    assert guided < most * plain, (guided, plain)


def test_the_guide_is_left_out_where_nothing_is_hidden() -> None:
    """No sharp surface, no diffuse surface, or only even light: no photons are kept."""
    matte = ball_on_floor("lambert", {"albedo": 0.5})
    mirrors = ball_on_floor("mirror", {"F0": 0.9}, "lambert")
    even = _core.RenderDescription()
    even.set_camera("pinhole", (0, 3, 5), (0, 0, 0), (0, 1, 0), 40)
    even.add_mesh(*FLOOR, material=even.add_material("lambert", {"albedo": 0.6}))
    even.add_sphere((0, 0.8, 0), 0.8, even.add_material("mirror", {"F0": 0.9}))
    even.set_constant_environment((1, 1, 1))
    photons = [_core.Scene(d).stats()["caustic_photons"] for d in (matte, even, mirrors)]
    assert photons[:2] == [0, 0]
    assert photons[2] > 0


def test_photons_do_not_depend_on_threads() -> None:
    d = ball_on_floor(*BALLS["rough glass"])
    one, many = (_core.Scene(d, threads=n) for n in (1, 3))
    assert one.stats()["caustic_photons"] == many.stats()["caustic_photons"] > 0
    assert np.array_equal(replicates(one, True, 8), replicates(many, True, 8))


@pytest.mark.parametrize("scatter", [0.3, 0.0])
def test_directions_follow_their_density(scatter: float) -> None:
    """The density integrates to 1; samples fall into its bins (chi-square)."""
    rng = np.random.default_rng(4)
    landed = rng.uniform(-0.05, 0.05, (12, 3)) * [1, 0, 1]
    origin = np.array([0.3, 1.0, 0.2]) + scatter * rng.normal(size=(12, 3))
    if scatter == 0:  # a lens throws light from one point: few photons, told apart by place alone
        origin = origin + 0.02 * rng.normal(size=(12, 3))
    guide = _core.probe.PhotonGuide(landed, origin, rng.uniform(0.5, 2, 12), 1.0)
    p = (0.0, 0.0, 0.0)
    share = guide.share(p)
    assert 0 < share < 1
    assert guide.share((9.0, 0.0, 0.0)) == 0
    # Bins: rings and sectors about the mean direction, fine where the lobes are.
    axis = np.mean(origin, 0) / np.linalg.norm(np.mean(origin, 0))
    x = np.cross(axis, [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    y = np.cross(axis, x)
    fine, rings, sectors = 16, 40, 12
    edges = 2 * (np.linspace(0, 1, rings * fine + 1) ** 3)
    t = 0.5 * (edges[1:] + edges[:-1])
    phi = (np.arange(sectors * fine) + 0.5) / (sectors * fine) * 2 * np.pi
    tt, pp = np.meshgrid(t, phi, indexing="ij")
    sine = np.sqrt(tt * (2 - tt))
    w = (1 - tt)[..., None] * axis + sine[..., None] * (
        np.cos(pp)[..., None] * x + np.sin(pp)[..., None] * y
    )
    density = guide.pdf(p, w.reshape(-1, 3).astype(np.float32)).reshape(tt.shape)
    mass = density * np.diff(edges)[:, None] * (2 * np.pi / phi.size)
    expected = mass.reshape(rings, fine, sectors, fine).sum((1, 3))
    assert expected.sum() == pytest.approx(1, abs=2e-3)
    n = 200_000
    s = np.asarray(guide.sample(p, rng.random((n, 3), dtype=np.float32)), np.float64)
    st = np.clip(0.5 * ((s - axis) ** 2).sum(1), 0, 2)
    sp = np.arctan2(s @ y, s @ x) % (2 * np.pi)
    counts = np.histogram2d(st, sp, (edges[::fine], np.linspace(0, 2 * np.pi, sectors + 1)))[0]
    keep = expected * n > 20
    observed = np.append(counts[keep], counts[~keep].sum())
    wanted = np.append(expected[keep], expected[~keep].sum()) * n
    chi2 = ((observed - wanted) ** 2 / np.maximum(wanted, 1e-9)).sum()
    assert stats.chi2.sf(chi2, observed.size - 1) > 1e-3, chi2
