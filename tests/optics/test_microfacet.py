"""Distributions, masking and slope sampling against 50 digits and against each other."""

from __future__ import annotations

import numpy as np
import oracle
import pytest
from extremes import ALPHAS
from mpmath import mpf
from scipy import special

from matiere import _core

probe = _core.probe
DISTRIBUTIONS = ("ggx", "beckmann", "ward", "blinn_phong")
ROUND = ("blinn_phong",)  # takes one width
NODES, WEIGHTS = np.polynomial.legendre.leggauss(400)


def surface(ax: float, ay: float, name: str, precision: str = "float") -> object:
    made = getattr(probe, f"Microfacet_{precision}")
    return made(ax, ay, DISTRIBUTIONS.index(name), 0)


def normals(ax: float, ay: float) -> np.ndarray:
    """Return facet normals from the peak far into the tail, as float32."""
    steps = np.array([0.0, 0.1, 0.5, 1.0, 2.0, 4.0, 8.0])
    slopes = [(s * ax * np.cos(p), s * ay * np.sin(p)) for s in steps for p in (0.0, 0.7, 2.0)]
    h = np.array([(-x, -y, 1.0) for x, y in slopes])
    return (h / np.linalg.norm(h, axis=1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize("name", DISTRIBUTIONS)
@pytest.mark.parametrize("alpha", [a for a in ALPHAS if a > 0])
@pytest.mark.parametrize("ratio", [1.0, 1e-3])
def test_the_distribution_keeps_its_digits(name: str, alpha: float, ratio: float) -> None:
    if name in ROUND and ratio != 1:
        return
    ax, ay = float(np.float32(alpha)), float(np.float32(max(alpha * ratio, 1e-5)))
    h = normals(ax, ay)
    D = surface(ax, ay, name).D(h)
    for k, w in enumerate(h):
        exact = oracle.distribution(name, [mpf(float(x)) for x in w], ax, ay)
        if exact < 1e-30:
            assert D[k] < 1e-20
            continue

        def f(x: object, y: object, z: object) -> object:
            return oracle.distribution(name, [x, y, z], ax, ay)

        allowed = oracle.bound(f, [float(x) for x in w])
        error = float(abs(mpf(float(D[k])) / exact - 1))
        oracle.note(error, allowed, f"D, {name}")
        assert error <= allowed, (name, ax, ay, w, D[k], float(exact), allowed)


@pytest.mark.parametrize("name", DISTRIBUTIONS)
@pytest.mark.parametrize("alpha", [1e-5, 1e-3, 0.1, 1.0])
def test_visible_area_keeps_its_digits_down_to_grazing(name: str, alpha: float) -> None:
    alpha = float(np.float32(alpha))
    for c in (1.0, 0.5, 0.1, 1e-2, 1e-4, 1e-6, 1e-8):
        w = np.array([[np.sqrt(1 - c * c), 0, c]], dtype=np.float32)
        x, y, z = (mpf(float(v)) for v in w[0])
        exact = z * (1 + oracle.big_lambda(name, [x, y, z], alpha, alpha))
        value = surface(alpha, alpha, name).sigma(w)[0]
        error = float(abs(mpf(float(value)) / exact - 1))
        oracle.note(error, 1e-6, f"masking, {name}")
        assert error < 1e-6, (name, alpha, c, value)


@pytest.mark.parametrize("name", DISTRIBUTIONS)
@pytest.mark.parametrize(("ax", "ay"), [(0.05, 0.05), (0.3, 0.3), (1.0, 1.0), (0.1, 0.5)])
def test_projected_facet_area_is_one(name: str, ax: float, ay: float) -> None:
    if name in ROUND and ax != ay:
        return
    # In slope space: integral of D cos = integral of P22.
    t = (NODES + 1) / 2
    phi = (np.arange(64) + 0.5) / 64 * 2 * np.pi
    r = t / (1 - t)  # slope in units of alpha, out to infinity
    R, P = np.meshgrid(r, phi, indexing="ij")
    h = np.stack([-ax * R * np.cos(P), -ay * R * np.sin(P), np.ones_like(R)], axis=-1)
    length = np.linalg.norm(h, axis=-1, keepdims=True)
    h = (h / length).reshape(-1, 3)
    D = surface(ax, ay, name, "double").D(h).reshape(R.shape)
    jacobian = ax * ay * R * (1 / (1 - t) ** 2)[:, None] / 2
    integral = (
        np.sum(D * (h[:, 2].reshape(R.shape) ** 4) * jacobian * WEIGHTS[:, None]) * 2 * np.pi / 64
    )
    assert integral == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("precision", ["float", "double"])
def test_inverse_error_function(precision: str) -> None:
    real = np.float32 if precision == "float" else np.float64
    tail = np.geomspace(1e-6, 0.5, 60)
    y = np.concatenate([np.linspace(-0.99, 0.99, 199), 1 - tail, tail - 1]).astype(real)
    x = getattr(probe, f"erf_inv_{precision}")(y)
    exact = special.erfinv(y.astype(np.float64))
    # Relative to the conditioning of the inverse near +-1.
    slope = np.sqrt(np.pi) / 2 * np.exp(exact**2)
    eps = np.finfo(real).eps
    assert np.all(np.abs(x - exact) <= 8 * eps * (np.abs(exact) + slope * np.abs(y)))


@pytest.mark.parametrize("precision", ["float", "double"])
@pytest.mark.parametrize("cot", [1e-6, 1e-3, 0.1, 1.0, 10.0, 1e4])
def test_beckmann_slopes_invert_their_distribution(precision: str, cot: float) -> None:
    real = np.float32 if precision == "float" else np.float64
    u = np.concatenate([np.linspace(0, 0.999, 300), 1 - np.geomspace(1e-6, 1e-3, 30), [1e-6, 1e-4]])
    u = u.astype(real)
    cot = float(real(cot))
    x = getattr(probe, f"beckmann_slope_{precision}")(real(cot), u).astype(np.float64)

    def cumulative(s: np.ndarray) -> np.ndarray:
        return 0.5 * (cot * np.sqrt(np.pi) * special.erfc(-s) + np.exp(-s * s))

    assert (x <= cot).all() and np.isfinite(x).all()
    got = cumulative(x) / cumulative(np.array(min(cot, 6.0)))
    assert np.abs(got - u).max() < (2e-6 if precision == "float" else 1e-13)
