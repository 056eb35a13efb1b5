"""Microfacet models, eval and pdf, against 50 digits at the engine's own float inputs, over the
stiff matrix."""

from __future__ import annotations

import itertools
from typing import Any

import oracle
import oracle_models
import pytest
from extremes import ALPHAS, ETAS
from material_cases import GOLD
from mpmath import mpf
from oracle_check import check, check_model, f32, views

from matiere import _core

DISTRIBUTIONS = ("ggx", "beckmann", "ward", "blinn_phong")
MASKINGS = ("smith", "smith_separable", "v_cavity")
ROUGH = [f32(a) for a in ALPHAS if a > 0]
#: Fresnel terms of cook_torrance, with the reflectance of the first channel.
FRESNEL: dict[str, tuple[dict[str, Any], oracle_models.Fresnel]] = {
    "white": ({"F0": 1.0}, lambda c: 1),
    "F0": ({"F0": f32(0.04)}, lambda c: oracle.fresnel_schlick(c, f32(0.04))),
    "black": ({"F0": 0.0}, lambda c: oracle.fresnel_schlick(c, 0)),
    "F82": (
        {"F0": f32(0.9), "F82_tint": 0.25},
        lambda c: oracle.fresnel_f82(c, f32(0.9), 0.25),
    ),
    "eta": ({"eta": 1.5}, lambda c: oracle.fresnel_dielectric(c, 1.5)),
    "near 1": ({"eta": f32(1 + 1e-4)}, lambda c: oracle.fresnel_dielectric(c, f32(1 + 1e-4))),
    "below 1": ({"eta": f32(1 / 1.5)}, lambda c: oracle.fresnel_dielectric(c, f32(1 / 1.5))),
    "k 0": ({"eta": 1.5, "k": 0.0}, lambda c: oracle.fresnel_dielectric(c, 1.5)),
    "eta 1": ({"eta": 1.0, "k": 0.0}, lambda c: mpf(0)),
    "metal": ({"eta": 0.5, "k": 3.0}, lambda c: oracle.fresnel_conductor(c, 0.5, 3)),
}


def shape(ax: float, ay: float, distribution: str, masking: str) -> dict[str, Any]:
    return {"alpha_x": ax, "alpha_y": ay, "distribution": distribution, "masking": masking}


def written(p: dict[str, Any]) -> dict[str, Any]:
    """Return the parameters as a model takes them: blinn_phong has one width."""
    if p["distribution"] != "blinn_phong":
        return p
    rest = {k: v for k, v in p.items() if not k.startswith("alpha")}
    return {**rest, "alpha": p["alpha_x"]}


def shapes(alphas: list[float]) -> list[Any]:
    """Every distribution with every masking and width, and two unequal widths."""
    made = []
    for d, m in itertools.product(DISTRIBUTIONS, MASKINGS):
        widths = [(a, a) for a in alphas]
        if d != "blinn_phong":
            widths += [(f32(1e-5), 1.0), (0.5, f32(1e-3)), (f32(0.1), f32(1e-4))]
        for k, (ax, ay) in enumerate(widths):
            p = shape(ax, ay, d, m)
            # The integral of blinn_phong's masking takes the oracle seconds.
            slow = d == "blinn_phong" and m != "v_cavity" and k % 3
            name = f"{d}-{m}-{ax:.2g}-{ay:.2g}"
            made.append(pytest.param(p, id=name, marks=[pytest.mark.slow] if slow else []))
    return made


@pytest.mark.parametrize("p", shapes(ROUGH))
def test_conductor(p: dict[str, Any]) -> None:
    eta, k = f32(GOLD["eta"][0]), f32(GOLD["k"][0])
    b = _core.Bsdf("conductor", {**GOLD, **written(p)})
    model = oracle_models.facets(p, lambda c: oracle.fresnel_conductor(c, eta, k))
    check_model(b, model, p, n=1 if p["distribution"] == "blinn_phong" else 2)


@pytest.mark.parametrize("fresnel", FRESNEL)
@pytest.mark.parametrize("p", shapes([f32(1e-4), f32(0.2), 1.0]))
def test_cook_torrance(p: dict[str, Any], fresnel: str) -> None:
    if p["distribution"] == "blinn_phong" and fresnel not in ("white", "F82"):
        pytest.skip("its masking is the same under every Fresnel term")
    params, reflectance = FRESNEL[fresnel]
    b = _core.Bsdf("cook_torrance", {**params, **written(p)})
    check_model(b, oracle_models.facets(p, reflectance), (p, fresnel), n=1)


@pytest.mark.parametrize("alpha", [1e-4, 1e-2, 0.3, 1.0])
@pytest.mark.parametrize("eta", [1 + 1e-4, 0.5, 1.33, 2.4, 100.0])
@pytest.mark.parametrize("masking", MASKINGS)
@pytest.mark.parametrize("distribution", ["ggx", "beckmann"])
def test_dielectric(alpha: float, eta: float, masking: str, distribution: str) -> None:
    eta = f32(eta)
    p = shape(f32(alpha), f32(alpha), distribution, masking)
    check_model(
        _core.Bsdf("dielectric", {"eta": eta, **p}), oracle_models.interface(p, eta), (p, eta)
    )


@pytest.mark.parametrize("eta", [1.5, f32(1 / 1.5)])
@pytest.mark.parametrize("masking", MASKINGS)
@pytest.mark.parametrize("distribution", ["ggx", "ward"])
def test_dielectric_of_two_widths(eta: float, masking: str, distribution: str) -> None:
    p = shape(f32(0.1), 0.5, distribution, masking)
    b = _core.Bsdf("dielectric", {"eta": eta, **p})
    check_model(b, oracle_models.interface(p, eta), (p, eta), n=4)


@pytest.mark.parametrize("fresnel", FRESNEL)
def test_smooth_metals_and_mirrors(fresnel: str) -> None:
    params, reflectance = FRESNEL[fresnel]
    other = "conductor" if "k" in params else "cook_torrance" if "F82_tint" in params else "mirror"
    for kind in {"cook_torrance", other}:
        smooth = {} if kind == "mirror" else {"alpha": 0.0}
        b = _core.Bsdf(kind, {**params, **smooth})
        for wo in views():
            s = b.sample(wo, [[0.5, 0.5, 0.5]])

            def f(*x: Any) -> Any:
                return (reflectance(oracle.vector(x)[2]),)

            assert s.pdf[0] == 1 and (s.wi[0] == wo * (-1, -1, 1)).all()
            check(f, wo, (kind, fresnel), s.weight[0, 0])


@pytest.mark.parametrize("eta", ETAS)
def test_smooth_glass(eta: float) -> None:
    eta = f32(eta)
    b = _core.Bsdf("dielectric", {"eta": eta, "alpha": 0.0})
    for wo in views():

        def f(*x: Any) -> Any:
            F = oracle.fresnel_dielectric(oracle.vector(x)[2], eta)
            return F, 1 - F

        reflected, passed = (b.sample(wo, [[u, 0.5, 0.5]]) for u in (0.0, 1 - 2**-24))
        got = [s.pdf[0] if s.lobe[0] & side else 0.0 for s, side in ((reflected, 8), (passed, 16))]
        exact = f(*wo)
        if exact[1] < 2**-23:  # rarer than any number the test can draw
            got[1] = float(exact[1])
        check(f, wo, eta, *got)
