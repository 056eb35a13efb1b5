"""Compare the float path of a model with its oracle, where its lobes are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import oracle
from extremes import direction
from mpmath import mpf
from numpy.typing import NDArray

Floats = NDArray[np.float32]
#: [deg] where models are compared with their oracles.
DEGREES = (0.0, 45.0, 85.0, 89.9)
OTHERS = (0.0, 30.0, 70.0, 85.0, 89.9)


def f32(x: float) -> float:
    """Return what a float holds of x."""
    return float(np.float32(x))


def views(degrees: Sequence[float] = DEGREES) -> list[Floats]:
    """Return directions at angles from the normal, rounded to float."""
    return [np.array(direction(d, 0.4), dtype=np.float32) for d in degrees]


def directions() -> list[tuple[Floats, Floats]]:
    """Return pairs far from each other's mirror image, and each other's mirror image."""
    found = []
    for o in views(DEGREES):
        for i in views(OTHERS):
            turned = np.array([-i[1], i[0], i[2]], np.float32)
            found += [(o, turned), (o, i * np.float32([-1, -1, 1]))]
    return found


def sampled_pairs(
    b: Any, n: int = 3, degrees: Sequence[float] = DEGREES
) -> list[tuple[Floats, Floats]]:
    """Return pairs of directions where the lobes are: sampled, rounded to float."""
    rng = np.random.default_rng(7)
    found = []
    for wo in views(degrees):
        got = b.sample(wo, rng.random((8 * n, 3), dtype=np.float32))
        found += [(wo, wi) for wi in got.wi[(got.lobe != 0) & ((got.lobe & 4) == 0)][:n]]
    return found


def gap(value: float, exact: Any) -> float:
    """Return the relative error; none where the value is too small for float."""
    if abs(exact) < mpf(10) ** -25:
        return 0.0 if abs(value) < 1e-20 else float("inf")
    return float(abs(mpf(float(value)) / exact - 1))


def check(f: Callable[..., Any], inputs: Sequence[float], what: object, *values: float) -> None:
    """Assert that values are those of f at its inputs, each within its bound."""
    inputs = [float(x) for x in inputs]
    exact = f(*inputs)
    errors = [gap(*pair) for pair in zip(values, exact, strict=True)]
    if max(errors) <= oracle.ALWAYS and not oracle.curious(max(errors)):
        for error in errors:  # within every bound: condition numbers would take most of the time
            oracle.note(error, float("inf"))
        return
    _, conditions = oracle.conditions(f, inputs)
    for k, (error, condition) in enumerate(zip(errors, conditions, strict=True)):
        allowed = oracle.allowance(condition)
        oracle.note(error, allowed)
        assert error <= allowed, (what, k, inputs, values[k], float(exact[k]), error, allowed)


def check_model(b: Any, f: Callable[..., Any], what: object, pairs: Any = None, n: int = 2) -> None:
    """Assert that eval and pdf of a float model are f(*wo, *wi) where its samples go."""
    for wo, wi in sampled_pairs(b, n) if pairs is None else pairs:
        check(f, (*wo, *wi), what, b.eval(wo, wi)[0, 0], b.pdf(wo, wi)[0])


def judge_table(value: float, exact: float, white: float, what: object) -> None:
    """Assert that a value with tables of albedos in it is within 1e-3 of its quadrature, or of what
    a white Lambert surface scatters there, `white`, where it is less."""
    error = abs(float(value) - exact) / max(exact, white)
    oracle.note(error, 1e-3, "table")
    assert error <= 1e-3, (what, value, exact, error)
