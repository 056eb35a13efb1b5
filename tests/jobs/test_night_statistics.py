"""The tests of one cell: do they keep their level, and do they find what is there?"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from matiere.jobs import night_statistics as statistics
from matiere.signature import Signature

Draw = Callable[[np.random.Generator, tuple[int, ...]], NDArray[np.float64]]
R = 4


def made(pixels: NDArray[np.float64], **more: Any) -> Signature:
    """Return the signature of an image (replicates, H, W, 3)."""
    import hashlib

    from matiere.signature import _grouped

    facts: dict[str, Any] = {"spp": 64, "shared": False, "seeds": (1,)} | more
    digest = hashlib.sha256(pixels.tobytes()).hexdigest()
    return Signature(
        width=pixels.shape[2], height=pixels.shape[1], means=_grouped(pixels), digest=digest,
        **facts,
    )  # fmt: skip


def noise(seed: int, shape: tuple[int, ...] = (R, 16, 16, 3), scale: float = 0.1) -> Any:
    return 1.0 + scale * np.random.default_rng(seed).standard_normal(shape)


# -- what is found ------------------------------------------------------------------------------
def test_a_change_is_found_with_its_size_and_interval() -> None:
    a, b = noise(1), noise(2)
    b[:, :4, :4] += 0.5
    found = statistics.compare_cells(made(a), made(b, seeds=(2,)))
    assert not found.paired and not found.identical
    assert found.p[1].max() < 1e-4 and found.p[2:].min() > 1e-4
    np.testing.assert_allclose(found.difference[1], (b - a)[:, :4, :4].mean((0, 1, 2)), atol=1e-6)
    half = statistics.interval_half(found.error, found.dof, 0.025)
    assert (abs(found.difference[1] - 0.5) < 2 * half[1]).all()


def test_one_seed_finds_what_unrelated_seeds_hide() -> None:
    a = noise(1)
    b = a * 1.001 + noise(3, scale=1e-5) - 1.0
    paired = statistics.compare_cells(made(a), made(b))
    alone = statistics.compare_cells(made(a), made(b, seeds=(2,)))
    assert paired.paired and paired.p[0].max() < 1e-6 < 0.05 < alone.p[0].min()


def test_equal_films_are_no_change() -> None:
    found = statistics.compare_cells(made(noise(1)), made(noise(1)))
    assert found.identical and (found.p == 1.0).all() and (found.alone > 0.0).all()


def test_constant_images_change_or_do_not() -> None:
    black = np.zeros((R, 8, 8, 3))
    grey = black.copy()
    grey[:, :2, :2] = 0.5
    same = statistics.compare_cells(made(black), made(black.copy(), spp=32, seeds=(2,)))
    assert (same.p == 1.0).all()
    found = statistics.compare_cells(made(black), made(grey))
    assert (found.p[:2] == 0.0).all() and (found.p[2:] == 1.0).all()


def test_rounding_is_no_change() -> None:
    a = np.full((R, 8, 8, 3), 0.7)
    found = statistics.compare_cells(made(a), made(a * (1 + 3e-7)))
    assert (found.p == 1.0).all()


def test_one_replicate_is_refused_unless_the_bits_are_equal() -> None:
    one, other = made(noise(1)[:1]), made(noise(2)[:1])
    assert "one replicate" in (statistics.why_not(one, other) or "")
    assert statistics.why_not(one, one) is None
    assert (statistics.compare_cells(one, one).p == 1.0).all()
    assert "sizes differ" in (statistics.why_not(one, made(noise(1)[:, :8])) or "")


@pytest.mark.parametrize("replicates", [2, 6, 8, 16, 32])
def test_nights_of_other_replicates_are_compared_as_unrelated(replicates: int) -> None:
    a, b = noise(1), noise(2, (replicates, 16, 16, 3))
    found = statistics.compare_cells(made(a), made(b))
    assert not found.paired and np.isfinite(found.p).all() and found.p.min() > 1e-4
    b[:, 8:12, 4:8] += 1.0
    assert statistics.compare_cells(made(a), made(b)).p[10].max() < 1e-3


def test_pixels_that_share_paths_are_judged_by_replicates_alone() -> None:
    rng = np.random.default_rng(5)
    a, b = (noise(k) + rng.standard_normal((R, 1, 1, 1)) for k in (1, 2))
    found = statistics.compare_cells(made(a, shared=True), made(b, shared=True, seeds=(2,)))
    assert found.dof.max() <= 2 * (R - 1) + 1e-9 and found.p.min() > 1e-3
    blind = statistics.compare_cells(made(a), made(b, seeds=(2,)))
    assert blind.p.min() < 1e-3  # what would be claimed otherwise


def test_one_speck_in_every_replicate_is_no_change() -> None:
    """Seen among 20 pairs of nights: a lamp that one sample in a thousand meets; light layer."""
    a = np.full((R, 8, 8, 3), 0.02) + noise(1, (R, 8, 8, 3), 1e-3) - 1.0
    b = np.full((R, 8, 8, 3), 0.02) + noise(2, (R, 8, 8, 3), 1e-3) - 1.0
    for replicate, (y, x) in enumerate([(0, 3), (0, 3), (0, 2), (0, 3)]):
        b[replicate, y, x] = 22.5
    for shared in (True, False):
        found = statistics.compare_cells(made(a, shared=shared), made(b, shared=shared, seeds=(2,)))
        assert found.p.min() > 1e-4, shared


def test_a_single_pixel_claims_no_more_than_its_replicates_can_tell() -> None:
    a, b = np.zeros((R, 4, 4, 3)), np.zeros((R, 4, 4, 3))
    b[:, 0, 0] = 1.0
    assert statistics.compare_cells(made(a), made(b, seeds=(2,))).p[1].min() == 1 / 35
    assert statistics.compare_cells(made(a), made(b)).p[1].min() == 1 / 8


# -- levels -------------------------------------------------------------------------------------
def unequal(*weights: float) -> Draw:
    """Return normal noise whose scale differs from group to group."""

    def draw(rng: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.float64]:
        scale = np.sqrt(np.resize([*weights, *[weights[-1]] * 8], shape[-2]))[:, None]
        return np.asarray(rng.standard_normal(shape) * scale)

    return draw


def rare(rate: float) -> Draw:
    """Return bright specks over faint noise."""
    return lambda rng, shape: rng.poisson(rate, shape) + 0.01 * rng.standard_normal(shape)


def skewed(sigma: float) -> Draw:
    """Return lognormal noise."""
    return lambda rng, shape: np.exp(sigma * rng.standard_normal(shape))


DRAWS = {
    "normal": unequal(1.0), "one group noisy": unequal(1.0, 0.03),
    "one group very noisy": unequal(1.0, 0.003), "two groups noisy": unequal(1.0, 1.0, 0.01),
    "falling": unequal(1.0, 0.1, 0.01, 0.001), "skewed": skewed(1.0), "very skewed": skewed(2.0),
    "specks .02": rare(0.02), "specks .1": rare(0.1), "specks .5": rare(0.5),
}  # fmt: skip


def p_values(draw: Draw, count: int, ratio: int, paired: bool) -> NDArray[np.float64]:
    """Return p-values of regions of 4 groups without change; night b has `ratio` x the samples."""
    rng = np.random.default_rng(20261123)
    a = draw(rng, (R, count, 4, 3))
    b = np.mean([draw(rng, (R, count, 4, 3)) for _ in range(ratio)], axis=0)
    if paired:
        d = statistics._parts(b - a)
        used = d.mean, d.variance, d.variance**2 / d.nu
    else:
        used = statistics._welch(statistics._parts(a), statistics._parts(b), 16, 16 * ratio)
    return np.asarray(statistics._p_values(*used, floor=np.zeros((count, 3))))


@pytest.mark.parametrize("ratio", [1, 4])
@pytest.mark.parametrize("name", DRAWS)
def test_far_tails_keep_their_level(name: str, ratio: int) -> None:
    """At 1e-4 no more than 1e-4, whatever carries the variance; 120,000 p-values a case."""
    for paired in (True, False) if ratio == 1 else (False,):
        p = p_values(DRAWS[name], 40_000, ratio, paired)
        for level in (1e-2, 1e-3, 1e-4):
            most = level * p.size
            hits = int((p < level).sum())
            assert hits <= most + 4.0 * np.sqrt(most) + 1, (paired, level, hits, most)


def test_without_the_second_look_one_noisy_group_alarms_too_often() -> None:
    """The guard is needed: the same tests by Satterthwaite's degrees of freedom alone."""
    rng = np.random.default_rng(7)
    two_nights = DRAWS["one group very noisy"](rng, (2, R, 20_000, 4, 3))
    d = statistics._parts(two_nights[1] - two_nights[0])
    p = statistics._student(
        d.mean.sum(1), d.variance.sum(1), (d.variance**2 / d.nu).sum(1), np.zeros((20_000, 3))
    )
    assert (p < 1e-4).sum() > 5 * 1e-4 * p.size


# -- corrections --------------------------------------------------------------------------------
def test_corrections_are_those_of_the_papers() -> None:
    p = np.array([0.01, 0.04, 0.03, 0.005, np.nan])
    holm = statistics.corrected(p, "holm")
    np.testing.assert_allclose(holm[:4], [0.03, 0.06, 0.06, 0.02])
    bh = statistics.corrected(p, "bh")
    np.testing.assert_allclose(bh[:4], [0.02, 0.04, 0.04, 0.02])
    by = statistics.corrected(p, "by")
    np.testing.assert_allclose(by[:4], bh[:4] * (1 + 1 / 2 + 1 / 3 + 1 / 4))
    assert np.isnan(holm[4]) and np.isnan(bh[4])


def test_holm_is_the_one_of_film_comparisons() -> None:
    from matiere.compare import holm

    p = np.random.default_rng(1).random(50) ** 4
    np.testing.assert_allclose(statistics.corrected(p, "holm"), holm(list(p)))


def test_the_detectable_change_is_found_as_often_as_it_says() -> None:
    level, hits, count = 1e-3, 0, 300
    for seed in range(count):
        a, b = noise(seed), noise(1000 + seed)
        before = statistics.compare_cells(made(a), made(b, seeds=(2,)))
        least = statistics.detectable(before.error, before.dof, level)[0, 1]
        if seed == 0:
            shift = least
        after = statistics.compare_cells(made(a), made(b + shift, seeds=(2,)))
        hits += bool(after.p[0, 1] < level)
    assert 0.65 < hits / count < 0.95, hits


def test_cells_tested_together_are_those_tested_alone() -> None:
    pairs = [(made(noise(k)), made(noise(50 + k), seeds=(k % 2,))) for k in range(6)]
    pairs += [(made(noise(k, (8, 9, 7, 3))), made(noise(70 + k, (4, 9, 7, 3)))) for k in range(3)]
    pairs.append((made(noise(1)), made(noise(1))))
    for (a, b), found in zip(pairs, statistics.compare_many(pairs), strict=True):
        alone = statistics.compare_cells(a, b)
        np.testing.assert_allclose(found.p, alone.p, rtol=1e-9)
        np.testing.assert_allclose(found.error, alone.error, rtol=1e-12)
        assert (found.paired, found.identical) == (alone.paired, alone.identical)


@pytest.mark.parametrize("tail", [0.2, 1e-3, 1e-8])
def test_interpolated_quantiles_are_near_the_exact_ones(tail: float) -> None:
    from matiere import _core

    nu = np.random.default_rng(3).uniform(1.0, 500.0, 200)
    exact = np.asarray(_core.student_quantile(np.full(nu.shape, tail), nu))
    np.testing.assert_allclose(statistics._quantiles(tail, nu), exact, rtol=1e-3)
