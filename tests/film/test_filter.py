"""Pixel filters: sampled in proportion to their value."""

import numpy as np
import pytest
from scipy import stats

from matiere import _core

NAMES = ["box", "tent", "gaussian", "blackman_harris"]


def stratified(n: int, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.random((n, 2)).astype(np.float32)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("radius", [0.0, 0.75, 3.0])
def test_samples_follow_the_density(name: str, radius: float) -> None:
    f = _core.Filter(name, radius)
    x = f.sample(stratified(200_000)).astype(float)
    assert np.abs(x).max() <= f.radius
    edges = np.linspace(-f.radius, f.radius, 65)
    fine = np.linspace(-f.radius, f.radius, 64 * 64 + 1)
    middle = 0.5 * (fine[1:] + fine[:-1])
    share = f.density(middle).reshape(64, 64).mean(1) * (edges[1] - edges[0])
    assert share.sum() == pytest.approx(1.0, abs=2e-4)
    for axis in range(2):
        counts, _ = np.histogram(x[:, axis], edges)
        expected = share / share.sum() * len(x)
        rare = expected < 5  # pool the thin tails, as chi-square needs
        observed = np.append(counts[~rare], counts[rare].sum())
        wanted = np.append(expected[~rare], expected[rare].sum())
        keep = wanted > 0
        p = stats.chisquare(observed[keep], wanted[keep]).pvalue
        assert p > 1e-4, (name, radius, axis, p)


@pytest.mark.parametrize("name", NAMES)
def test_offsets_rise_with_u_and_are_symmetric(name: str) -> None:
    f = _core.Filter(name)
    u = np.linspace(0, 1, 4001, endpoint=False, dtype=np.float32)
    x = f.sample(np.stack([u, u], 1))[:, 0]
    assert (np.diff(x) >= 0).all()
    k = np.arange(1, 2**12, dtype=np.float32) / 2**13  # exact, and so is 1 - k
    left = f.sample(np.stack([k, k], 1))[:, 0]
    right = f.sample(np.stack([1 - k, 1 - k], 1))[:, 0]
    np.testing.assert_array_equal(left, -right)


@pytest.mark.parametrize("name", NAMES)
def test_the_largest_variate_stays_inside(name: str) -> None:
    f = _core.Filter(name)
    top = np.nextafter(np.float32(1), np.float32(0))
    corners = np.array([[0, 0], [top, top], [0.5, 0.5]], np.float32)
    x = f.sample(corners)
    assert np.isfinite(x).all() and np.abs(x).max() <= f.radius
    assert np.abs(x[2]).max() < 1e-6


def test_unknown_names_and_radii_are_refused() -> None:
    with pytest.raises(_core.SceneError, match="blackman_harris") as caught:
        _core.Filter("mitchell")
    assert caught.value.pointer == "/film/filter"
    with pytest.raises(_core.SceneError):
        _core.Filter("box", 17.0)
    with pytest.raises(_core.SceneError):
        _core.Filter("box", float("nan"))
