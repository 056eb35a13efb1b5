"""Energy-preserving Oren-Nayar: its energy, its limit, its sampler, and 50 digits."""

from __future__ import annotations

from typing import Any

import numpy as np
import oracle
import pytest
from extremes import direction
from mpmath import acos, det, matrix, mpf, pi, sqrt
from oracle_check import check_model, f32, sampled_pairs

from matiere import _core

PRECISIONS = ("float", "double")


def bsdf(precision: str = "double", **params: Any) -> Any:
    return _core.Bsdf("oren_nayar", params, precision)


def at(degrees: list[float]) -> np.ndarray:
    return np.array([direction(d, 0.3) for d in degrees])


NODES, WEIGHTS = np.polynomial.legendre.leggauss(200)


def albedo_by_quadrature(b: Any, wo: np.ndarray) -> float:
    """Integrate f cos over the hemisphere, without the model's own sampler."""
    s = (NODES + 1) / 2
    cos = 1 - s * s  # gathers nodes where the lobe bends
    phi = (np.arange(400) + 0.5) * 2 * np.pi / 400
    sin = np.sqrt(1 - cos * cos)
    wi = np.stack(
        [np.outer(sin, np.cos(phi)), np.outer(sin, np.sin(phi)), np.outer(cos, np.ones(400))], -1
    )
    f = b.eval(wo, wi.reshape(-1, 3))[:, 0].reshape(200, 400).mean(axis=1)
    return float(np.sum(f * WEIGHTS / 2 * 2 * s) * 2 * np.pi)


@pytest.mark.parametrize("roughness", [0.0, 1e-3, 0.3, 0.5, 1.0])
def test_a_white_surface_reflects_everything(roughness: float) -> None:
    b = bsdf(albedo=1.0, roughness=roughness)
    for wo in at([0, 45, 80, 89, 89.9]):
        assert albedo_by_quadrature(b, wo) == pytest.approx(1, abs=2e-4), (roughness, wo)


@pytest.mark.parametrize("r", [0.3, 1.0])
def test_single_scattering_has_the_published_albedo(r: float) -> None:
    # A dark surface scatters once: albedo / rho is E of the paper; <E> = .83281076 at r = 1.
    rho = 1e-9
    b = bsdf(albedo=rho, roughness=r)
    A = 1 / (1 + (0.5 - 2 / (3 * np.pi)) * r)
    x, w = np.polynomial.legendre.leggauss(24)
    mean = 0.0
    for mu, weight in zip((x + 1) / 2, w / 2, strict=True):
        S = np.sqrt(1 - mu * mu)
        G = S * (np.arccos(mu) - S * mu) + 2 / 3 * ((S / mu) * (1 - S**3) - S)
        E = albedo_by_quadrature(b, np.array([S, 0, mu])) / rho
        assert pytest.approx(A * (1 + r * G / np.pi), abs=2e-4) == E, mu
        mean += 2 * mu * weight * E
    if r == 1.0:
        assert mean == pytest.approx(0.83281076, abs=1e-4)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_roughness_zero_is_lambert(precision: str) -> None:
    wo, wi = at([0, 30, 70, 89]), at([80, 10, 45, 89])
    a = bsdf(precision, albedo=[0.9, 0.5, 0.0], roughness=0.0)
    b = _core.Bsdf("lambert", {"albedo": [0.9, 0.5, 0.0]}, precision)
    eps = float(np.finfo(np.float32 if precision == "float" else np.float64).eps)
    assert a.eval(wo, wi) == pytest.approx(b.eval(wo, wi), rel=8 * eps)
    assert a.pdf(wo, wi) == pytest.approx(b.pdf(wo, wi), rel=16 * eps)


def test_weights_stay_as_small_as_published() -> None:
    # Specification, section 10: the largest weight of the sampler at r = 1 and rho = 1.
    u = np.random.default_rng(3).random((200_000, 3))
    b = bsdf(albedo=1.0, roughness=1.0)
    for degrees, most in ((0, 1.06), (40, 1.11), (70, 1.37), (88, 1.47)):
        s = b.sample(at([degrees]), u)
        assert (s.lobe != 0).mean() > 0.99999
        assert s.weight.max() < most + 0.005, (degrees, s.weight.max())


#: The 22 numbers of the paper's fit: a (5), b (5), c (3), d (5), share of uniform directions (4).
FIT = (
    "0.303392", "-0.518982", "0.111709", "-0.276266", "0.335918",
    "-1.16407", "1.15859", "0.150815", "-0.150105", "-1.43545",
    "0.20013", "-0.506373", "0.261777",
    "0.540852", "-1.01625", "0.475392", "-1.0743", "0.0725628",
    "0.162925", "-0.372058", "0.538233", "-0.290822",
)  # fmt: skip


def eon(rho: Any, r: Any, wo: Any, wi: Any) -> Any:
    """f cos as the paper writes it."""
    o, i = oracle.vector(wo), oracle.vector(wi)
    rho, r = mpf(rho), mpf(r)
    c1, c2 = mpf(1) / 2 - 2 / (3 * pi), mpf(2) / 3 - 28 / (15 * pi)
    A = 1 / (1 + c1 * r)

    def E(mu: Any) -> Any:
        S = sqrt(1 - mu * mu)
        G = S * (acos(mu) - S * mu) + 2 * ((S / mu) * (1 - S**3) - S) / 3
        return A + r * A / pi * G

    s = oracle.dot(o, i) - o[2] * i[2]
    t = max(o[2], i[2]) if s > 0 else mpf(1)
    mean = A * (1 + c2 * r)
    f = rho / pi * A * (1 + r * s / t)
    if r > 0:
        ms = rho * rho * mean / (1 - rho * (1 - mean))
        f += ms / pi * (1 - E(o[2])) * (1 - E(i[2])) / (1 - mean)
    return f * i[2]


def density(r: Any, wo: Any, wi: Any) -> Any:
    """The clipped linearly transformed cosine of the paper's section 4, with its printed fit."""
    o, i = oracle.vector(wo), oracle.vector(wi)
    mu, r = o[2], mpf(r)
    number = [mpf(c) for c in FIT]
    a = 1 + r * (number[0] + (number[1] + number[2] * mu) * mu + (number[3] + number[4] * mu) * r)
    b = r * (number[5] + number[6] * mu + (number[7] + number[8] * mu) * r)
    b /= mu**3 + number[9]
    c = 1 + (number[10] + (number[11] + number[12] * mu) * mu) * r
    d = r * (number[13] + (number[14] + number[15] * mu) * mu)
    d /= number[16] + mu * (number[17] + mu)
    even = r ** mpf("0.1") * (number[18] + mu * (number[19] + (number[20] + number[21] * mu) * mu))
    s = sqrt(o[0] ** 2 + o[1] ** 2)
    turn = (o[0] / s, o[1] / s) if s > 0 else (mpf(1), mpf(0))
    local = matrix([turn[0] * i[0] + turn[1] * i[1], turn[0] * i[1] - turn[1] * i[0], i[2]])
    M = matrix([[a, 0, b], [0, c, 0], [d, 0, 1]])
    back = M**-1 * local
    length = sqrt(sum(x * x for x in back))
    above = (1 + 1 / sqrt(d * d + 1)) / 2  # the share of the lobe over the horizon
    lobe = max(back[2] / length, 0) / pi / (abs(det(M)) * length**3) / above
    return even / (2 * pi) + (1 - even) * lobe


@pytest.mark.parametrize("r", [0.0, 1e-6, 1e-3, 0.3, 1.0])
@pytest.mark.parametrize("rho", [0.0, 1e-3, 0.5, 0.999, 1.0])
def test_eval_matches_fifty_digits(r: float, rho: float) -> None:
    r, rho = f32(r), f32(rho)
    b = bsdf("float", albedo=rho, roughness=r)

    def model(*x: Any) -> tuple[Any, Any]:
        return eon(rho, r, x[:3], x[3:]), density(r, x[:3], x[3:])

    grazing = sampled_pairs(b, degrees=(0, 45, 85, 89.9, 89.994))
    check_model(b, model, (r, rho), grazing)
