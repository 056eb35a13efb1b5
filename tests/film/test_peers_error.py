"""The error measure of ./dev bench peers finds a known variance, whatever the reference's noise."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

BENCH = Path(__file__).resolve().parents[1] / "bench" / "peers.py"
EDGE = 256


@pytest.fixture(scope="module")
def peers() -> ModuleType:
    spec = importlib.util.spec_from_file_location("bench_peers", BENCH)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    before = list(sys.path)
    sys.modules["bench_peers"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    sys.path[:] = before
    return module


@pytest.mark.parametrize("noise", [0.01, 0.1])
def test_noise_of_the_reference_is_taken_off(peers: ModuleType, noise: float) -> None:
    rng = np.random.default_rng(1)
    truth = rng.uniform(1, 2, (EDGE, EDGE, 3))
    image = truth + rng.normal(0, 0.1, truth.shape)
    halves = tuple(truth + rng.normal(0, noise, truth.shape) for _ in range(2))
    below = truth**2 + peers.FLOOR * truth.mean() ** 2
    expected = (0.1**2 / below).mean()
    # 1 % for the worst pixels that are left out, 2 % for 1 / R^2 of a noisy R
    assert peers.trimmed_relmse(image, halves) == pytest.approx(expected, rel=0.03)
    raw = ((image - (halves[0] + halves[1]) / 2) ** 2 / below).mean()
    if noise == 0.1:
        assert raw > 1.4 * expected


def test_the_worst_pixels_are_left_out(peers: ModuleType) -> None:
    truth = np.ones((EDGE, EDGE, 3))
    image = truth + 0.1
    clean = peers.trimmed_relmse(image, (truth, truth))
    image.reshape(-1, 3)[: round(peers.TRIM * EDGE * EDGE)] = 1000
    assert peers.trimmed_relmse(image, (truth, truth)) == pytest.approx(clean)
    image.reshape(-1, 3)[: 2 * round(peers.TRIM * EDGE * EDGE)] = 1000
    assert peers.trimmed_relmse(image, (truth, truth)) > 100 * clean


def test_the_standard_error_of_a_mean_is_right(peers: ModuleType) -> None:
    rng = np.random.default_rng(2)
    halves = tuple(1 + rng.normal(0, 0.3, (EDGE, EDGE, 3)) for _ in range(2))
    mean, error = peers.mean_and_error(halves)
    assert error == pytest.approx(0.3 / np.sqrt(6) / EDGE, rel=0.02)
    assert abs(mean - 1) < 4 * error
