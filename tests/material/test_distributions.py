"""The distributions of cook_torrance against each other and against quadrature."""

from __future__ import annotations

import numpy as np
import pytest

from matiere import _core

PRECISIONS = ("float", "double")


def pairs(n: int = 500) -> tuple[np.ndarray, np.ndarray]:
    w = np.random.default_rng(2).normal(size=(2, n, 3))
    w /= np.linalg.norm(w, axis=2, keepdims=True)
    w[..., 2] = np.abs(w[..., 2])
    return w[0], w[1]


NODES, WEIGHTS = np.polynomial.legendre.leggauss(1000)


def seen_area(exponent: float, z: float) -> float:
    """Integrate D(h) max(w.h, 0) over the hemisphere, in closed form over azimuth."""
    t, w = (NODES + 1) * np.pi / 4, WEIGHTS * np.pi / 4
    a, b = z * np.cos(t), np.sqrt(1 - z * z) * np.sin(t)
    turn = np.arccos(np.clip(-a / np.maximum(b, 1e-300), -1, 1))
    ring = np.where(a >= b, 2 * np.pi * a, 2 * (a * turn + b * np.sin(turn)))
    D = (exponent + 2) / (2 * np.pi) * np.cos(t) ** exponent
    return float(np.sum(w * D * np.sin(t) * ring))


@pytest.mark.parametrize("alpha", [1.0, 0.7, 0.3, 0.1])
@pytest.mark.parametrize("z", [0.9, 0.71, 0.7, 0.3, 0.01])
def test_blinn_phong_masking_is_the_integral_of_its_facets(alpha: float, z: float) -> None:
    exact = seen_area(2 / alpha**2 - 2, z)
    w = np.array([[np.sqrt(1 - z * z), 0, z]])
    for precision, tolerance in (("double", 1e-5), ("float", 2e-5)):
        made = getattr(_core.probe, f"Microfacet_{precision}")
        assert made(alpha, alpha, 3, 0).sigma(w)[0] == pytest.approx(exact, rel=tolerance)


@pytest.mark.parametrize("masking", ["smith", "smith_separable", "v_cavity"])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_blinn_phong_of_exponent_zero_is_ggx_of_alpha_one(masking: str, precision: str) -> None:
    o, i = pairs()
    shape = {"F0": 1.0, "masking": masking}
    phong = _core.Bsdf(
        "cook_torrance", {**shape, "exponent": 0.0, "distribution": "blinn_phong"}, precision
    )
    ggx = _core.Bsdf("cook_torrance", {**shape, "alpha": 1.0}, precision)
    tolerance = 1e-5 if precision == "float" else 1e-12
    assert phong.eval(o, i) == pytest.approx(ggx.eval(o, i), rel=tolerance)


@pytest.mark.parametrize("exponent", [1e5, 1e7])
def test_blinn_phong_of_a_high_exponent_is_beckmann(exponent: float) -> None:
    alpha = (2 / (exponent + 2)) ** 0.5
    slopes = np.random.default_rng(3).normal(size=(200, 2)) * alpha
    o = np.array([0.6, 0.0, 0.8])
    h = np.column_stack([-slopes, np.ones(200)])
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    i = 2 * (h @ o)[:, None] * h - o
    shape = {"F0": 1.0, "exponent": exponent}
    a = _core.Bsdf("cook_torrance", {**shape, "distribution": "blinn_phong"}, "double")
    b = _core.Bsdf("cook_torrance", {**shape, "distribution": "beckmann"}, "double")
    assert a.eval(o, i) == pytest.approx(b.eval(o, i), rel=200 / exponent)


def test_exponent_and_alpha_say_the_same() -> None:
    o, i = pairs()
    for exponent in (0.0, 10.0, 1e4):
        alpha = (2 / (exponent + 2)) ** 0.5
        a = _core.Bsdf("cook_torrance", {"exponent": exponent}, "double")
        b = _core.Bsdf("cook_torrance", {"alpha": alpha}, "double")
        assert a.eval(o, i) == pytest.approx(b.eval(o, i), rel=1e-12)


def test_ward_is_the_anisotropic_beckmann() -> None:
    o, i = pairs()
    shape = {"alpha_x": 0.2, "alpha_y": 0.5, "F0": 0.7}
    a = _core.Bsdf("cook_torrance", {**shape, "distribution": "ward"})
    b = _core.Bsdf("cook_torrance", {**shape, "distribution": "beckmann"})
    assert (a.eval(o, i) == b.eval(o, i)).all() and (a.pdf(o, i) == b.pdf(o, i)).all()


@pytest.mark.parametrize("kind", ["cook_torrance", "plastic", "dielectric"])
def test_blinn_phong_refuses_two_widths(kind: str) -> None:
    with pytest.raises(_core.SceneError, match="isotropic") as caught:
        _core.Bsdf(kind, {"alpha_x": 0.1, "alpha_y": 0.2, "distribution": "blinn_phong"})
    assert caught.value.pointer == "/alpha_x"
