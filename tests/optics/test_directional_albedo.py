"""Tables of directional albedo against quadrature and against the published numbers."""

from __future__ import annotations

import numpy as np
import pytest

from matiere import _core

GGX, BECKMANN = 0, 1
SMITH, SEPARABLE, V_CAVITY = 0, 1, 2
ANGLES = np.array([0, 30, 60, 75, 85, 89])
COSINES = np.cos(np.radians(ANGLES))

# Specification of the materials, section 1: Beckmann, V-cavity, F = 1.
V_CAVITY_BECKMANN = {
    0.1: [1.0000, 1.0000, 0.9991, 0.9699, 0.9375, 0.9836],
    0.3: [0.9956, 0.9812, 0.9248, 0.9273, 0.9702, 0.9939],
    0.6: [0.7976, 0.8042, 0.8735, 0.9334, 0.9775, 0.9954],
    1.0: [0.4535, 0.5296, 0.7917, 0.9063, 0.9695, 0.9938],
}
# Section 8: cosine-weighted averages of height-correlated GGX.
GGX_AVERAGE = {0.25: 0.8823, 0.5: 0.7002, 1.0: 0.4091}


@pytest.mark.parametrize("alpha", V_CAVITY_BECKMANN)
def test_v_cavity_beckmann_albedo_is_the_published_one(alpha: float) -> None:
    direct, _, _ = _core.probe.albedo_table(alpha, BECKMANN, V_CAVITY, COSINES)
    assert np.abs(direct[:, 0] - V_CAVITY_BECKMANN[alpha]).max() < 2e-3, direct[:, 0]


@pytest.mark.parametrize("alpha", GGX_AVERAGE)
def test_ggx_average_albedo_is_the_published_one(alpha: float) -> None:
    _, _, average = _core.probe.albedo_table(alpha, GGX, SMITH, COSINES)
    assert average[0] == pytest.approx(GGX_AVERAGE[alpha], abs=2e-4)


@pytest.mark.parametrize("alpha", [1e-4, 1e-3, 0.01, 0.03, 0.1, 0.3, 1.0])
@pytest.mark.parametrize("distribution", [GGX, BECKMANN])
@pytest.mark.parametrize("masking", [SMITH, SEPARABLE, V_CAVITY])
def test_lookups_are_within_a_thousandth_of_quadrature(
    alpha: float, distribution: int, masking: int
) -> None:
    cosines = np.linspace(0.0125, 1.0, 80) ** 2
    direct, looked_up, _ = _core.probe.albedo_table(alpha, distribution, masking, cosines)
    gap = np.abs(direct - looked_up)
    worst = int(gap.max(axis=1).argmax())
    assert gap.max() <= 1e-3, (cosines[worst], direct[worst], looked_up[worst])


@pytest.mark.parametrize("alpha", [1e-3, 0.03, 0.1, 0.3, 1.0])
@pytest.mark.parametrize("distribution", [GGX, BECKMANN])
@pytest.mark.parametrize("masking", [SMITH, SEPARABLE, V_CAVITY])
def test_lookups_agree_with_the_sampler(alpha: float, distribution: int, masking: int) -> None:
    shape = {
        "alpha": alpha,
        "distribution": ("ggx", "beckmann")[distribution],
        "masking": ("smith", "smith_separable", "v_cavity")[masking],
    }
    cosines = np.array([0.01, 0.1, 0.4, 0.8, 1.0])
    wo = np.stack([np.sqrt(1 - cosines**2), 0 * cosines, cosines], axis=1)
    _, looked_up, _ = _core.probe.albedo_table(alpha, distribution, masking, cosines)
    sampled = _core.Bsdf("cook_torrance", {"F0": 1.0, **shape}, "double").albedo(wo, n=1 << 15)
    gap = np.abs(sampled[:, 0] - looked_up[:, 0])
    assert gap.max() <= 1e-3, (gap, sampled[:, 0])


def test_a_smooth_surface_averages_schlick_in_closed_form() -> None:
    _, _, average = _core.probe.albedo_table(0.0, GGX, SMITH, COSINES)
    assert average == pytest.approx((1, 1 / 21, 1 / 126), abs=1e-5)
