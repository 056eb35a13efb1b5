"""Multiple scattering between facets fills the furnace, in the colour of repeated reflection."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from extremes import direction

from matiere import _core

DEGREES = (0.0, 30.0, 60.0, 75.0, 85.0, 89.0)
ALPHAS = [
    pytest.param(a, marks=() if a == 0.3 else pytest.mark.slow)
    for a in (1e-3, 0.03, 0.1, 0.3, 0.6, 1.0)
]
SHAPES: list[dict[str, Any]] = [
    {"distribution": d, "masking": m}
    for d in ("ggx", "beckmann", "blinn_phong")
    for m in ("smith", "v_cavity")
]


def views() -> np.ndarray:
    return np.array([direction(d, 0.4) for d in DEGREES])


@pytest.mark.parametrize("shape", SHAPES, ids=lambda s: "-".join(s.values()))
@pytest.mark.parametrize("alpha", ALPHAS)
def test_a_white_rough_mirror_keeps_albedo_one(alpha: float, shape: dict[str, Any]) -> None:
    b = _core.Bsdf("cook_torrance", {"F0": 1.0, "alpha": alpha, "multiscatter": True, **shape})
    albedo = b.albedo(views(), n=1 << 16)[:, 0]
    assert np.abs(albedo - 1).max() < 1e-3, albedo


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("eta", [1.5, 2.4, 0.7])
@pytest.mark.parametrize("alpha", ALPHAS)
def test_a_lossless_rough_interface_keeps_all_light(alpha: float, eta: float, side: int) -> None:
    b = _core.Bsdf("dielectric", {"eta": eta, "alpha": alpha, "multiscatter": True})
    albedo = b.albedo(views() * (1, 1, side), n=1 << 16)[:, 0]
    assert np.abs(albedo - 1).max() < 1e-3, albedo


@pytest.mark.parametrize("masking", ["smith_separable", "v_cavity"])
def test_an_interface_keeps_all_light_under_any_masking(masking: str) -> None:
    b = _core.Bsdf("dielectric", {"alpha": 1.0, "masking": masking, "multiscatter": True})
    albedo = b.albedo(np.concatenate([views(), views() * (1, 1, -1)]), n=1 << 17)[:, 0]
    assert np.abs(albedo - 1).max() < 1e-3, albedo


def test_two_widths_keep_all_light_too() -> None:
    shape = {"alpha_x": 0.1, "alpha_y": 0.9, "multiscatter": True}
    albedo = _core.Bsdf("cook_torrance", {"F0": 1.0, **shape}).albedo(views(), n=1 << 14)[:, 0]
    assert np.abs(albedo - 1).max() < 1e-3, albedo


def test_every_further_bounce_takes_the_colour_once_more() -> None:
    # Specification, section 8: sum over k >= 2 of F^k (1-E)^(k-1) E / (1-E) = F^2 E / (1-F(1-E)).
    F = np.array([0.9, 0.5, 0.1])
    w = views()
    shape = {"alpha": 1.0, "multiscatter": True}
    e = 0.409  # E_avg of GGX at alpha 1
    E = _core.Bsdf("cook_torrance", {"F0": 1.0, "alpha": 1.0}).albedo(w, n=1 << 14)[:, :1]
    b = _core.Bsdf("cook_torrance", {"F0": list(F), "F82_tint": 1.0, **shape}, "double")
    plain = _core.Bsdf("cook_torrance", {"F0": list(F), "F82_tint": 1.0, "alpha": 1.0}, "double")
    F_avg = F + (1 - F) / 21
    added = (b.albedo(w, n=1 << 14) - plain.albedo(w, n=1 << 14)) / (1 - E)
    assert np.abs(added - F_avg**2 * e / (1 - F_avg * (1 - e))).max() < 2e-3, added


def test_a_smooth_surface_has_nothing_to_add() -> None:
    w = views()
    for kind in ("cook_torrance", "dielectric"):
        a = _core.Bsdf(kind, {"alpha": 0.0, "multiscatter": True})
        b = _core.Bsdf(kind, {"alpha": 0.0})
        assert a.lobes == b.lobes and (a.albedo(w) == b.albedo(w)).all()


def test_interfaces_in_another_medium_keep_all_light_too() -> None:
    ice = {"type": "dielectric", "params": {"eta": 1.31, "alpha": 0.7, "multiscatter": True}}
    water = {"type": "dielectric", "params": {"eta": 1.333}}
    glass = {"type": "dielectric", "params": {"eta": 1.52}}
    table = _core.probe.Materials([ice, water, glass])
    point = {"n_g": (0, 0, 1), "n_s": (0, 0, 1)}
    u = np.random.default_rng(1).random((40_000, 3), dtype=np.float32)
    for outside in (1.0, 1.333, 1.52):
        ratio = 1.31 / outside
        for z in (1.0, 0.3):
            wo = (float(np.sqrt(1 - z * z)), 0.0, z)
            wi, weight, _, _ = table.sample(0, point, wo, u, eta_rel=ratio)
            energy = np.where(wi[:, 2] < 0, weight[:, 0] * ratio**2, weight[:, 0])
            error = energy.std() / np.sqrt(len(energy))
            assert abs(energy.mean() - 1) < 1e-3 + 4 * error, (outside, z, energy.mean())
