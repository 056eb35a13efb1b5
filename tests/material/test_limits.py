"""Limits are exact at the value itself, and models meet where they describe the same thing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from extremes import ALPHAS, ETAS, direction
from material_cases import GOLD

from matiere import _core

SPECULAR, REFLECTION, TRANSMISSION = 4, 8, 16
PRECISIONS = ("float", "double")
ANGLES = (0.0, 45.0, 85.0, 89.9)
U = np.random.default_rng(1).random((200, 3), dtype=np.float32)


def bsdf(kind: str, precision: str = "float", **params: Any) -> Any:
    return _core.Bsdf(kind, params, precision)


def pairs(n: int = 500) -> tuple[np.ndarray, np.ndarray]:
    w = np.random.default_rng(2).normal(size=(2, n, 3))
    w /= np.linalg.norm(w, axis=2, keepdims=True)
    w[..., 2] = np.abs(w[..., 2])
    return w[0], w[1]


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("kind", ["conductor", "cook_torrance", "plastic", "dielectric"])
def test_alpha_zero_is_a_delta_in_sample_eval_and_pdf(kind: str, precision: str) -> None:
    extra = GOLD if kind == "conductor" else {}
    b = bsdf(kind, precision, alpha=0.0, **extra)
    assert b.lobes & SPECULAR
    for degrees in ANGLES:
        wo = np.array([direction(degrees)])
        mirrored = wo * (-1, -1, 1)
        s = b.sample(wo, U)
        sharp = (s.lobe & SPECULAR) != 0
        assert sharp.any()
        reflected = sharp & ((s.lobe & REFLECTION) != 0)
        assert np.allclose(s.wi[reflected], mirrored, atol=1e-7)
        if kind != "plastic":
            assert not b.eval(wo, mirrored).any() and not b.pdf(wo, mirrored).any()


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("alpha", ALPHAS)
def test_one_rule_decides_about_deltas(alpha: float, precision: str) -> None:
    b = bsdf("cook_torrance", precision, F0=1.0, alpha=alpha)
    wo = np.array([direction(30)])
    s = b.sample(wo, U)
    sharp = bool(b.lobes & SPECULAR)
    assert sharp == (alpha < 3e-6)
    assert (((s.lobe & SPECULAR) != 0) == sharp).all()
    assert (b.pdf(wo, s.wi) > 0).any() != sharp


@pytest.mark.parametrize("alpha", [1e-5, 1e-4, 1e-3])
def test_narrow_lobes_approach_the_mirror(alpha: float) -> None:
    smooth = bsdf("conductor", "double", alpha=0.0, **GOLD)
    rough = bsdf("conductor", "double", alpha=alpha, **GOLD)
    for degrees in (0.0, 45.0, 80.0):
        wo = np.array([direction(degrees)])
        gap = rough.albedo(wo, n=4096) - smooth.albedo(wo, n=1)
        assert np.abs(gap).max() < 10 * alpha, (alpha, degrees, gap)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("alpha", [0.0, 0.1, 1.0])
def test_plastic_of_index_one_is_lambert(alpha: float, precision: str) -> None:
    o, i = pairs()
    albedo = [0.9, 0.5, 0.1]
    plastic = bsdf("plastic", precision, albedo=albedo, eta=1.0, alpha=alpha)
    lambert = bsdf("lambert", precision, albedo=albedo)
    assert plastic.eval(o, i) == pytest.approx(lambert.eval(o, i), rel=1e-6)
    assert plastic.pdf(o, i) == pytest.approx(lambert.pdf(o, i), rel=1e-6)


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("alpha", [0.0, 1e-3, 0.3, 1.0])
def test_a_dielectric_of_index_one_is_not_there(alpha: float, precision: str) -> None:
    b = bsdf("dielectric", precision, eta=1.0, alpha=alpha)
    for degrees in ANGLES:
        wo = np.array([direction(degrees)])
        s = b.sample(wo, U)
        assert (s.lobe == SPECULAR | TRANSMISSION).all()
        assert np.allclose(s.wi, -wo, atol=1e-6) and (s.weight == 1).all() and (s.pdf == 1).all()


@pytest.mark.parametrize("eta", ETAS)
@pytest.mark.parametrize("alpha", [0.0, 1e-5, 1e-3, 0.3])
def test_interfaces_never_gain_and_smooth_ones_never_lose(eta: float, alpha: float) -> None:
    b = bsdf("dielectric", eta=eta, alpha=alpha)
    smooth = alpha == 0.0 or np.float32(eta) == 1
    for degrees in (0.0, 45.0, 85.0):
        for side in (1, -1):
            wo = np.array([direction(degrees)]) * (1, 1, side)
            albedo = b.albedo(wo, n=4096)[0, 0]
            assert albedo <= 1 + 1e-5, (eta, alpha, degrees, side, albedo)
            if smooth:
                assert albedo > 1 - 1e-5, (eta, alpha, degrees, side, albedo)


def test_black_and_white_albedo_are_exact() -> None:
    o, i = pairs()
    assert not bsdf("lambert", albedo=0.0).eval(o, i).any()
    s = bsdf("lambert", albedo=1.0).sample(o, np.broadcast_to(U[:1], o.shape))
    assert (s.weight == 1).all()


def test_an_opaque_coat_hides_its_body_without_a_division_by_zero() -> None:
    o, i = pairs()
    b = bsdf("cook_torrance", F0=1.0, diffuse=1.0, alpha=0.0)
    assert not b.eval(o, i).any()


@pytest.mark.parametrize("precision", PRECISIONS)
def test_cook_torrance_with_constants_is_the_conductor(precision: str) -> None:
    o, i = pairs()
    shape = {"alpha_x": 0.2, "alpha_y": 0.4, "distribution": "beckmann"}
    a = bsdf("cook_torrance", precision, **GOLD, **shape)
    b = bsdf("conductor", precision, **GOLD, **shape)
    assert (a.eval(o, i) == b.eval(o, i)).all() and (a.pdf(o, i) == b.pdf(o, i)).all()


def test_roughness_is_the_square_root_of_alpha() -> None:
    o, i = pairs()
    a = bsdf("cook_torrance", roughness=0.5)
    b = bsdf("cook_torrance", alpha=0.25)
    assert (a.eval(o, i) == b.eval(o, i)).all()


def test_equal_widths_are_isotropic() -> None:
    o, i = pairs()
    a = bsdf("cook_torrance", alpha_x=0.25, alpha_y=0.25, diffuse=0.5)
    b = bsdf("cook_torrance", alpha=0.25, diffuse=0.5)
    assert (a.eval(o, i) == b.eval(o, i)).all()


def test_anisotropy_follows_the_tangent() -> None:
    b = bsdf("cook_torrance", F0=1.0, alpha_x=0.01, alpha_y=0.5)
    wo = np.array([[0.0, 0.0, 1.0]])
    s = b.sample(wo, np.random.default_rng(1).random((4000, 3)))
    across, along = np.median(np.abs(s.wi[s.lobe != 0]), axis=0)[[1, 0]]
    assert across > 20 * along
