"""Beer-Lambert absorption at its limits."""

from __future__ import annotations

import numpy as np
import pytest
from extremes import OPTICAL_DEPTHS

from matiere import _core

transmittance = _core.probe.beer_lambert_float


@pytest.mark.parametrize("depth", OPTICAL_DEPTHS)
@pytest.mark.parametrize("distance", [1e-6, 1.0, 1e6])
def test_transmittance_is_exponential_in_optical_depth(depth: float, distance: float) -> None:
    value = transmittance(depth / distance, distance)
    assert value == pytest.approx(np.exp(-depth), rel=1e-6 * max(1, depth), abs=1e-38)


def test_no_way_absorbs_nothing_even_in_a_black_medium() -> None:
    black = float(np.finfo(np.float32).max)
    assert transmittance(black, 0.0) == 1
    assert transmittance(black, 1e-6) == 0
    assert transmittance(0.0, np.inf) == 1


def record(params: dict[str, object]) -> dict[str, object]:
    return _core.probe.Materials([{"type": "dielectric", "params": params}]).record(0)


def test_the_three_ways_to_state_absorption_agree() -> None:
    sigma = -np.log(0.25) / 0.5
    given = [
        {"sigma_a": sigma},
        {"transmittance": 0.25, "at_distance": 0.5},
        {"attenuation_per_metre": 0.25**2},
    ]
    for params in given:
        assert record(params)["sigma_a"] == pytest.approx([sigma] * 3, rel=1e-6), params


def test_a_factor_below_one_attenuates() -> None:
    # The course's exp(-log(a) d) grows; the law is a^d.
    sigma = record({"attenuation_per_metre": 0.5})["sigma_a"][0]
    assert transmittance(sigma, 1.0) == pytest.approx(0.5, rel=1e-6)
    assert transmittance(sigma, 2.0) == pytest.approx(0.25, rel=1e-6)


def test_zero_transmittance_is_a_black_medium_and_one_a_clear_one() -> None:
    black = record({"transmittance": 0.0, "at_distance": 1.0})["sigma_a"][0]
    assert np.isfinite(black) and transmittance(black, 1e-3) == 0 and transmittance(black, 0.0) == 1
    assert record({"transmittance": 1.0, "at_distance": 1.0})["sigma_a"] == (0, 0, 0)
