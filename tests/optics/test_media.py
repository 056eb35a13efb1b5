"""Phase function and free flights: exact densities, exact sampling, weights that stay small."""

from __future__ import annotations

import numpy as np
import pytest

from matiere import _core

probe = _core.probe
G = [-0.999, -0.99, -0.5, -1e-3, 0.0, 1e-6, 0.3, 0.8, 0.99, 0.999]


def cdf(one_minus_cos: np.ndarray, g: float) -> np.ndarray:
    """Share of light deflected by more than the angle (the textbook's integral; g not 0)."""
    square = (1 - g) ** 2 + 2 * g * one_minus_cos
    return np.asarray((1 - g * g) / (2 * g) * (1 / np.sqrt(square) - 1 / (1 + g)))


@pytest.mark.parametrize("g", G)
def test_the_phase_function_integrates_to_one(g: float) -> None:
    x, w = np.polynomial.legendre.leggauss(400)
    down = 1 + x  # 1 - cos, refined towards the peak by a power
    peak = down**8 / 128 if g > 0 else 2 - (2 - down) ** 8 / 128
    jacobian = 8 * (down if g > 0 else 2 - down) ** 7 / 128
    value = probe.henyey_greenstein_double(peak, g)
    assert np.sum(w * jacobian * value) * 2 * np.pi == pytest.approx(1, rel=1e-9)


@pytest.mark.parametrize("g", G)
def test_directions_follow_the_phase_function(g: float) -> None:
    u = (np.arange(100000) + 0.5) / 100000
    down = probe.sample_henyey_greenstein_double(u, g)
    assert down.min() >= 0 and down.max() <= 2
    assert np.mean(1 - down) == pytest.approx(g, abs=1e-6)  # g is the mean cosine
    if abs(g) > 1e-4:
        assert cdf(down, g) == pytest.approx(u, abs=1e-9 / abs(g))
    else:
        assert 1 - down == pytest.approx(2 * u - 1, abs=2e-6)


@pytest.mark.parametrize("g", [-0.999, 0.0, 0.999])
def test_float_agrees_with_double(g: float) -> None:
    u = np.linspace(0, 1 - 2**-24, 1001, dtype=np.float32)
    ours = probe.sample_henyey_greenstein_float(u, g)
    truth = probe.sample_henyey_greenstein_double(u.astype(float), float(np.float32(g)))
    assert ours == pytest.approx(truth, rel=1e-6, abs=1e-12)


LANES = [
    ((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), (1.0, 1.0, 1.0)),
    ((0.5, 2.0, 9.0), (1.0, 2.5, 9.0), (1.0, 1.0, 1.0)),
    ((1e3, 0.0, 1e-3), (1e3, 0.5, 1e-3), (0.2, 1.0, 3.0)),
    ((0.0, 1.0, 0.0), (0.0, 1.0, 1e4), (1.0, 0.1, 1.0)),
    ((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), (0.0, 2.0, 0.0)),
]


@pytest.mark.parametrize(("sigma_s", "sigma_t", "carried"), LANES)
@pytest.mark.parametrize("end", [1e-3, 0.7, 6.0])
def test_flights_carry_what_they_should(sigma_s, sigma_t, carried, end) -> None:  # type: ignore[no-untyped-def]
    """Means: exp(-sigma_t d) reaches the end, albedo (1 - exp(-sigma_t d)) meets something."""
    n = 1 << 19
    u = np.random.default_rng(3).random((n, 2))
    meets, distance, out = probe.sample_flight_double(sigma_s, sigma_t, carried, end, u)
    s, t, c = (np.array(v) for v in (sigma_s, sigma_t, carried))
    left = np.exp(-t * end)
    albedo = np.divide(s, t, out=np.zeros(3), where=t > 0)
    for part, expected in ((~meets, c * left), (meets, c * albedo * (1 - left))):
        value = np.where(part[:, None], out, 0)
        error = value.std(0) / np.sqrt(n)
        gap = np.abs(value.mean(0) - expected)
        assert np.all(gap <= 4.5 * error + 1e-12), (value.mean(0), expected, error)
    assert np.all(distance[meets] < end)
    # No weight is large: the sum of the lanes never grows.
    assert np.all(out.sum(1) <= c.sum() * (1 + 1e-12))


def test_a_white_medium_loses_nothing_in_float() -> None:
    u = np.random.default_rng(3).random((4096, 2)).astype(np.float32)
    meets, _, out = probe.sample_flight_float((7.3,) * 3, (7.3,) * 3, (0.7,) * 3, 1.0, u)
    assert meets.any() and not meets.all()
    assert np.all(out == np.float32(0.7))
