"""Specks are held back, and nothing else is."""

from pathlib import Path

import numpy as np
import pytest
from film_scenes import scenes

import matiere as mt
from matiere.despeckle import FACTOR, LUMINANCE, despeckle
from matiere.imageio import read_image


def replicates(seed: int = 1, size: int = 48, noise: float = 0.1) -> np.ndarray:
    """Four noisy replicates of a ramp with a bright line one pixel wide."""
    base = np.linspace(0.1, 1.0, size)[None, :, None] * np.ones((size, size, 3))
    base[:, size // 2] = 20.0
    draws = np.random.default_rng(seed).normal(1.0, noise, (4, size, size, 1))
    return base[None] * np.maximum(draws, 0.0)


def test_a_speck_goes_and_a_highlight_stays() -> None:
    made = replicates()
    made[2, 10, 30] += 500.0  # one lucky path
    found = despeckle(made)
    around = made[:, 8:13, 28:33].mean()
    assert found.mean[10, 30].mean() < 2 * around
    kept = np.ones((48, 48), bool)
    kept[10, 30] = False
    np.testing.assert_array_equal(found.mean[kept], made.mean(axis=0)[kept])
    assert found.pixels == pytest.approx(1 / 48**2)
    lost = (made.mean(axis=0) - found.mean) @ LUMINANCE
    assert found.energy == pytest.approx(lost.sum() / (made.mean(axis=0) @ LUMINANCE).sum())


def test_a_single_bright_pixel_that_all_replicates_see_is_kept() -> None:
    made = replicates()
    made[:, 20, 12] *= 300.0
    np.testing.assert_array_equal(despeckle(made).mean, made.mean(axis=0))


def test_scaling_the_light_scales_the_answer() -> None:
    made = replicates(noise=0.8)
    small, large = despeckle(made), despeckle(made * 2.0**40)
    np.testing.assert_array_equal(small.mean * 2.0**40, large.mean)
    assert 0 < small.energy == large.energy


def test_more_samples_leave_less_to_hold_back() -> None:
    """Heavy-tailed samples: what is held back falls as the replicates come to agree."""
    rng = np.random.default_rng(5)
    shares = []
    for count in (8, 128, 2048):
        light = np.where(rng.random((4, 24, 24, count)) < 0.02, 50.0, 0.0).mean(axis=3)
        shares.append(despeckle(np.repeat(light[..., None], 3, axis=3)).energy)
    assert shares[0] > 0.3 and shares[0] > shares[1] > shares[2] and shares[2] < 1e-3


@pytest.mark.parametrize("count", [1, 2, 3, 8])
def test_any_number_of_replicates(count: int) -> None:
    made = np.ones((count, 9, 9, 3))
    made[0, 4, 4] = 100.0
    bright = despeckle(made).mean[4, 4, 0]
    assert bright == pytest.approx(100.0 if count == 1 else (FACTOR + count - 1) / count)


def test_black_and_empty_pictures() -> None:
    assert despeckle(np.zeros((4, 5, 7, 3))).energy == 0.0
    alone = np.zeros((4, 5, 7, 3))
    alone[1, 2, 3] = 8.0  # light that nothing vouches for
    assert despeckle(alone).mean.max() == 0.0


def test_pictures_leave_specks_out_and_exr_keeps_them(tmp_path: Path) -> None:
    film = mt.render(mt.load(scenes(24)["diffuse"]), spp=8, seed=1)
    assert 0 <= film.despeckled.energy < 1
    held = mt.develop(film, despeckle=True)
    assert held.shape == mt.develop(film).shape
    mt.write_image(tmp_path / "a.exr", film)
    mt.write_image(tmp_path / "b.exr", film, despeckle=True)
    raw, other = (read_image(tmp_path / name).pixels for name in ("a.exr", "b.exr"))
    np.testing.assert_array_equal(raw, other)
    with pytest.raises(mt.ImageError, match="no replicates"):
        mt.develop(film.mean, despeckle=True)
