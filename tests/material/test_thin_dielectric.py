"""A thin sheet: closed sums over all internal reflections."""

from __future__ import annotations

from typing import Any

import numpy as np
import oracle
import pytest
from extremes import ETAS, direction
from mpmath import mpf, sqrt

from matiere import _core

PRECISIONS = ("float", "double")
DEGREES = (0.0, 30.0, 60.0, 85.0, 89.9)
REFLECTED, PASSED = np.array([[0.0, 0.5, 0.5]]), np.array([[1 - 2**-24, 0.5, 0.5]])


def sheet(precision: str = "double", **params: Any) -> Any:
    return _core.Bsdf("thin_dielectric", params, precision)


def shares(b: Any, wo: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the energy that is reflected and that passes, per channel."""
    r, t = b.sample(wo, REFLECTED), b.sample(wo, PASSED)
    R = r.weight[0] * r.pdf[0] if r.lobe[0] & 8 else np.zeros(3)
    T = t.weight[0] * t.pdf[0] if t.lobe[0] & 16 else np.zeros(3)
    return R, T


@pytest.mark.parametrize("eta", ETAS)
@pytest.mark.parametrize("tint", [1.0, 0.5, 1e-6, 0.0])
def test_both_shares_are_the_sums_over_all_bounces(eta: float, tint: float) -> None:
    eta, tint = float(np.float32(eta)), float(np.float32(tint))
    for degrees in DEGREES:
        wo = np.array([direction(degrees, 0.3)], dtype=np.float32)
        c = mpf(float(wo[0, 2]))
        F = oracle.fresnel_dielectric(c, eta)
        R, T = shares(sheet("float", eta=eta, transmittance=tint), wo)
        if F == 1:
            assert R[0] == 1 and T[0] == 0
            continue
        t = mpf(tint) ** (1 / sqrt(1 - (1 - c * c) / mpf(eta) ** 2)) if tint else mpf(0)
        bounces = sum((F * t) ** (2 * k) for k in range(60))
        exact_T = (1 - F) ** 2 * t * bounces
        exact_R = F + (1 - F) ** 2 * F * t * t * bounces
        if F < 0.9:  # else the sum above is not finished
            assert float(abs(R[0] - exact_R)) <= 2e-6 * max(float(exact_R), 1e-3)
            unseen = 0 if T.any() else 2.0**-23  # rarer than any number the test can draw
            assert float(abs(T[0] - exact_T)) <= 2e-5 * float(exact_T) + 1e-12 + unseen
        assert 0 <= R[0] <= 1 + 1e-6 and 0 <= T[0] <= 1 + 1e-6 and R[0] + T[0] <= 1 + 1e-6


@pytest.mark.parametrize("precision", PRECISIONS)
def test_a_clear_sheet_loses_nothing(precision: str) -> None:
    for eta in (1.0 + 1e-6, 1.33, 1.5, 2.4, 100.0):
        for side in (1, -1):
            wo = np.array([direction(d) for d in DEGREES]) * (1, 1, side)
            albedo = sheet(precision, eta=eta).albedo(wo, n=4096)
            assert np.abs(albedo - 1).max() < 1e-5, (eta, albedo)


def test_normal_incidence_is_the_textbook_value() -> None:
    # n = 1.5: F = 0.04, R = 2 F / (1 + F).
    R, T = shares(sheet(eta=1.5), np.array([[0.0, 0.0, 1.0]]))
    assert R[0] == pytest.approx(0.08 / 1.04, rel=1e-6)
    assert T[0] == pytest.approx(0.96 / 1.04, rel=1e-6)


def test_both_sides_are_alike_and_light_goes_straight_on() -> None:
    b = sheet(eta=1.5, transmittance=[0.9, 0.5, 0.1])
    for degrees in DEGREES:
        wo = np.array([direction(degrees, 0.7)])
        up, down = shares(b, wo), shares(b, wo * (1, 1, -1))
        assert np.allclose(up, down)
        s = b.sample(wo, PASSED)
        if s.lobe[0] & 16:
            assert np.allclose(s.wi, -wo) and s.eta[0] == 1


def test_limits_are_exact() -> None:
    wo = np.array([direction(40.0)])
    R, T = shares(sheet(eta=1.0), wo)
    assert not R.any() and (T == 1).all()
    R, T = shares(sheet(eta=1.5, transmittance=0.0), wo)
    F = _core.probe.fresnel_dielectric_double(wo[0, 2], 1.5)[0]
    assert np.allclose(R, F) and not T.any()


def test_colours_are_kept_apart() -> None:
    wo = np.array([direction(20.0)])
    b = sheet(eta=[1.3, 1.5, 1.7], transmittance=[1.0, 0.5, 0.2])
    R, T = shares(b, wo)
    for k, (eta, tint) in enumerate(((1.3, 1.0), (1.5, 0.5), (1.7, 0.2))):
        one = shares(sheet(eta=eta, transmittance=tint), wo)
        assert R[k] == pytest.approx(one[0][k]) and T[k] == pytest.approx(one[1][k])
