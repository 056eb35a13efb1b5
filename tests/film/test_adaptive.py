"""Adaptive films: no bias, the same bits on every road, an honest interval, floors kept."""

import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from film_scenes import scenes
from scipy import stats
from synthetic_films import assert_honest, crc64, runs_of

import matiere as mt
from matiere import _core, chunks


def synthetic(spp: int, *, threads: int = 2, size: int = 64, seed: int = 0, **keys: Any) -> Any:
    film = _core.Film(size, size, keys.pop("replicates", 4), True)
    return go_on(film, spp, threads=threads, seed=seed, **keys)


def go_on(film: _core.Film, spp: int, *, seed: int = 0, threads: int = 2, **keys: Any) -> Any:
    kind, spread = keys.pop("kind", "lognormal"), keys.pop("spread", 2.0)
    _core.render_synthetic(film, kind, {"spp": spp}, spread, seed, threads, **keys)
    return film


def same(a: _core.Film, b: _core.Film) -> bool:
    """Tell whether two films have the same bits and would decide alike."""
    bits = np.array_equal(a.sums.view(np.uint64), b.sums.view(np.uint64))
    counts = np.array_equal(a.counts, b.counts) and np.array_equal(a.first_counts, b.first_counts)
    return bits and counts and a.missing(4 * a.spp) == b.missing(4 * b.spp)


@pytest.fixture(scope="module")
def scene() -> mt.Scene:
    return mt.load(scenes(64)["glass"])


# -- counts -------------------------------------------------------------------------------------
@pytest.mark.parametrize("replicates", [4, 8])
@pytest.mark.parametrize("spp", [16, 64, 112, 320])
def test_the_mean_of_the_counts_is_the_spp_and_every_tile_keeps_the_floor(
    replicates: int, spp: int
) -> None:
    film = synthetic(spp * replicates // 4, replicates=replicates)
    first, counts = np.asarray(film.first_counts), np.asarray(film.counts)
    chunk = 2 * replicates * film.plan.tile_edge**2 / counts.size  # of a half
    for half in (first, counts - first):
        assert 0 <= half.mean() - film.spp / 2 <= chunk
        assert half.min() >= film.spp / 8  # a quarter of the mean
        assert half.max() <= 8 * film.spp / 2
    assert film.spp == film.plan.round_up(spp * replicates // 4)
    if spp > 16:
        assert counts.min() < counts.max()


def test_a_film_without_evidence_is_sampled_evenly() -> None:
    film = synthetic(96, kind="constant")
    counts = np.asarray(film.counts)
    assert counts.max() - counts.min() <= 16 and counts.mean() == pytest.approx(96, abs=4)


def test_noisy_tiles_get_samples_by_the_root_of_their_variance() -> None:
    """Neyman allocation: between floor and ceiling, samples are in proportion to sigma."""
    studio = mt.load(scenes(64)["diffuse"])  # no outliers: a short render knows its variance
    film = mt.render(studio, spp=112, seed=3, adaptive=True)
    even = mt.render(studio, spp=64, seed=4)
    edge = film.core.plan.tile_edge
    tiles = (64 // edge, edge, 64 // edge, edge)
    relative = even.core.error_weights() * even.core.mean_variance()
    sigma = np.sqrt(relative.mean(-1).reshape(tiles).mean((1, 3))).ravel()
    counts = film.sample_counts[::edge, ::edge].ravel()
    print(sigma, counts)
    assert stats.spearmanr(sigma, counts).statistic > 0.9
    assert counts.max() > 2.5 * counts.min()


def test_every_half_is_averaged_by_itself() -> None:
    film = synthetic(64)
    sums, first = np.asarray(film.sums)[..., :3], np.asarray(film.first_counts)[..., None]
    second = np.asarray(film.counts)[..., None] - first
    assert (first != second).any()
    expected = (sums[:2].sum(0) / first + sums[2:].sum(0) / second) / 2
    np.testing.assert_allclose(film.mean()[..., :3], expected, rtol=1e-12)
    half = np.stack([2 * sums[0] / first, 2 * sums[1] / first])
    other = np.stack([2 * sums[2] / second, 2 * sums[3] / second])
    variance = np.concatenate([half, other]).var(0, ddof=1) / 4
    np.testing.assert_allclose(film.mean_variance(), variance, rtol=1e-9, atol=1e-18)


# -- bias ---------------------------------------------------------------------------------------
def worst_p(**keys: Any) -> float:
    """Smallest p of t-tests over tiles: 64 short renders of a skewed integrand against its mean.

    Rare hits in tiles of few pixels, where a count that follows its own samples hurts most.
    """
    means = []
    for seed in range(64):
        film = _core.Film(1024, 1, 4, True)
        go_on(film, 64, kind="rare", spread=15.0, seed=seed, **keys)
        means.append(film.mean()[0, :, 0] / true_mean_row(1024))
    edge = film.plan.tile_edge
    tiles = np.array(means).reshape(64, -1, edge).mean(-1)
    p = stats.ttest_1samp(tiles, 1.0).pvalue
    whole = stats.ttest_1samp(tiles.mean(1), 1.0).pvalue
    return float(min(p.min() * len(p), whole))


def true_mean_row(width: int) -> np.ndarray:
    return np.asarray(_core.synthetic_mean(np.arange(width), np.zeros(width, int)))


SIDAK = 1 - 0.99 ** (1 / 2)  # two families of tests at 1 % together


def test_short_adaptive_renders_have_the_true_mean() -> None:
    assert worst_p() > SIDAK


def test_the_test_of_bias_notices_films_that_decide_on_their_own_samples() -> None:
    """Planted: the second half repeats the first, so each half is decided by its own samples."""
    assert worst_p(repeat_after=2) < 1e-6


def test_short_adaptive_renders_of_a_scene_agree_with_a_long_uniform_one(scene: mt.Scene) -> None:
    small = scene.with_render(max_depth=6)
    long = mt.render(small, spp=1024, seed=999)
    short = [mt.render(small, spp=32, seed=s, adaptive=True).mean.mean(-1) for s in range(24)]
    edge = 16
    tiles = np.array(short).reshape(24, 4, edge, 4, edge).mean((2, 4)).reshape(24, -1)
    error = np.sqrt(long.core.mean_variance().mean(-1).reshape(4, edge, 4, edge).mean((1, 3)))
    error = error.ravel() / edge  # of a tile's mean
    expected = long.mean.mean(-1).reshape(4, edge, 4, edge).mean((1, 3)).ravel()
    spread = np.sqrt(tiles.var(0, ddof=1) / len(tiles) + error**2)
    t = (tiles.mean(0) - expected) / spread
    assert np.abs(t).max() < stats.t.ppf(1 - 0.005 / t.size, len(tiles) - 1), t


# -- bits ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("threads", [2, 5])
def test_threads_do_not_change_bits(threads: int) -> None:
    assert same(synthetic(160, threads=1), synthetic(160, threads=threads))


def test_continuing_is_one_long_run() -> None:
    film = _core.Film(64, 64, 4, True)
    for spp in (4, 16, 17, 64, 100, 130, 300):
        film = _core.Film.from_bytes(go_on(film, spp).to_bytes())
    assert same(film, synthetic(300))


def test_a_scene_is_continued_through_a_file(scene: mt.Scene, tmp_path: Path) -> None:
    mt.render(scene, spp=32, adaptive=True, threads=1).save(tmp_path / "a.film")
    film = mt.render(scene, film=mt.load_film(tmp_path / "a.film"), spp=96)
    assert film.adaptive and film.report["adaptive"]
    assert same(film.core, mt.render(scene, spp=96, adaptive=True, threads=2).core)


def test_chunks_in_any_order_make_the_film_of_the_pass_loop(scene: mt.Scene) -> None:
    """Interrupted at every barrier and in the middle of rounds, and read back from bytes."""
    asked = scene.with_render(spp=96, adaptive=True)
    film, order = chunks.new_film(chunks.plan(asked.model)), random.Random(3)
    while wanted := film.missing(96):
        order.shuffle(wanted)
        for index in wanted[: order.randint(1, len(wanted))]:
            strip = index % film.plan.strips
            if index == film.next_chunk(strip):
                chunks.add(film, render(asked, index))
        film = _core.Film.from_bytes(film.to_bytes())
    assert film.spp == 96
    assert same(film, mt.render(asked).core)


def test_chunks_before_their_turn_are_refused(scene: mt.Scene) -> None:
    asked = scene.with_render(adaptive=True)
    film = mt.render(asked, spp=64).core.copy()
    due = film.missing(10**5)
    ahead = due[-1] % film.plan.strips
    for index in [i for i in due if i % film.plan.strips == ahead]:
        chunks.add(film, render(asked, index))
    with pytest.raises(mt.FilmError, match="before its tile's turn"):
        chunks.add(film, render(asked, film.next_chunk(ahead)))
    with pytest.raises(mt.FilmError, match="is next"):
        chunks.add(film, render(asked, film.next_chunk(ahead) + film.plan.strips))


def render(scene: mt.Scene, index: int) -> bytes:
    data = chunks.render_chunk(scene, index, threads=1)
    assert data is not None
    return data


def test_a_film_whose_counts_do_not_follow_from_it_is_damaged() -> None:
    film = synthetic(64)
    data = bytearray(film.to_bytes()[:-8])
    end, strips = len(data) - 8 * film.plan.strips, film.plan.strips  # behind the worths: rays
    for count in range(strips, 9 * strips, strips):
        if data[end - 8 * count - 8 : end - 8 * count] == count.to_bytes(8, "little"):
            break
    data[end - 8 * count : end] = bytes(8 * count)  # no tile is worth more than another
    with pytest.raises(_core.SceneError, match="not those that they decide"):
        _core.Film.from_bytes(bytes(data) + crc64(bytes(data)).to_bytes(8, "little"))


# -- the rest of the film ------------------------------------------------------------------------
def test_films_of_several_seeds_merge(scene: mt.Scene, tmp_path: Path) -> None:
    a, b = (mt.render(scene, spp=64, seed=s, adaptive=True) for s in (1, 2))
    merged = a.merge(b)
    assert np.array_equal(merged.sample_counts, a.sample_counts + b.sample_counts)
    assert merged.spp == 128 and merged.error["relmse"] < a.error["relmse"]
    merged.save(tmp_path / "m.film")
    assert np.array_equal(mt.load_film(tmp_path / "m.film").mean, merged.mean)
    with pytest.raises(mt.FilmError, match="cannot be continued"):
        mt.render(scene, film=merged, spp=256)


def test_adaptive_and_uniform_films_do_not_mix(scene: mt.Scene) -> None:
    even = mt.render(scene, spp=16)
    with pytest.raises(mt.FilmError, match="adaptively"):
        mt.render(scene, film=even, spp=32, adaptive=True)
    with pytest.raises(mt.FilmError, match="adaptively"):
        even.merge(mt.render(scene, spp=16, seed=5, adaptive=True))
    assert np.array_equal(even.mean, mt.render(scene, spp=16, adaptive=False).mean)


@pytest.mark.parametrize("replicates", [1, 2, 3, 5])
def test_too_few_replicates_are_refused_by_name(scene: mt.Scene, replicates: int) -> None:
    with pytest.raises(mt.RenderError, match="two halves") as caught:
        mt.render(scene, adaptive=True, replicates=replicates)
    assert caught.value.pointer == "/render/replicates"
    document = scenes(8)["glass"] | {"render": {"adaptive": True, "replicates": replicates}}
    with pytest.raises(mt.SceneValidationError, match="two halves") as refused:
        mt.load(document)
    assert refused.value.pointer == "/render/replicates"


@pytest.mark.parametrize(("kind", "spread"), [("gaussian", 0.5), ("lognormal", 2.0)])
def test_the_interval_holds_the_error_of_adaptive_films(kind: str, spread: float) -> None:
    films = (synthetic(64, kind=kind, spread=spread, size=48, seed=s) for s in range(80))
    assert_honest(runs_of(films))
