"""Blinn-Phong and Ashikhmin-Shirley: published albedos, limits, couplings, and 50 digits."""

from __future__ import annotations

from typing import Any

import numpy as np
import oracle
import pytest
from extremes import direction
from mpmath import mpf, pi, sqrt
from oracle_check import check, check_model, f32, views

from matiere import _core

PRECISIONS = ("float", "double")
EXPONENTS = (0.0, 1.0, 10.0, 1e3, 1e5, 1e7, 1e8)


def bsdf(kind: str, precision: str = "double", **params: Any) -> Any:
    return _core.Bsdf(kind, params, precision)


def phong(precision: str = "double", **params: Any) -> Any:
    return bsdf("blinn_phong", precision, **{"diffuse": 0.0, "specular": 1.0, **params})


def shirley(precision: str = "double", **params: Any) -> Any:
    return bsdf("ashikhmin_shirley", precision, **{"diffuse": 0.0, "F0": 1.0, **params})


def at(degrees: list[float], azimuth: float = 0.3) -> np.ndarray:
    return np.array([direction(d, azimuth) for d in degrees])


def albedo(b: Any, degrees: list[float], azimuth: float = 0.3) -> np.ndarray:
    found: np.ndarray = b.albedo(at(degrees, azimuth), n=1 << 16)[:, 0]
    return found


@pytest.mark.parametrize("precision", PRECISIONS)
def test_blinn_phong_has_the_published_albedo(precision: str) -> None:
    # Specification, section 7: N_exact at 45 and 80 degrees.
    for m, expected in ((10, [0.607, 0.176]), (100, [0.510, 0.049]), (1e4, [0.500, 0.030])):
        assert np.abs(albedo(phong(precision, exponent=m), [45, 80]) - expected).max() < 2e-3
    for m in EXPONENTS:
        assert albedo(phong(precision, exponent=m), [0])[0] == pytest.approx(1, abs=1e-3), m


def test_the_course_gains_up_to_four_times() -> None:
    # Specification, table 0.
    for m, expected in ((0, 1), (1, 1.366), (10, 2.866), (100, 3.846), (1e4, 3.998)):
        got = albedo(phong(exponent=m, normalization="course"), [0])[0]
        assert got == pytest.approx(expected, abs=2e-3), m


def test_the_courses_anisotropic_lobe_gains_up_to_eight_pi() -> None:
    for nu, nv, expected in ((10, 10, 16.5), (10, 100, 20.0), (1e8, 1e8, 8 * np.pi)):
        got = albedo(shirley(nu=nu, nv=nv, normalization="course"), [0])[0]
        assert got == pytest.approx(expected, abs=0.05), (nu, nv)


# Specification, section 6: F = 1, albedo of the lobe at 0/30/60/75/85/89 degrees.
SHIRLEY = {
    (10, 10): [0.696, 0.688, 0.613, 0.559, 0.520, 0.504],
    (100, 100): [0.961, 0.934, 0.846, 0.725, 0.583, 0.517],
    (10, 1000): [0.839, 0.803, 0.673, 0.589, 0.530, 0.506],
    (1e4, 1e4): [0.9996, 0.995, 0.986, 0.970, 0.909, 0.664],
}


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("n", SHIRLEY)
def test_ashikhmin_shirley_has_the_published_albedo(n: tuple[float, float], precision: str) -> None:
    got = albedo(shirley(precision, nu=n[0], nv=n[1]), [0, 30, 60, 75, 85, 89])
    assert np.abs(got - SHIRLEY[n]).max() < 2e-3, got


def test_the_papers_diffuse_term_has_its_closed_form() -> None:
    degrees = [0, 30, 60, 75, 85, 89]
    b = shirley(diffuse=1.0, F0=0.0, nu=10, nv=10, coupling="paper")
    lobe = shirley(F0=0.0, nu=10, nv=10)
    c = at(degrees)[:, 2]
    body = albedo(b, degrees) - albedo(lobe, degrees)
    assert np.abs(body - (1 - (1 - c / 2) ** 5)).max() < 2e-3
    assert np.abs(body - [0.969, 0.941, 0.763, 0.500, 0.200, 0.043]).max() < 2e-3
    for n, first, last in ((10, 0.955, 0.212), (1000, 0.970, 0.450)):
        total = shirley(diffuse=1.0, F0=0.05, nu=n, nv=n, coupling="paper")
        got = albedo(total, [0, 89.9])
        assert got == pytest.approx([first, last], abs=2e-3), n


@pytest.mark.parametrize("precision", PRECISIONS)
def test_exponent_zero_is_lambert(precision: str) -> None:
    wo, wi = at([0, 30, 70, 89]), at([80, 10, 45, 89])
    a = phong(precision, exponent=0, specular=[0.9, 0.5, 0.0])
    b = bsdf("lambert", precision, albedo=[0.9, 0.5, 0.0])
    eps = float(np.finfo(np.float32 if precision == "float" else np.float64).eps)
    assert a.eval(wo, wi) == pytest.approx(b.eval(wo, wi), rel=8 * eps)
    assert a.pdf(wo, wi) == pytest.approx(b.pdf(wo, wi), rel=8 * eps)


@pytest.mark.parametrize("exponent", [0.0, 3.0, 100.0, 1e8])
def test_a_white_body_under_the_lobe_keeps_albedo_one(exponent: float) -> None:
    for b in (
        phong(diffuse=1.0, specular=0.4, exponent=exponent),
        shirley(diffuse=1.0, F0=0.04, nu=exponent, nv=exponent),
    ):
        got = albedo(b, [0, 45, 75, 85, 89])
        assert np.abs(got - 1).max() < 1e-3, got


@pytest.mark.parametrize("azimuth", [0.0, 0.5, 1.2, np.pi / 2])
def test_a_white_body_under_an_anisotropic_lobe_keeps_albedo_one(azimuth: float) -> None:
    b = shirley(diffuse=1.0, F0=0.3, nu=10, nv=1000)
    got = albedo(b, [0, 45, 75, 85], azimuth)
    assert np.abs(got - 1).max() < 1e-3, got


def test_rotation_turns_the_tangent() -> None:
    wo, wi = at([40], 0.2), at([50], 2.9)
    turn = np.radians(35.0)
    m = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    shape = {"nu": 20, "nv": 300, "F0": 0.5}
    a = shirley(**shape).eval(wo, wi)
    b = shirley(**shape, rotation_deg=35.0).eval(wo @ m.T, wi @ m.T)
    assert a == pytest.approx(b, rel=1e-12)
    quarter = shirley(nu=300, nv=20, F0=0.5, rotation_deg=90.0).eval(wo, wi)
    assert quarter == pytest.approx(a, rel=1e-12)


def test_equal_exponents_are_the_isotropic_lobe() -> None:
    a = shirley(nu=50, nv=50, F0=0.2)
    assert a.eval(at([40], 0.0), at([50], 1.0)) == pytest.approx(
        a.eval(at([40], 0.7), at([50], 1.7)), rel=1e-12
    )


@pytest.mark.parametrize(
    ("kind", "params"),
    [
        ("blinn_phong", {"diffuse": [0.5, 0.7, 0.5], "specular": 0.4}),
        ("ashikhmin_shirley", {"diffuse": 0.7, "F0": 0.1, "nu": 1e4, "nv": 1e4}),
        ("ward", {"diffuse": 0.7, "specular": [0.1, 0.31, 0.1]}),
        ("cook_torrance", {"diffuse": [0.5, 0.75, 0.5], "F0": 0.3, "alpha": 0.4}),
        ("cook_torrance", {"diffuse": 0.01, "F0": 0.04, "alpha": 0.0}),
    ],
)
def test_add_refuses_what_would_gain(kind: str, params: dict[str, Any]) -> None:
    with pytest.raises(_core.SceneError, match="sum to at most 1") as caught:
        _core.Bsdf(kind, {**params, "coupling": "add"}, "float", "/materials/x")
    assert caught.value.pointer == "/materials/x/diffuse"
    _core.Bsdf(kind, {**params, "coupling": "energy"})


def test_added_parts_are_simply_added() -> None:
    wo, wi = at([30, 60]), at([40, 80])
    b = phong(diffuse=0.3, specular=0.5, exponent=20, coupling="add")
    lobe = phong(specular=0.5, exponent=20)
    body = bsdf("lambert", albedo=0.3)
    assert b.eval(wo, wi) == pytest.approx(lobe.eval(wo, wi) + body.eval(wo, wi), rel=1e-12)
    b = bsdf("cook_torrance", F0=0.04, alpha=0.4, diffuse=0.3, coupling="add")
    lobe = bsdf("cook_torrance", F0=0.04, alpha=0.4)
    assert b.eval(wo, wi) == pytest.approx(lobe.eval(wo, wi) + body.eval(wo, wi), rel=1e-12)
    with pytest.raises(_core.SceneError, match="multiscatter"):
        bsdf("cook_torrance", alpha=0.4, diffuse=0.3, coupling="add", multiscatter=True)


def half_power(wo: Any, wi: Any, nu: Any, nv: Any) -> tuple[Any, Any, Any, Any]:
    o, i = oracle.vector(wo), oracle.vector(wi)
    h = oracle.vector_sum(o, i, 1)
    s = h[0] ** 2 + h[1] ** 2
    e = (mpf(nu) * h[0] ** 2 + mpf(nv) * h[1] ** 2) / s if s > 0 else mpf(nu)
    return o, i, oracle.dot(o, h), h[2] ** e


def phong_model(m: float) -> Any:
    n, share = mpf(m), mpf(2) ** (-mpf(m) / 2)

    def model(*x: Any) -> tuple[Any, Any]:
        _, i, oh, power = half_power(x[:3], x[3:], m, m)
        value = (n + 2) * (n + 4) / (8 * pi * (share + n)) * power * i[2]
        return value, share * i[2] / pi + (1 - share) * (n + 1) / (2 * pi) * power / (4 * oh)

    return model


@pytest.mark.parametrize("m", EXPONENTS)
def test_blinn_phong_matches_fifty_digits(m: float) -> None:
    m = f32(m)
    check_model(phong("float", exponent=m), phong_model(m), m, n=6)


@pytest.mark.parametrize("nu", EXPONENTS)
@pytest.mark.parametrize("nv", [0.0, 10.0, 1e3, 1e8])
@pytest.mark.parametrize("F0", [0.0, 0.04, 1.0])
def test_ashikhmin_shirley_matches_fifty_digits(nu: float, nv: float, F0: float) -> None:
    nu, nv, F0 = f32(nu), f32(nv), f32(F0)

    def model(*x: Any) -> tuple[Any, Any]:
        o, i, oh, power = half_power(x[:3], x[3:], nu, nv)
        pdf = sqrt((mpf(nu) + 1) * (mpf(nv) + 1)) / (8 * pi) * power / oh
        return oracle.fresnel_schlick(oh, F0) * pdf * i[2] / max(o[2], i[2]), pdf

    check_model(shirley("float", nu=nu, nv=nv, F0=F0), model, (nu, nv, F0))


@pytest.mark.parametrize("exponents", [(10.0, 200.0), (1e5, 1e5)])
def test_the_papers_diffuse_term_matches_fifty_digits(exponents: tuple[float, float]) -> None:
    # 28 / (23 pi) rho (1 - F0) (1 - (1 - o/2)^5) (1 - (1 - i/2)^5), added to the lobe.
    rho, F0 = f32(0.7), f32(0.05)
    shape = {"nu": exponents[0], "nv": exponents[1], "F0": F0}
    both = shirley("float", **shape, diffuse=rho, coupling="paper")
    lobe = shirley("float", **shape)

    def body(*x: Any) -> tuple[Any, ...]:
        o, i = oracle.vector(x[:3]), oracle.vector(x[3:])
        rise = [1 - (1 - w[2] / 2) ** 5 for w in (o, i)]
        return (28 / (23 * pi) * mpf(rho) * (1 - mpf(F0)) * rise[0] * rise[1] * i[2],)

    for o in views():
        for i in views((20.0, 85.0, 89.9)):
            away = np.array([-i[1], i[0], i[2]])
            if lobe.eval(o, away)[0, 0] == 0:  # the body alone
                check(body, (*o, *away), shape, both.eval(o, away)[0, 0])
