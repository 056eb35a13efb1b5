"""Closed forms of radiative transfer, computed here alone (Chandrasekhar 1950)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def h_function(albedo: float) -> Callable[[float], float]:
    """Return Chandrasekhar's H of isotropic scattering with a single-scattering albedo.

    1/H(mu) = sqrt(1 - a) + a/2 integral of mu' H(mu') / (mu + mu') dmu' (ch. V, eq. 14), iterated
    to a fixed point on 200 Gauss points.
    """
    x, w = np.polynomial.legendre.leggauss(200)
    mu, weight = (x + 1) / 2, w / 2
    root = np.sqrt(1 - albedo)
    h = np.ones_like(mu)
    kernel = mu / (mu[:, None] + mu)
    for _ in range(10000):
        new = 1 / (root + 0.5 * albedo * kernel @ (weight * h))
        change = np.abs(new - h).max()
        h = 0.5 * (h + new)
        if change < 1e-13:
            break

    def at(cosine: float) -> float:
        return float(1 / (root + 0.5 * albedo * np.sum(weight * mu * h / (cosine + mu))))

    return at


def plane_albedo(albedo: float, cosine: float) -> float:
    """Return the share of light a deep isotropic medium sends back from one direction."""
    return 1 - np.sqrt(1 - albedo) * h_function(albedo)(cosine)


def single_scattering(
    irradiance: float,
    sigma_s: np.ndarray,
    sigma_t: np.ndarray,
    g: float,
    cosine: float,
    mu_light: float,
    mu_eye: float,
    depth: float,
) -> np.ndarray:
    """Return the radiance of one event in a slab lit and seen from the same side.

    E sigma_s p(cos) times the integral over the way in, exp(-sigma_t (z / mu_eye + z / mu_light)).
    """
    phase = (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * cosine) ** 1.5)
    rate = sigma_t * (1 / mu_eye + 1 / mu_light)
    return np.asarray(irradiance * sigma_s * phase / mu_eye * (1 - np.exp(-rate * depth)) / rate)
