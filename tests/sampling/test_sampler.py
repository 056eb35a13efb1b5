"""The sample source: uniform, stratified, a pure function of its coordinates."""

import numpy as np
import pytest
from scipy import stats

from matiere import _core

BLOCKS = [(0, 0), (0, 1), (3, 2), (700, 1)]


def unit(**keys: int) -> np.ndarray:
    return _core.sampler_bits(**keys) / 2.0**32


@pytest.mark.parametrize(("bounce", "purpose"), BLOCKS)
def test_every_power_of_two_prefix_is_stratified(bounce: int, purpose: int) -> None:
    """The first 2^k points put exactly one point into each of 2^k intervals, in each dimension."""
    for pixel in range(5):
        points = unit(
            seed=9, replicate=1, x=pixel, y=3, first=0, count=64, bounce=bounce, purpose=purpose
        )
        for k in range(1, 7):
            cells = np.floor(points[: 2**k] * 2**k).astype(int)
            for d in range(4):
                assert len(set(cells[:, d])) == 2**k


def test_second_and_third_dimension_form_a_net() -> None:
    """A (0, m, 2)-net: every elementary interval of area 2^-m holds one point."""
    points = unit(seed=1, replicate=0, x=5, y=5, first=0, count=64)[:, 1:3]
    for a in range(7):
        cells = np.floor(points * [2**a, 2 ** (6 - a)]).astype(int)
        assert len({tuple(c) for c in cells}) == 64


def test_points_are_uniform_over_pixels() -> None:
    """Over independent pixels each coordinate is uniform and uncorrelated with every other."""
    n = 4000
    columns = []
    for bounce, purpose in BLOCKS:
        rows = [
            unit(seed=5, replicate=0, x=i, y=0, first=3, count=1, bounce=bounce, purpose=purpose)
            for i in range(n)
        ]
        columns.append(np.concatenate(rows))
    table = np.concatenate(columns, axis=1)
    p_values = [stats.kstest(table[:, i], "uniform").pvalue for i in range(table.shape[1])]
    assert min(p_values) > 0.01 / len(p_values), p_values
    correlation = np.corrcoef(table.T) - np.eye(table.shape[1])
    assert np.abs(correlation).max() < 5 / np.sqrt(n), np.abs(correlation).max()


def test_replicates_are_uncorrelated() -> None:
    a = [unit(seed=5, replicate=0, x=i, y=1, first=0, count=1)[0] for i in range(4000)]
    b = [unit(seed=5, replicate=1, x=i, y=1, first=0, count=1)[0] for i in range(4000)]
    for d in range(4):
        r = np.corrcoef(np.array(a)[:, d], np.array(b)[:, d])[0, 1]
        assert abs(r) < 5 / np.sqrt(4000), r


def test_blocks_of_one_pixel_are_uncorrelated() -> None:
    """The index shuffle decouples blocks: their points do not move together."""
    total = []
    for pixel in range(300):
        a = unit(seed=2, replicate=0, x=pixel, y=0, first=0, count=64, bounce=0, purpose=1)
        b = unit(seed=2, replicate=0, x=pixel, y=0, first=0, count=64, bounce=1, purpose=1)
        total.append([np.corrcoef(a[:, d], b[:, d])[0, 1] for d in range(4)])
    z = np.mean(total, axis=0) * np.sqrt(300 * 64)
    assert np.abs(z).max() < 4.5, z


def test_a_value_depends_on_its_coordinates_alone() -> None:
    whole = _core.sampler_bits(seed=3, replicate=2, x=1, y=2, first=0, count=100)
    part = _core.sampler_bits(seed=3, replicate=2, x=1, y=2, first=40, count=10)
    assert np.array_equal(whole[40:50], part)


def test_integration_converges_faster_than_random() -> None:
    """A smooth 2-D integrand: the variance at 64 points is far below 1/64 of white noise."""
    estimates = []
    for pixel in range(200):
        u = unit(seed=0, replicate=0, x=pixel, y=9, first=0, count=64)
        estimates.append(np.mean(np.sin(3 * u[:, 1]) * np.exp(u[:, 2])))
    random_variance = 0.41 / 64
    assert np.var(estimates) < random_variance / 20, np.var(estimates)
