"""The error estimate against its definition, against truth, and where nothing is known."""

from typing import Any

import numpy as np
import pytest
from synthetic_films import assert_honest, box, crc64, runs_of, true_mean, true_weights

from matiere import _core


def render(
    kind: str, spp: int, spread: float = 1.0, seed: int = 0, replicates: int = 4, size: int = 48
) -> _core.Film:
    film = _core.Film(size, size, replicates)
    _core.render_synthetic(film, kind, {"spp": spp}, spread, seed, 2)
    return film


def replicate_means(film: _core.Film) -> np.ndarray:
    return np.asarray(film.sums)[..., :3] * film.replicates / film.spp


@pytest.mark.parametrize("replicates", [2, 3, 4, 8, 12])
def test_absolute_figures_are_those_of_the_replicate_means(replicates: int) -> None:
    film = render("lognormal", 8 * replicates, replicates=replicates)
    means = replicate_means(film)
    variance = means.var(0, ddof=1) / replicates
    image = means.mean(0)
    e = film.estimate()
    assert e["rmse"] == pytest.approx(np.sqrt(variance.mean()), rel=1e-12)
    assert e["relmse_classic"] == pytest.approx((variance / (image**2 + 0.01)).mean(), rel=1e-12)
    np.testing.assert_allclose(film.mean()[..., :3], image, rtol=1e-12)
    np.testing.assert_allclose(film.mean_variance(), variance, rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(film.standard_error(), np.sqrt(box(variance)), rtol=1e-9)


def test_relmse_is_var_over_smooth_squared_where_noise_is_small() -> None:
    film = render("gaussian", 256, 0.05)
    means = replicate_means(film)
    smooth = box(means.mean(0))
    m = np.exp(np.log(smooth @ [0.2126, 0.7152, 0.0722]).mean())
    expected = (means.var(0, ddof=1) / 4 / (smooth**2 + 0.01 * m * m)).mean()
    e = film.estimate()
    assert e["log_average"] == pytest.approx(m, rel=1e-4)
    assert e["relmse"] == pytest.approx(expected, rel=1e-3)


def test_the_unit_of_light_does_not_matter() -> None:
    """Power-of-two scale: every figure but the absolute ones keeps its bits."""
    film = render("lognormal", 16)
    plain = bytearray(film.to_bytes())
    assert film.estimate()["relmse"] > 0
    scaled = scale_sums(film, plain, 2.0**20)
    a, b = film.estimate(), scaled.estimate()
    for key in ("relmse", "lower", "upper", "unknown_share", "effective_pixels"):
        assert a[key] == pytest.approx(b[key], rel=1e-12), key
    assert b["rmse"] == pytest.approx(a["rmse"] * 2.0**20, rel=1e-12)


def scale_sums(film: _core.Film, data: bytearray, factor: float) -> _core.Film:
    """A film whose sums are multiplied, by way of its bytes."""
    sums = np.asarray(film.sums).ravel() * factor
    body = bytes(data[: -8 - sums.nbytes]) + sums.tobytes()
    return _core.Film.from_bytes(body + crc64(body).to_bytes(8, "little"))


def runs(kind: str, spp: int, spread: float, replicates: int, seeds: int, size: int = 48) -> Any:
    """Estimates and realised relMSE (true mean, S and m) of many seeds."""
    return runs_of(render(kind, spp, spread, seed, replicates, size) for seed in range(seeds))


# kind, spp, relative deviation of a sample; tails from none to one sample in 26 carrying everything
SLOW = pytest.mark.slow
CASES = [
    ("uniform", 16, 0.5),
    ("gaussian", 16, 0.5),
    ("gaussian", 64, 0.5),
    ("lognormal", 64, 1.0),
    ("rare", 64, 2.0),
    pytest.param("lognormal", 256, 2.0, marks=SLOW),
    pytest.param("rare", 256, 5.0, marks=SLOW),
]


@pytest.mark.parametrize(("kind", "spp", "spread"), CASES)
@pytest.mark.parametrize(
    "replicates", [pytest.param(2, marks=SLOW), 4, pytest.param(8, marks=SLOW)]
)
def test_the_interval_holds_the_realised_error(
    kind: str, spp: int, spread: float, replicates: int
) -> None:
    assert_honest(runs(kind, spp, spread, replicates, 80))


@pytest.mark.parametrize(
    "replicates", [pytest.param(2, marks=SLOW), 4, pytest.param(8, marks=SLOW)]
)
def test_the_interval_is_not_wider_than_it_must_be(replicates: int) -> None:
    """Gaussian truth: half the log width is 1.96 standard deviations of log(realised/estimate)."""
    rows = runs("gaussian", 64, 0.3, replicates, 120)
    actual = np.std([np.log(r["realised"] / r["relmse"]) for r in rows], ddof=1)
    printed = np.mean([np.log(r["upper"] / r["lower"]) / 2 for r in rows])
    assert printed / (1.96 * actual) == pytest.approx(1.0, abs=0.3)


def test_an_outlier_does_not_hide_itself() -> None:
    """The weight of a pixel's own outlier comes from its neighbours and other replicates."""
    film = render("constant", 4, size=32)
    sums = np.array(film.sums)
    sums[2, 16, 16, :3] += 1e4
    spoilt = _core.Film.from_bytes(with_sums(film, sums))
    variance = np.zeros((32, 32, 3))
    variance[16, 16] = 1e4**2 / 4**2  # one replicate of one sample: s^2 / 4
    # neighbours of the outlier keep zero variance, so only its own weight counts
    expected = (true_weights(32) * variance).mean()
    assert spoilt.estimate()["relmse"] == pytest.approx(expected, rel=0.2)


def with_sums(film: _core.Film, sums: np.ndarray) -> bytes:
    data = film.to_bytes()
    body = data[: -8 - sums.nbytes] + sums.tobytes()
    return body + crc64(body).to_bytes(8, "little")


@pytest.mark.parametrize("replicates", [1, 2, 4])
@pytest.mark.parametrize("kind", ["zero", "constant"])
def test_films_without_evidence_are_unknown_not_perfect(kind: str, replicates: int) -> None:
    e = render(kind, 16, replicates=replicates).estimate()
    assert e["known"] is False and e["unknown_share"] == 1.0
    assert [e[key] for key in ("relmse", "lower", "upper", "rmse", "relmse_classic")] == [None] * 5


def test_one_replicate_tells_nothing() -> None:
    film = render("gaussian", 16, replicates=1)
    assert film.estimate()["relmse"] is None
    assert np.isnan(film.standard_error()).all()


def test_an_empty_film_tells_nothing() -> None:
    film = _core.Film(8, 8, 4)
    assert film.estimate()["known"] is False
    assert np.isnan(film.standard_error()).all()
    assert not film.mean().any()


def test_pixels_that_saw_nothing_are_counted_as_unknown() -> None:
    film = render("rare", 16, 22.0)
    share = (np.ptp(replicate_means(film), axis=0) == 0).all(-1).mean()
    assert 0.5 < share < 1
    assert film.estimate()["unknown_share"] == pytest.approx(share, abs=1e-12)


def test_pooled_standard_errors_are_honest() -> None:
    film = render("gaussian", 64, 0.5, size=64)
    z = (film.mean()[..., :3] - true_mean(64)) / film.standard_error()
    # Student's t of about 75 degrees of freedom; three channels are one draw
    assert np.std(z[..., 0]) == pytest.approx(1.0, abs=0.05)
    assert (np.abs(z[..., 0]) < 1.96).mean() == pytest.approx(0.95, abs=0.02)


def test_merging_seeds_keeps_the_error_honest() -> None:
    a, b = render("lognormal", 32, seed=1), render("lognormal", 32, seed=2)
    a.merge(b)
    assert a.spp == 64 and a.merged
    long = render("lognormal", 64, seed=3)
    assert a.estimate()["relmse"] == pytest.approx(long.estimate()["relmse"], rel=0.15)
