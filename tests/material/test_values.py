"""Published values and closed forms of single models."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from extremes import direction
from material_cases import GOLD

from matiere import _core

PRECISIONS = ("float", "double")


def bsdf(kind: str, precision: str = "double", **params: Any) -> Any:
    return _core.Bsdf(kind, params, precision)


def at(degrees: list[float]) -> np.ndarray:
    return np.array([direction(d, 0.3) for d in degrees])


def test_lambert_is_albedo_over_pi_times_cosine() -> None:
    w = at([0, 30, 60, 89])
    f = bsdf("lambert", albedo=[0.2, 0.5, 1.0]).eval(w[::-1], w)
    assert f == pytest.approx(np.outer(w[:, 2], [0.2, 0.5, 1.0]) / np.pi)


# Specification, section 1: Beckmann with V-cavities, F = 1, at 0/30/60/75/85/89 degrees.
COOK_TORRANCE = {
    0.1: [1.0000, 1.0000, 0.9991, 0.9699, 0.9375, 0.9836],
    0.3: [0.9956, 0.9812, 0.9248, 0.9273, 0.9702, 0.9939],
    0.6: [0.7976, 0.8042, 0.8735, 0.9334, 0.9775, 0.9954],
    1.0: [0.4535, 0.5296, 0.7917, 0.9063, 0.9695, 0.9938],
}


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("alpha", COOK_TORRANCE)
def test_cook_torrance_albedo_is_the_published_one(alpha: float, precision: str) -> None:
    b = bsdf(
        "cook_torrance", precision, F0=1.0, alpha=alpha, distribution="beckmann",
        masking="v_cavity",
    )  # fmt: skip
    albedo = b.albedo(at([0, 30, 60, 75, 85, 89]), n=1 << 15)[:, 0]
    assert np.abs(albedo - COOK_TORRANCE[alpha]).max() < 2e-3, albedo


def test_cook_torrance_is_not_the_misprint_of_1982() -> None:
    # The printed 1/pi beside a D that integrates to pi would give 4.000 here.
    b = bsdf("cook_torrance", F0=1.0, alpha=0.1, distribution="beckmann", masking="v_cavity")
    assert b.albedo(at([0]), n=1 << 14)[0, 0] == pytest.approx(1, abs=1e-3)


# Specification, section 8: R (height-correlated) + T (separable masking) of a rough interface with
# eta = 1.5 at 0/45/80 degrees.
ROUGH_GLASS = {
    0.1: [0.9988, 0.9967, 0.9432],
    0.5: [0.968, 0.930, 0.762],
    1.0: [0.893, 0.780, 0.471],
}


def part(b: Any, wo: np.ndarray, lobe: int, n: int = 1 << 16) -> float:
    """Return the energy that leaves through one kind of lobe."""
    i = np.arange(n)
    u = np.stack(
        [(0.5 + i * 0.8191725134) % 1, (0.5 + i * 0.6710436067) % 1, (i + 0.5) / n], axis=1
    )
    s = b.sample(wo, u)
    energy = s.weight[:, 0] * s.eta**2
    return float(np.sum(energy[(s.lobe & lobe) != 0]) / n)


def rough_glass(alpha: float, wo: np.ndarray) -> float:
    smith = bsdf("dielectric", eta=1.5, alpha=alpha, masking="smith")
    separable = bsdf("dielectric", eta=1.5, alpha=alpha, masking="smith_separable")
    return part(smith, wo, 8) + part(separable, wo, 16)


@pytest.mark.parametrize("alpha", ROUGH_GLASS)
def test_rough_dielectric_energy_is_the_published_one(alpha: float) -> None:
    energy = [rough_glass(alpha, w) for w in at([0, 45, 80])]
    assert np.abs(np.array(energy) - ROUGH_GLASS[alpha]).max() < 2e-3, energy


def test_rough_dielectric_energy_from_inside_is_the_published_one() -> None:
    energy = [rough_glass(0.5, w * (1, 1, -1)) for w in at([0, 45, 80])]
    assert np.abs(np.array(energy) - [0.754, 0.684, 0.650]).max() < 2e-3, energy


def test_correlated_transmission_is_the_published_one() -> None:
    b = bsdf("dielectric", eta=1.5, alpha=1.0, masking="smith")
    assert b.albedo(at([80]), n=1 << 16)[0, 0] == pytest.approx(0.248, abs=2e-3)


@pytest.mark.parametrize("alpha", [0.0, 1e-3, 0.03, 0.1, 0.3, 1.0])
@pytest.mark.parametrize("eta", [1.2, 1.5, 2.4])
@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
def test_a_white_plastic_keeps_albedo_one(alpha: float, eta: float, distribution: str) -> None:
    b = bsdf("plastic", albedo=1.0, alpha=alpha, eta=eta, distribution=distribution)
    albedo = b.albedo(at([0, 45, 75, 85, 89]), n=1 << 14)[:, 0]
    assert np.abs(albedo - 1).max() < 1e-3, albedo


@pytest.mark.parametrize("masking", ["smith", "smith_separable", "v_cavity"])
def test_a_white_body_under_any_masking_keeps_albedo_one(masking: str) -> None:
    b = bsdf("cook_torrance", F0=0.3, diffuse=1.0, alpha=0.4, masking=masking)
    albedo = b.albedo(at([0, 45, 75, 85, 89]), n=1 << 14)[:, 0]
    assert np.abs(albedo - 1).max() < 1e-3, albedo


def test_smooth_plastic_is_the_closed_sum() -> None:
    # Specification, section 4: F_ex = .091778, F_in = .596346 for eta = 1.5.
    rho, eta, f_in = 0.6, 1.5, 0.596346
    w = at([20, 50])
    cos = w[:, 2]
    F = _core.probe.fresnel_dielectric_double(cos, eta)[0]
    expected = (1 - F[0]) * (1 - F[1]) * rho / (np.pi * eta**2 * (1 - rho * f_in)) * cos[1]
    f = bsdf("plastic", albedo=rho, eta=eta, alpha=0.0).eval(w[:1], w[1:])
    assert f[0] == pytest.approx([expected] * 3, rel=2e-6)


def test_plastic_energy_at_lower_albedo_is_the_geometric_series() -> None:
    rho, eta, f_ex = 0.3, 1.5, 0.091778
    f_in = 1 - (1 - f_ex) / eta**2
    F = _core.probe.fresnel_dielectric_double(np.cos(0.5), eta)[0]
    # Enter, then scatter and be sent back any number of times, then leave.
    expected = F + (1 - F) * rho * (1 - f_in) / (1 - rho * f_in)
    albedo = bsdf("plastic", albedo=rho, eta=eta, alpha=0.0).albedo(
        at([np.degrees(0.5)]), n=1 << 15
    )
    assert albedo[0, 0] == pytest.approx(expected, abs=1e-3)


def test_smooth_gold_has_the_reflectance_of_its_constants() -> None:
    eta, k = np.array(GOLD["eta"]), np.array(GOLD["k"])
    expected = ((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)
    s = bsdf("conductor", **GOLD, alpha=0.0).sample(at([0]), np.array([[0.5, 0.5, 0.5]]))
    assert s.weight[0] == pytest.approx(expected, rel=1e-12)


def test_mirror_fresnel_forms() -> None:
    u = np.array([[0.5, 0.5, 0.5]])
    w = at([60])
    c = w[0, 2]
    schlick = bsdf("mirror", F0=0.04).sample(w, u).weight[0, 0]
    assert schlick == pytest.approx(0.04 + 0.96 * (1 - c) ** 5)
    exact = bsdf("mirror", eta=1.5).sample(w, u).weight[0, 0]
    assert exact == pytest.approx(_core.probe.fresnel_dielectric_double(c, 1.5)[0])
    same = bsdf("mirror", F0=0.04, fresnel="exact").sample(w, u).weight[0, 0]
    assert same == pytest.approx(exact, rel=1e-9)


def test_smooth_glass_obeys_snell_and_carries_radiance() -> None:
    b = bsdf("dielectric", eta=1.5)
    for degrees in (0, 30, 60, 85):
        wo = at([degrees])
        u = np.array([[0.999999, 0.5, 0.5]])
        s = b.sample(wo, u)
        if s.lobe[0] & 8:
            continue
        sin_o = np.linalg.norm(wo[0, :2])
        sin_i = np.linalg.norm(s.wi[0, :2])
        assert sin_i * 1.5 == pytest.approx(sin_o, abs=1e-12)
        assert s.weight[0, 0] == pytest.approx(1 / 1.5**2)
        assert s.eta[0] == 1.5
        inside = b.sample(s.wi, u)
        assert inside.eta[0] == pytest.approx(1 / 1.5)
        assert inside.weight[0, 0] == pytest.approx(1.5**2)
        assert inside.wi[0] == pytest.approx(wo[0], abs=1e-12)


def test_total_internal_reflection_loses_nothing() -> None:
    b = bsdf("dielectric", eta=1.5)
    wo = np.array([direction(60)]) * (1, 1, -1)  # beyond 41.8 degrees
    s = b.sample(wo, np.array([[0.999, 0.1, 0.1]]))
    assert s.lobe[0] & 8 and s.weight[0] == pytest.approx([1, 1, 1]) and s.pdf[0] == 1
