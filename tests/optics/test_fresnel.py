"""Fresnel terms against 50 digits, over the stiff matrix and at their limits."""

from __future__ import annotations

import numpy as np
import oracle
import pytest
from extremes import COSINES, ETAS, EXTINCTIONS
from mpmath import mpf

from matiere import _core

probe = _core.probe


def relative(value: float, exact: object) -> float:
    return float(abs(mpf(float(value)) - exact) / max(abs(exact), mpf(10) ** -300))


def f32(x: float) -> float:
    return float(np.float32(x))


@pytest.mark.parametrize("eta", ETAS)
def test_dielectric_reflectance_keeps_its_digits(eta: float) -> None:
    eta = f32(eta)
    for c in map(f32, COSINES):
        exact = oracle.fresnel_dielectric(c, eta)
        R, T, _ = probe.fresnel_dielectric_float(c, eta)
        if exact == 0:
            assert R == 0 and T == 1
            continue
        allowed = oracle.bound(oracle.fresnel_dielectric, (c, eta - 1 + 1))
        oracle.note(relative(R, exact), allowed, "Fresnel, dielectric")
        assert relative(R, exact) <= allowed, (eta, c, R, float(exact), allowed)
        if exact < 1:
            assert relative(T, 1 - exact) <= 2e-5, (eta, c, T, float(1 - exact))


@pytest.mark.parametrize("eta", [1 + 1e-3, 1 + 1e-5, 1 - 1e-5, 1 + 2**-23])
def test_index_near_one_has_no_cancellation(eta: float) -> None:
    eta = f32(eta)
    worst = max(
        relative(probe.fresnel_dielectric_float(c, eta)[0], oracle.fresnel_dielectric(c, eta))
        for c in map(f32, (1.0, 0.9, 0.5, 0.1))
    )
    assert worst < 1e-6, worst


@pytest.mark.parametrize("eta", [1 / 1.5, 1 / 1.33, 0.5, 1 - 1e-4])
def test_both_sides_of_the_critical_angle(eta: float) -> None:
    eta = f32(eta)
    critical = float(np.sqrt(1 - eta * eta))
    for step in (-1e-3, -1e-5, -1e-7, 1e-7, 1e-5, 1e-3):
        c = f32(critical * (1 + step))
        exact = oracle.fresnel_dielectric(c, eta)
        R, T, cos_t = probe.fresnel_dielectric_float(c, eta)
        assert np.isfinite([R, T, cos_t]).all()
        assert pytest.approx(1, abs=1e-6) == R + T
        assert abs(float(R) - float(exact)) < 1e-6, (eta, step)
        if exact < 1:
            assert relative(T, 1 - exact) < 1e-5, (eta, step, T, float(1 - exact))
        else:
            assert (R, T, cos_t) == (1, 0, 0)


@pytest.mark.parametrize("eta", [e for e in ETAS if e != 1.0])
@pytest.mark.parametrize("k", EXTINCTIONS)
def test_conductor_reflectance_keeps_its_digits(eta: float, k: float) -> None:
    eta, k = f32(eta), f32(k)
    for c in map(f32, COSINES):
        exact = oracle.fresnel_conductor(c, eta, k)
        allowed = oracle.bound(oracle.fresnel_conductor, (c, eta, k) if k else (c, eta, 0.0))
        value = probe.fresnel_conductor_float(c, eta, k)
        oracle.note(relative(value, exact), allowed, "Fresnel, conductor")
        assert relative(value, exact) <= allowed, (eta, k, c, value, float(exact), allowed)


@pytest.mark.parametrize("eta", [0.5, 1.33, 1.5, 2.4])
def test_a_conductor_without_extinction_is_a_dielectric(eta: float) -> None:
    c = np.linspace(0, 1, 101, dtype=np.float32)
    conductor = probe.fresnel_conductor_float(c, np.float32(eta), np.float32(0))
    dielectric = probe.fresnel_dielectric_float(c, np.float32(eta))[0]
    assert np.abs(conductor - dielectric).max() < 2e-6


def test_equal_indices_reflect_nothing_at_any_angle() -> None:
    c = np.linspace(0, 1, 11, dtype=np.float32)
    R, T, cos_t = probe.fresnel_dielectric_float(c, np.float32(1))
    assert (R == 0).all() and (T == 1).all() and (cos_t == c).all()


def test_grazing_incidence_reflects_everything() -> None:
    for eta in (0.5, 1.5, 100.0):
        assert probe.fresnel_dielectric_float(0.0, eta)[0] == 1
        assert probe.fresnel_conductor_float(0.0, eta, 3.0) == 1


def test_brewsters_angle_reflects_one_polarisation() -> None:
    eta = 1.5
    c = 1 / np.sqrt(1 + eta * eta)
    r_s = (eta * eta - 1) / (eta * eta + 1)
    R = probe.fresnel_dielectric_double(c, eta)[0]
    assert pytest.approx(r_s**2 / 2, rel=1e-12) == R


def test_f82_tint_scales_schlick_at_its_angle() -> None:
    c = 1 / 7
    plain = probe.fresnel_f82_double(c, 0.5, 1.0)
    assert plain == pytest.approx(0.5 + 0.5 * (1 - c) ** 5, rel=1e-14)
    assert probe.fresnel_f82_double(c, 0.5, 0.25) == pytest.approx(0.25 * plain, rel=1e-12)
    assert probe.fresnel_f82_double(1.0, 0.5, 0.25) == pytest.approx(0.5, rel=1e-14)
