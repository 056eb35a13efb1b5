"""Compare the float path of a model with its oracle, where its lobes are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import oracle
from mpmath import mpf
from numpy.typing import NDArray

Floats = NDArray[np.float32]


def f32(x: float) -> float:
    """Return what a float holds of x."""
    return float(np.float32(x))


def sampled_pairs(
    b: Any, n: int = 3, cosines: Sequence[float] = (1.0, 0.7, 0.05)
) -> list[tuple[Floats, Floats]]:
    """Return pairs of directions where the lobes are: sampled, rounded to float."""
    rng = np.random.default_rng(7)
    found = []
    for c in cosines:
        s = np.sqrt(1 - c * c)
        wo = np.array([s * np.cos(0.4), s * np.sin(0.4), c], dtype=np.float32)
        got = b.sample(wo, rng.random((8 * n, 3), dtype=np.float32))
        found += [(wo, wi) for wi in got.wi[(got.lobe != 0) & ((got.lobe & 4) == 0)][:n]]
    return found


def check(
    value: float, f: Callable[..., Any], wo: Floats, wi: Floats, what: object = None
) -> float:
    """Assert that value is f(*wo, *wi) within its bound; return error / bound."""
    inputs = [float(x) for x in (*wo, *wi)]
    exact = f(*inputs)
    if abs(exact) < mpf(10) ** -25:
        assert abs(value) < 1e-20, (what, wo, wi, value)
        return 0.0
    error = float(abs(mpf(float(value)) / exact - 1))
    allowed = oracle.bound(f, inputs)
    oracle.note(error, allowed)
    assert error <= allowed, (what, wo, wi, value, float(exact), error, allowed)
    return error / allowed
