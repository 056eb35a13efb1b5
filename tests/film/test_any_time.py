"""Intervals at any confidence, looks of one run together, percent RMSE, tiles, Student's t."""

from typing import Any

import numpy as np
import pytest
from scipy import stats

from matiere import _core

COLOURS = np.array([1.0, 0.5, 0.25])  # of every synthetic integrand
SIZE = 24


def true_mean(size: int) -> np.ndarray:
    y, x = np.mgrid[0:size, 0:size]
    return _core.synthetic_mean(x, y)[..., None] * COLOURS


@pytest.mark.parametrize("dof", [3, 4.5, 10, 75, 1000])
def test_student_agrees_with_scipy(dof: float) -> None:
    tails = np.array([0.4, 0.1, 0.025, 1e-4, 1e-7])
    np.testing.assert_allclose(
        _core.student_quantile(tails, dof), stats.t.isf(tails, dof), rtol=1e-8
    )
    t = np.array([0.0, 0.3, 2.0, 30.0])
    np.testing.assert_allclose(_core.student_tail(t, dof), stats.t.sf(t, dof), rtol=1e-7)


def test_the_misses_of_all_looks_sum_to_five_percent() -> None:
    misses = [1 - _core.look_confidence(k) for k in range(1, 10_000)]
    assert sum(misses) == pytest.approx(0.05, rel=1e-3) and sum(misses) <= 0.05


def test_looks_are_numbered_by_the_samples_alone() -> None:
    plan = _core.Plan(64, 64, 4)
    looks = [plan.boundary(k) for k in range(1, 80) if plan.is_look(plan.boundary(k), 8)]
    assert [plan.look_number(spp) for spp in looks] == list(range(1, len(looks) + 1))
    between = next(b + 16 for b in looks if b > 256 and not plan.is_look(b + 16, 8))
    assert plan.look_number(between) == plan.look_number(between - 16)


def looks_of_a_run(kind: str, spread: float, seed: int) -> list[dict[str, Any]]:
    film, mean = _core.Film(SIZE, SIZE, 4), true_mean(SIZE)
    rows = []
    for spp in (16, 32, 64, 128, 256):
        _core.render_synthetic(film, kind, {"spp": spp}, spread, seed, 1)
        gap = film.mean()[..., :3] - mean
        weights = film.error_weights()
        percent = 100 * np.sqrt((gap**2).mean()) / mean.mean()
        rows.append(
            {**film.estimate(), "realised": float((weights * gap**2).mean()), "percent": percent}
        )
    return rows


@pytest.mark.parametrize(("kind", "spread"), [("gaussian", 0.5), ("lognormal", 2.0)])
def test_the_any_time_interval_holds_at_every_look_of_a_run(kind: str, spread: float) -> None:
    """60 runs of five looks: one look may miss 5 % of the time, a whole run no more often."""
    missed = {"any_time": 0, "percent": 0, "percent_any_time": 0}
    for seed in range(60):
        rows = looks_of_a_run(kind, spread, seed)
        last = rows[-1]
        missed["any_time"] += any(
            not r["any_time_lower"] <= r["realised"] <= r["any_time_upper"] for r in rows
        )
        missed["percent_any_time"] += any(
            not r["rmse_percent_any_time_lower"] <= r["percent"] <= r["rmse_percent_any_time_upper"]
            for r in rows
        )
        missed["percent"] += not (
            last["rmse_percent_lower"] <= last["percent"] <= last["rmse_percent_upper"]
        )
        for r in rows:
            assert r["any_time_lower"] < r["lower"] < r["relmse"] < r["upper"] < r["any_time_upper"]
    # binomial, P < 0.2 % at 5 %
    assert max(missed.values()) <= 9, missed


def test_percent_rmse_is_rmse_over_the_mean() -> None:
    film = _core.Film(SIZE, SIZE, 4)
    _core.render_synthetic(film, "gaussian", {"spp": 64}, 0.5, 3, 1)
    e = film.estimate()
    assert e["rmse_percent"] == pytest.approx(
        100 * np.sqrt(film.mean_variance().mean()) / film.mean()[..., :3].mean(), rel=1e-12
    )


@pytest.mark.parametrize("edge", [5, 8, 24, 100])
def test_tiles_add_up_to_the_image(edge: int) -> None:
    film = _core.Film(SIZE, SIZE, 4)
    _core.render_synthetic(film, "lognormal", {"spp": 32}, 1.0, 1, 1)
    tiles, image = film.tiles(edge), film.estimate()
    area = [(t["x1"] - t["x0"]) * (t["y1"] - t["y0"]) for t in tiles]
    assert sum(area) == SIZE * SIZE
    assert np.average([t["relmse"] for t in tiles], weights=area) == pytest.approx(image["relmse"])
    mean = np.average([t["mean"] for t in tiles], axis=0, weights=area)
    np.testing.assert_allclose(mean, film.mean()[..., :3].mean((0, 1)))
    for t in tiles:
        part = np.s_[t["y0"] : t["y1"], t["x0"] : t["x1"]]
        pixels = film.mean_variance()[part]
        expected = np.sqrt(pixels.sum((0, 1))) / (pixels.shape[0] * pixels.shape[1])
        np.testing.assert_allclose(t["mean_standard_error"], expected)


def test_a_tile_interval_holds_its_own_error() -> None:
    mean, inside, runs = true_mean(SIZE), 0, 0
    for seed in range(20):
        film = _core.Film(SIZE, SIZE, 4)
        _core.render_synthetic(film, "gaussian", {"spp": 64}, 0.5, seed, 1)
        gap = film.error_weights() * (film.mean()[..., :3] - mean) ** 2
        for t in film.tiles(8):
            realised = gap[t["y0"] : t["y1"], t["x0"] : t["x1"]].mean()
            inside += t["lower"] <= realised <= t["upper"]
            runs += 1
    assert inside / runs > 0.92, (inside, runs)


def test_a_tile_without_evidence_is_unknown_beside_one_with() -> None:
    film = _core.Film(16, 8, 4)
    _core.render_synthetic(film, "rare", {"spp": 4}, 8.0, 2, 1)
    tiles = film.tiles(2)
    dark = [t for t in tiles if t["unknown_share"] == 1.0]
    assert 0 < len(dark) < len(tiles)
    for t in dark:
        assert t["known"] is False
        assert [t[k] for k in ("relmse", "upper", "rmse", "mean_standard_error")] == [None] * 4


def test_the_standard_error_is_never_zero() -> None:
    film = _core.Film(32, 32, 4)
    _core.render_synthetic(film, "rare", {"spp": 4}, 8.0, 2, 1)
    se = film.standard_error()
    assert np.isnan(se).any() and not (se == 0.0).any()
