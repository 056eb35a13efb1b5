"""Coats over materials: closed forms, the random walk, and how the three methods agree."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from extremes import DEGREES, direction
from scipy import integrate

import matiere as mt
from matiere import _core

WHITE = {"type": "lambert", "albedo": 1.0}
GREY = {"type": "lambert", "albedo": [0.8, 0.5, 0.2]}
GGX = {"type": "cook_torrance", "F0": 1.0, "alpha": 0.1}
GLOSSY = {"type": "cook_torrance", "F0": 0.9, "alpha": 0.3}
MIRROR = {"type": "mirror", "F0": 1.0}
ABSORBING = {"sigma_a": [100.0, 500.0, 2000.0], "thickness": 1e-3}
WALKS: dict[str, dict[str, Any]] = {
    "smooth over lambert": {"base": GREY},
    "smooth over white": {"base": WHITE, "eta": 2.0},
    "rough over lambert": {"base": GREY, "alpha": 0.3},
    "very rough over white": {"base": WHITE, "alpha": 1.0},
    "smooth over metal": {"base": GLOSSY},
    "rough over metal": {"base": GLOSSY, "alpha": 0.2},
    "rough over mirror": {"base": MIRROR, "alpha": 0.3},
    "thin coat": {"base": GLOSSY, "alpha": 0.3, "eta": 1.01},
    "low index": {"base": GLOSSY, "alpha": 0.3, "eta": 0.8},
    "absorbing": {"base": GREY, "alpha": 0.2, **ABSORBING},
    "mixed base": {"base": {"type": "mix", "a": GREY, "b": MIRROR, "weight": 0.3}, "alpha": 0.2},
    "mixed base, smooth": {"base": {"type": "mix", "a": GREY, "b": MIRROR}},
    "two coats": {
        "base": {"type": "layered", "base": GREY, "eta": 1.2, "alpha": 0.1},
        "alpha": 0.3,
    },
    "anisotropic": {"base": GLOSSY, "alpha_x": 0.1, "alpha_y": 0.5},
}
QUICK = ("smooth over lambert", "rough over metal", "absorbing", "mixed base")
walks = pytest.mark.parametrize(
    "name", [pytest.param(n, marks=() if n in QUICK else pytest.mark.slow) for n in WALKS]
)
SPECULAR = 4


def layered(method: str = "walk", precision: str = "double", **params: Any) -> Any:
    return _core.Bsdf("layered", {"method": method, **params}, precision)


def jittered(w: Any, n: int, seed: int = 1) -> np.ndarray:
    """Return n directions within about 1e-9 of one: the same place, other random numbers."""
    v = np.asarray(w, float) + 1e-9 * np.random.default_rng(seed).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def mean_of(b: Any, wo: Any, wi: Any, n: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean of a walk's eval and its standard error."""
    f = b.eval(jittered(wo, n), jittered(wi, n, 2))
    return f.mean(0), f.std(0, ddof=1) / np.sqrt(n)


def hemisphere(n: int, seed: int) -> np.ndarray:
    u = np.random.default_rng(seed).random((n, 2))
    r = np.sqrt(1 - u[:, 0] ** 2)
    return np.stack([r * np.cos(2 * np.pi * u[:, 1]), r * np.sin(2 * np.pi * u[:, 1]), u[:, 0]], 1)


def fresnel(c: float, n: float) -> float:
    s = (1 - c * c) / n**2
    if s >= 1:
        return 1.0
    t = np.sqrt(1 - s)
    return float(0.5 * (((c - n * t) / (c + n * t)) ** 2 + ((n * c - t) / (n * c + t)) ** 2))


# The closed form


@pytest.mark.parametrize("eta", [1.0, 1.0001, 1.33, 1.5, 2.5, 0.7])
def test_a_smooth_clear_coat_over_white_keeps_all_light(eta: float) -> None:
    b = layered("exact", base=WHITE, eta=eta)
    for degrees in DEGREES:
        wo = direction(degrees, 0.4)
        # The body by quadrature over the polar angle (it is isotropic), the surface by Fresnel.
        cos = ((np.arange(40_000) + 0.5) / 40_000) ** 2
        sin = np.sqrt(1 - cos**2)
        body = b.eval(wo, np.stack([sin, 0 * sin, cos], 1))[:, 0]
        total = float(np.mean(body * 4 * np.pi * np.sqrt(cos)))
        assert total + fresnel(wo[2], eta) == pytest.approx(1, abs=2e-6), (eta, degrees)
        assert b.albedo(wo, n=1 << 12) == pytest.approx(1, abs=2e-3), (eta, degrees)


@pytest.mark.parametrize("tau", [0.0, 1e-3, 0.1, 1.0, 20.0])
def test_exact_is_the_sum_over_internal_bounces(tau: float) -> None:
    eta, rho = 1.5, 0.7
    critical = np.sqrt(1 - 1 / eta**2)
    parts = [
        integrate.quad(lambda m: 2 * m * fresnel(m, 1 / eta) * np.exp(-2 * tau / m), a, b,
                       epsabs=1e-12, limit=400)[0]
        for a, b in ((1e-9, critical), (critical, 1.0))
    ]  # fmt: skip
    o, i = np.array(direction(50, 0.1)), np.array(direction(20, 2.0))
    inner = [np.sqrt(1 - (1 - w[2] ** 2) / eta**2) for w in (o, i)]
    through = np.prod([1 - fresnel(w[2], eta) for w in (o, i)])
    out = np.exp(-tau * sum(1 / c for c in inner))
    expected = through * out * rho / (np.pi * eta**2 * (1 - rho * sum(parts))) * i[2]
    b = layered(
        "exact", base={"type": "lambert", "albedo": rho}, eta=eta, sigma_a=tau, thickness=1.0
    )
    assert b.eval(o, i)[0, 0] == pytest.approx(expected, rel=1e-6)


def test_plastic_is_the_same_coat() -> None:
    wo, wi = hemisphere(100, 1), hemisphere(100, 2)
    plastic = _core.Bsdf("plastic", {"albedo": 0.6, "eta": 1.5, "alpha": 0.0}, "double")
    coat = layered("exact", base={"type": "lambert", "albedo": 0.6})
    assert np.allclose(coat.eval(wo, wi), plastic.eval(wo, wi), rtol=1e-5)


# Weidlich & Wilkie


@pytest.mark.parametrize(
    ("degrees", "metal", "diffuse"), [(0, 0.897, 0.428), (45, 0.795, 0.434), (75, 0.606, 0.555)]
)
def test_one_pass_numbers(degrees: float, metal: float, diffuse: float) -> None:
    """The spec's table: smooth coat of 1.5 over a GGX metal of alpha 0.1, and over white."""
    wo = direction(degrees, 0.4)
    for base, expected in ((GGX, metal), (WHITE, diffuse)):
        b = layered("weidlich_wilkie", base=base)
        assert b.albedo(wo, n=1 << 15)[0, 0] == pytest.approx(expected, abs=2e-3)


def test_an_absent_coat_is_the_base() -> None:
    wo, wi = hemisphere(200, 3), hemisphere(200, 4)
    for method in ("weidlich_wilkie", "exact"):
        b = layered(method, base=GREY, eta=1.0)
        assert np.allclose(b.eval(wo, wi), wi[:, 2:] / np.pi * GREY["albedo"], rtol=1e-6)
    walk = layered(base=GREY, eta=1.0)
    assert np.allclose(walk.eval(wo, wi), wi[:, 2:] / np.pi * GREY["albedo"], rtol=1e-6)


def test_an_opaque_coat_hides_the_base() -> None:
    for method in ("walk", "weidlich_wilkie", "exact"):
        b = layered(method, base=WHITE, sigma_a=1e30, thickness=1e30)
        assert b.albedo((0, 0, 1))[0] == pytest.approx(0.04, abs=2e-3)
        assert np.isfinite(b.eval(hemisphere(100, 5), hemisphere(100, 6))).all()


# The walk


@pytest.mark.parametrize("degrees", [0.0, 45.0, 85.0])
@pytest.mark.parametrize("coat", [{}, ABSORBING])
def test_the_walk_is_exact_over_lambert(degrees: float, coat: dict[str, Any]) -> None:
    wo = direction(degrees, 0.4)
    walk, exact = layered(base=GREY, **coat), layered("exact", base=GREY, **coat)
    for wi in (direction(0, 0), direction(60, 2.0), direction(85, 1.0)):
        mean, error = mean_of(walk, wo, wi)
        assert (np.abs(mean - exact.eval(wo, wi)[0]) < 4.5 * error + 1e-7).all(), (mean, error)


@pytest.mark.parametrize("alpha", [0.0, 1e-3])
def test_a_walk_over_white_loses_nothing(alpha: float) -> None:
    for degrees in (0.0, 60.0, 85.0):
        b = layered(base=WHITE, alpha=alpha)
        u = np.random.default_rng(3).random((100_000, 3))
        weight = b.sample(direction(degrees, 0.4), u).weight[:, 0]
        error = weight.std() / np.sqrt(len(weight))
        # A rough surface scatters once per facet: it loses what hits a second one.
        loss = 1e-6 if alpha == 0 else 2e-3
        gap = weight.mean() - 1
        assert -4.5 * error - loss < gap < 4.5 * error + 1e-6, (degrees, weight.mean())


@walks
def test_eval_of_a_walk_is_where_its_samples_go(name: str) -> None:
    """E[eval] over cells of the hemisphere against the weights of samples that land there."""
    b = layered(**WALKS[name])
    cells = 6
    for degrees in (20.0, 70.0):
        wo = direction(degrees, 0.4)
        n = 150_000
        s = b.sample(wo, np.random.default_rng(5).random((n, 3)))
        dull = (s.lobe != 0) & ((s.lobe & SPECULAR) == 0)

        def cell(w: np.ndarray) -> np.ndarray:
            polar = np.minimum((w[:, 2] ** 2 * cells).astype(int), cells - 1)
            turn = (np.arctan2(w[:, 1], w[:, 0]) / (2 * np.pi) % 1 * cells).astype(int)
            return polar * cells + np.minimum(turn, cells - 1)

        def moments(w: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return np.bincount(cell(w), x, cells**2), np.bincount(cell(w), x * x, cells**2)

        wi = hemisphere(n, 6)
        f = b.eval(wo, wi)[:, 1] * 2 * np.pi
        a, a2 = moments(wi, f)
        c, c2 = moments(s.wi[dull], s.weight[dull][:, 1].astype(float))
        # A cell that a few large values make has no normal sum: pool those.
        few = (a**2 < 1000 * a2) | (c**2 < 1000 * c2)
        a, a2, c, c2 = (np.append(x[~few], x[few].sum()) for x in (a, a2, c, c2))
        z = (a - c) / np.sqrt(a2 - a**2 / n + c2 - c**2 / n + 1e-9)
        assert np.abs(z).max() < 5 and np.mean(z**2) < 3, (name, degrees, np.round(z, 1))


@walks
def test_walks_are_reciprocal_in_the_mean(name: str) -> None:
    if name == "mixed base, smooth":
        # Walks whose last turn is a mirror's count as delta; from the other end they are the first.
        pytest.skip("reciprocal only together with its delta lobe")
    b = layered(**WALKS[name])
    for a, c in (((20, 0.0), (60, 2.0)), ((75, 1.0), (10, 3.0)), ((80, 0.0), (80, 2.5))):
        wo, wi = direction(*a), direction(*c)
        (x, dx), (y, dy) = mean_of(b, wo, wi), mean_of(b, wi, wo)
        x, dx, y, dy = x / wi[2], dx / wi[2], y / wo[2], dy / wo[2]
        assert (np.abs(x - y) < 5 * np.hypot(dx, dy) + 1e-6).all(), (name, x, y, dx, dy)


@walks
@pytest.mark.parametrize("precision", ["float", "double"])
def test_walks_never_gain(name: str, precision: str) -> None:
    b = layered(precision=precision, **WALKS[name])
    for degrees in DEGREES:
        u = np.random.default_rng(7).random((20_000, 3))
        weight = b.sample(direction(degrees, 0.4), u).weight.astype(float)
        assert np.isfinite(weight).all() and (weight >= 0).all()
        error = weight.std(0) / np.sqrt(len(weight))
        assert (weight.mean(0) <= 1 + 1e-3 + 4.5 * error).all(), (degrees, weight.mean(0))


@walks
def test_the_stand_in_density_is_the_same_on_both_sides(name: str) -> None:
    b = layered(**WALKS[name])
    wo = direction(40, 0.4)
    s = b.sample(wo, np.random.default_rng(8).random((2000, 3)))
    dull = (s.lobe != 0) & ((s.lobe & SPECULAR) == 0)
    assert np.allclose(s.pdf[dull], b.pdf(wo, s.wi[dull])) and (s.pdf[dull] > 0).all()


def test_a_walk_is_a_pure_function() -> None:
    b, wo = layered(base=GLOSSY, alpha=0.2), direction(40, 0.4)
    wi, u = hemisphere(100, 9), np.random.default_rng(9).random((100, 3))
    assert b.stochastic and not layered("exact", base=GREY).stochastic
    assert np.array_equal(b.eval(wo, wi), b.eval(wo, wi))
    assert np.array_equal(b.sample(wo, u).weight, b.sample(wo, u).weight)


BAD = [
    ({"base": {"type": "dielectric"}}, "/base", "let light through"),
    ({"base": {"type": "null"}}, "/base", "let light through"),
    ({"base": GGX, "method": "exact"}, "/method", "lambert"),
    ({"base": GREY, "method": "exact", "alpha": 0.1}, "/method", "smooth"),
    ({"base": GREY, "sigma_a": 2.0}, "/thickness", "needed"),
    ({"base": GREY, "eta": 0.0}, "/eta", "greater than 0"),
]


@pytest.mark.parametrize(("params", "at", "words"), BAD)
def test_what_cannot_be_coated_is_refused(params: dict[str, Any], at: str, words: str) -> None:
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.bsdf({"type": "layered", **params})
    (fault,) = caught.value.faults
    assert fault.pointer == at and words in fault.message, fault
