"""Whole models against 50 digits at the engine's own float inputs, over the stiff matrix."""

from __future__ import annotations

from typing import Any

import numpy as np
import oracle
import pytest
from extremes import ALPHAS
from material_cases import GOLD
from mpmath import mpf

from matiere import _core

DISTRIBUTIONS = ("ggx", "beckmann", "ward", "blinn_phong")
MASKINGS = ("smith", "smith_separable", "v_cavity")
ROUGH = [a for a in ALPHAS if a > 0]


def f32(x: float) -> float:
    return float(np.float32(x))


def pairs(b: Any, n: int = 3) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return directions where the lobe is: sampled, rounded to float."""
    rng = np.random.default_rng(7)
    found = []
    for c in (1.0, 0.7, 0.05):
        s = np.sqrt(1 - c * c)
        wo = np.array([s * np.cos(0.4), s * np.sin(0.4), c], dtype=np.float32)
        got = b.sample(wo, rng.random((4 * n, 3), dtype=np.float32))
        found += [(wo, wi) for wi in got.wi[got.lobe != 0][:n]]
    return found


def check(value: float, f: Any, inputs: list[float], what: object) -> None:
    exact = f(*inputs)
    if abs(exact) < mpf(10) ** -25:
        assert abs(value) < 1e-20, (what, value)
        return
    error = float(abs(mpf(float(value)) / exact - 1))
    allowed = oracle.bound(f, inputs)
    oracle.note(error, allowed)
    assert error <= allowed, (what, value, float(exact), error, allowed)


@pytest.mark.parametrize("alpha", ROUGH)
@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
@pytest.mark.parametrize("masking", MASKINGS)
def test_rough_reflection(alpha: float, distribution: str, masking: str) -> None:
    alpha = f32(alpha)
    shape = {"alpha_x": alpha, "alpha_y": alpha, "distribution": distribution, "masking": masking}
    widths = {k: v for k, v in shape.items() if k not in ("alpha_x", "alpha_y")}
    one_width = distribution == "blinn_phong"
    b = _core.Bsdf("conductor", {**GOLD, **(widths | {"alpha": alpha} if one_width else shape)})
    eta, k = f32(GOLD["eta"][0]), f32(GOLD["k"][0])

    def f(*x: Any) -> Any:
        def fresnel(c: Any) -> Any:
            return oracle.fresnel_conductor(c, eta, k)

        return oracle.reflection(x[:3], x[3:], shape, fresnel)

    for wo, wi in pairs(b, 1 if one_width else 3):  # its masking is an integral in the oracle
        value = b.eval(wo, wi)[0, 0]
        check(value, f, [float(x) for x in (*wo, *wi)], (alpha, distribution, masking, wo, wi))


@pytest.mark.parametrize("alpha", [1e-4, 1e-2, 0.3, 1.0])
@pytest.mark.parametrize("eta", [1 + 1e-4, 0.5, 1.33, 2.4, 100.0])
@pytest.mark.parametrize("masking", MASKINGS)
def test_rough_transmission(alpha: float, eta: float, masking: str) -> None:
    alpha, eta = f32(alpha), f32(eta)
    shape = {"alpha_x": alpha, "alpha_y": alpha, "distribution": "ggx", "masking": masking}
    b = _core.Bsdf("dielectric", {"eta": eta, **shape})

    def transmitted(*x: Any) -> Any:
        return oracle.transmission(x[:3], x[3:], shape, eta)

    def reflected(*x: Any) -> Any:
        def fresnel(c: Any) -> Any:
            return oracle.fresnel_dielectric(c, eta)

        return oracle.reflection(x[:3], x[3:], shape, fresnel)

    for wo, wi in pairs(b):
        value = b.eval(wo, wi)[0, 0]
        f = transmitted if wi[2] < 0 else reflected
        check(value, f, [float(x) for x in (*wo, *wi)], (alpha, eta, masking, wo, wi))
