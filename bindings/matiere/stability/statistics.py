"""Pearson's chi-square without a statistics library, and levels for many tests at once."""

from __future__ import annotations

import math

import numpy as np

from matiere.stability.charts import Floats

SMALLEST_COUNT = 10.0  # expected; smaller cells are pooled
MAX_TERMS = 10_000


def chi_square_p(expected: Floats, observed: Floats, variance: Floats | None = None) -> float:
    """Return the probability of so large a misfit by chance.

    `variance` is that of the expected counts themselves where they are estimates.
    """
    few = expected < SMALLEST_COUNT
    extra = np.zeros_like(expected) if variance is None else variance
    e = np.append(expected[~few], expected[few].sum())
    o = np.append(observed[~few], observed[few].sum())
    v = np.append(extra[~few], extra[few].sum())
    if e[-1] < SMALLEST_COUNT:  # too few even together: what Poisson allows
        if _poisson_above(o[-1], max(e[-1] + math.sqrt(v[-1]), 1e-3)) < 1e-9:
            return 0.0
        e, o, v = e[:-1], o[:-1], v[:-1]
    if len(e) < 2:
        return 1.0
    return chi_square_tail(float(np.sum((o - e) ** 2 / (e + v))), len(e) - 1)


def chi_square_tail(x: float, degrees: int) -> float:
    """Return P(chi-square with `degrees` >= x)."""
    return gamma_tail(degrees / 2, x / 2)


def gamma_tail(a: float, x: float) -> float:
    """Return the regularised upper incomplete gamma function Q(a, x).

    Series below a + 1, continued fraction above: Abramowitz & Stegun 1964, 6.5.29 and 6.5.31.
    """
    if x <= 0:
        return 1.0
    if not math.isfinite(x):
        return 0.0
    scale = math.exp(a * math.log(x) - x - math.lgamma(a))
    if x < a + 1:
        term = total = 1 / a
        for n in range(1, MAX_TERMS):
            term *= x / (a + n)
            total += term
            if term < total * 1e-16:
                break
        return max(0.0, 1 - total * scale)
    b = x + 1 - a
    c, d = 1e300, 1 / b
    value = d
    for n in range(1, MAX_TERMS):
        factor = -n * (n - a)
        b += 2
        d = 1 / (factor * d + b)
        c = b + factor / c
        value *= c * d
        if abs(c * d - 1) < 1e-15:
            break
    return value * scale


def _poisson_above(count: float, mean: float) -> float:
    """Return P(Poisson >= count)."""
    return 1 - gamma_tail(count, mean) if count > 0 else 1.0


def sidak(level: float, tests: int) -> float:
    """Return the level of one test so that all together keep `level` (Sidak 1967)."""
    return -math.expm1(math.log1p(-level) / tests)
