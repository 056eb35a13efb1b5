"""Directional albedo by quadrature over half vectors, without a model's own sampler."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Doubles = NDArray[np.float64]
nodes_and_weights = lru_cache(np.polynomial.legendre.leggauss)


def albedo(b: Any, wo: Doubles, ax: float, ay: float, nodes: int = 160) -> float:
    """Return the integral of b.eval over the hemisphere, for a lobe about the facets whose slopes
    are about (ax, ay) wide."""
    x, w = nodes_and_weights(nodes)
    t, w = (x + 1) / 2, w / 2
    # Azimuths gather where facets turn from wo: at grazing all changes there.
    across = np.arctan2(-ax * wo[0], ay * wo[1])
    half, share = nodes_and_weights(nodes // 2)
    phi = across + np.concatenate([(half + 1) / 2, (half + 3) / 2]) * np.pi
    share = np.concatenate([share, share]) / 4
    # Slopes (ax r cos, ay r sin) with r = t / (1 - t); solid angle of h = cos^3 times their area.
    r, jacobian = t / (1 - t), t / (1 - t) ** 3
    slopes = np.stack([np.outer(r, ax * np.cos(phi)), np.outer(r, ay * np.sin(phi))], -1)
    h = np.concatenate([-slopes, np.ones((nodes, nodes, 1))], -1)
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    oh = h @ wo
    wi = 2 * oh[..., None] * h - wo
    seen = (oh > 0) & (wi[..., 2] > 0)
    f = np.zeros(seen.shape)
    f[seen] = b.eval(wo, wi[seen])[:, 0]
    # d wi = 4 (o.h) d h
    rings = (f * 4 * np.maximum(oh, 0) * h[..., 2] ** 3) @ share
    return float(2 * np.pi * ax * ay * np.sum(rings * jacobian * w))


def average(b: Any, ax: float, ay: float, nodes: int = 64, azimuths: int = 1) -> float:
    """Return the cosine-weighted average of `albedo` over the hemisphere."""
    x, w = nodes_and_weights(16)
    s = (x + 1) / 2  # mu = s^2 gathers nodes at grazing
    total = 0.0
    for k in range(azimuths):
        phi = (k + 0.5) / azimuths * np.pi / 2
        for root, weight in zip(s, w / 2, strict=True):
            mu = root * root
            sine = np.sqrt(1 - mu * mu)
            wo = np.array([sine * np.cos(phi), sine * np.sin(phi), mu])
            total += 2 * mu * 2 * root * weight * albedo(b, wo, ax, ay, nodes) / azimuths
    return total
