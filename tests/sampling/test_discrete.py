"""Discrete distributions are exactly what they say, however uneven."""

import numpy as np
import pytest

from matiere import _core

CASES = {
    "even": [1.0] * 7,
    "one": [0.0, 0.0, 3.0, 0.0],
    "tiny": [1e-30, 1.0, 1e-30, 1.0, 0.0],
    "steep": list(np.logspace(-12, 0, 1000)),
    "trailing zeros": [0.3, 0.7, 0.0, 0.0],
    "leading zeros": [0.0, 0.0, 0.7],
}


@pytest.mark.parametrize("weights", CASES.values(), ids=CASES.keys())
def test_probabilities_add_up_to_one_and_keep_support(weights: list[float]) -> None:
    p, _, _ = _core.discrete_sample(weights, np.zeros(1, np.uint32))
    assert abs(p.sum() - 1.0) <= 2.0**-24  # each is a count of lattice points, rounded to float
    assert np.array_equal(p > 0, np.array(weights) > 0)
    expected = np.array(weights) / np.sum(weights)
    bound = (len(weights) + 1) * 2.0**-31 + expected * 2.0**-24
    assert np.all(np.abs(p - expected) <= bound)


@pytest.mark.parametrize("weights", CASES.values(), ids=CASES.keys())
def test_sampling_matches_the_probabilities_exactly(weights: list[float]) -> None:
    """Counting an even comb of 2^20 inputs gives the probabilities to one tooth a cell."""
    n = 2**20
    u = (np.arange(n, dtype=np.uint64) * (2**32 // n)).astype(np.uint32)
    p, index, remainder = _core.discrete_sample(weights, u)
    counts = np.bincount(index, minlength=len(weights))
    assert np.abs(counts / n - p).max() <= 1.1 / n
    assert remainder.min() >= 0
    assert remainder.max() < 1


def test_the_last_input_finds_a_cell() -> None:
    u = np.array([0, 2**32 - 1], np.uint32)
    _, index, _ = _core.discrete_sample([0.0, 1.0, 2.0, 0.0], u)
    assert list(index) == [1, 2]


def test_no_weight_is_empty() -> None:
    p, index, _ = _core.discrete_sample([0.0, 0.0], np.zeros(3, np.uint32))
    assert p.size == 0
    assert index.size == 0
