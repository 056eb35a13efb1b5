"""Diffuse bodies, coats, sheets and mixes, eval and pdf, against 50 digits."""

from __future__ import annotations

from typing import Any

import numpy as np
import oracle
import oracle_models
import pytest
from extremes import ETAS
from mpmath import mpf
from oracle_check import check, check_model, f32, views

from matiere import _core

ALBEDOS = [f32(x) for x in (0.0, 1e-3, 0.5, 0.999, 1.0)]
GGX = {"alpha_x": 0.25, "alpha_y": 0.25, "distribution": "ggx", "masking": "smith"}
METAL = ({"type": "conductor", "eta": 0.5, "k": 3.0, **GGX}, oracle_models.facets(
    GGX, lambda c: oracle.fresnel_conductor(c, 0.5, 3)
))  # fmt: skip


def grey(rho: float) -> tuple[dict[str, Any], oracle_models.Model]:
    return {"type": "lambert", "albedo": rho}, oracle_models.lambert(rho)


@pytest.mark.parametrize("rho", ALBEDOS)
def test_lambert(rho: float) -> None:
    check_model(_core.Bsdf("lambert", {"albedo": rho}), oracle_models.lambert(rho), rho)


@pytest.mark.parametrize("eta", [e for e in ETAS if e > 1])
@pytest.mark.parametrize("rho", ALBEDOS)
def test_smooth_plastic(eta: float, rho: float) -> None:
    eta = f32(eta)
    b = _core.Bsdf("plastic", {"eta": eta, "albedo": rho, "alpha": 0.0})
    pairs = [(o, i) for o in views() for i in views([10.0, 60.0, 85.0, 89.9])]
    check_model(b, oracle_models.smooth_plastic(rho, eta), (eta, rho), pairs)


@pytest.mark.parametrize("eta", ETAS)
@pytest.mark.parametrize("tau", [0.0, 1e-6, 0.1, 1.0, 20.0, 1e3, 1e30])
@pytest.mark.parametrize("rho", [0.0, 0.5, 1.0])
def test_the_exact_coat(eta: float, tau: float, rho: float) -> None:
    eta, tau = f32(eta), f32(tau)
    material, base = grey(rho)
    coat = {"eta": eta, "sigma_a": tau, "thickness": 1.0, "method": "exact"}
    b = _core.Bsdf("layered", {"base": material, **coat})
    model = oracle_models.coated(base, None, eta, tau, rho)
    check_model(b, model, (eta, tau, rho))


@pytest.mark.parametrize("eta", [0.5, 1 + 1e-4, 1.5, 2.4])
@pytest.mark.parametrize("tau", [0.0, 0.1, 20.0])
@pytest.mark.parametrize("alpha", [0.0, 1e-3, 0.3])
@pytest.mark.parametrize("over", [grey(0.5), METAL], ids=["lambert", "metal"])
def test_one_pass_coats(eta: float, tau: float, alpha: float, over: Any) -> None:
    eta, tau = f32(eta), f32(tau)
    p = {**GGX, "alpha_x": f32(alpha), "alpha_y": f32(alpha)}
    coat = {"eta": eta, "sigma_a": tau, "thickness": 1.0, "method": "weidlich_wilkie"}
    b = _core.Bsdf("layered", {"base": over[0], **coat, **p})
    surface = oracle_models.facets(p, lambda c: oracle.fresnel_dielectric(c, eta))
    model = oracle_models.coated(over[1], surface if alpha > 0 else None, eta, tau)
    check_model(b, model, (eta, tau, alpha))


@pytest.mark.parametrize("weight", [0.0, 1e-6, 0.3, 1.0])
@pytest.mark.parametrize("alpha", [1e-4, 0.25])
def test_mix(weight: float, alpha: float) -> None:
    weight = f32(weight)
    p = {**GGX, "alpha_x": f32(alpha), "alpha_y": f32(alpha)}
    metal = oracle_models.facets(p, lambda c: oracle.fresnel_conductor(c, 0.5, 3))
    diffuse, lambert = grey(0.5)
    parts = {"a": diffuse, "b": {**METAL[0], **p}, "weight": weight}
    model = oracle_models.added((1 - mpf(weight), mpf(weight)), lambert, metal)
    check_model(_core.Bsdf("mix", parts), model, (weight, alpha), n=4)
    nested = {"a": {"type": "mix", **parts}, "b": diffuse, "weight": 0.75}
    deep = oracle_models.added((mpf("0.25"), mpf("0.75")), model, lambert)
    check_model(_core.Bsdf("mix", nested), deep, ("nested", weight, alpha), n=4)


@pytest.mark.parametrize("eta", ETAS)
@pytest.mark.parametrize("tint", [1.0, 0.999, 0.5, 1e-6, 0.0])
def test_thin_sheet(eta: float, tint: float) -> None:
    eta, tint = f32(eta), f32(tint)
    b = _core.Bsdf("thin_dielectric", {"eta": eta, "transmittance": tint})
    shares = oracle_models.sheet(eta, tint)
    for wo in views():
        exact = shares(*wo)
        drawn = [b.sample(wo, [[u, 0.5, 0.5]]) for u in (0.0, 1 - 2**-24)]
        # Rarer than any number the test can draw, or impossible.
        rare = [x <= 2**-23 * sum(exact) for x in exact]
        got = [
            float(x) if r else s.weight[0, 0] * s.pdf[0]
            for s, x, r in zip(drawn, exact, rare, strict=True)
        ]
        check(shares, wo, (eta, tint), *got)

        def odds(*x: Any) -> tuple[Any, ...]:
            part = shares(*x)
            return part[0] / sum(part), part[1] / sum(part)

        if sum(exact) > 1e-30:  # else the float path has nothing to draw
            ideal = odds(*wo)
            chosen = [
                float(x) if r else s.pdf[0] for s, x, r in zip(drawn, ideal, rare, strict=True)
            ]
            check(odds, wo, ("pdf", eta, tint), *chosen)


def test_null_lets_all_pass_exactly() -> None:
    b = _core.Bsdf("null", {})
    for wo in views():
        s = b.sample(wo, np.array([[0.3, 0.3, 0.3]]))
        assert (s.wi[0] == -wo).all() and (s.weight == 1).all() and s.pdf[0] == 1
