"""The contract of every model in the list, at every angle, in float and in double."""

from __future__ import annotations

from typing import Any

import chi_square
import numpy as np
import pytest
from extremes import DEGREES, direction
from material_cases import PICKED, Case, all_cases

CASES = all_cases()
#: The last case of every model: what `./dev test --fast` keeps.
QUICK = {case.type: case.id for case in CASES}.values()
PICKED_IDS = {case.id for case in PICKED}
FEW_DEGREES = (0.0, 60.0, 89.9)  # for the many generated cases
PRECISIONS = ("float", "double")
AZIMUTH = 0.4
LEVEL = chi_square.sidak(0.01, 2 * len(CASES) * len(DEGREES))
# A float direction is known to 6e-8: a lobe narrower than this cannot be told from its rounding, so
# the statistics of such lobes are taken in double only.
FLOAT_LOBE = 3e-5


made: dict[tuple[str, str], Any] = {}


def bsdf_of(case: Case, precision: str) -> Any:
    """Return the material, made once: six tests look at it, and some have tables."""
    key = (case.id, precision)
    if key not in made:
        made[key] = case.bsdf(precision)
    return made[key]


def sides(case: Case) -> tuple[float, ...]:
    return (1.0, -1.0) if case.interface else (1.0,)


def viewers(case: Case) -> list[tuple[float, np.ndarray]]:
    """Return (angle, direction) of every viewer: interfaces are seen from inside too."""
    angles = DEGREES if case.id in PICKED_IDS else FEW_DEGREES
    return [
        (d, np.array(direction(d, AZIMUTH)) * (1, 1, side)) for d in angles for side in sides(case)
    ]


def resolved(case: Case, precision: str, degrees: float) -> bool:
    return precision == "double" or case.lobe_width(np.cos(np.radians(degrees))) > FLOAT_LOBE


def cases(test: Any) -> Any:
    marked = [
        pytest.param(case, id=case.id, marks=() if case.id in QUICK else pytest.mark.slow)
        for case in CASES
    ]
    test = pytest.mark.parametrize("case", marked)(test)
    return pytest.mark.parametrize("precision", PRECISIONS)(test)


def variants(case: Case, eps: float) -> list[Any]:
    """Return the material in double, exactly and with its index rounded up and down."""
    if not case.interface:
        return [bsdf_of(case, "double")]
    return [case.scaled(1 + d).bsdf("double") for d in (0.0, 4 * eps, -4 * eps)]


def rounding_of(
    value: Any, views: list[Any], a: np.ndarray, b: np.ndarray, eps: float
) -> np.ndarray:
    """Return how far `value(view, a, b)` moves, row by row, when its inputs move by their rounding.

    `value` is evaluated in double: near a critical angle, at grazing and in narrow lobes this is
    what no float path can do better than.
    """
    rng = np.random.default_rng(5)
    base = value(views[0], a, b)
    moved = np.zeros(base.shape[0])
    for k in range(9):
        da, db = (1 + 4 * eps * rng.choice([-1.0, 1.0], size=(2, *a.shape))) * np.stack([a, b])
        there = value(views[k % len(views)], da, db)
        moved = np.maximum(moved, np.abs(there - base).max(axis=1))
    return moved


def random_u(n: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random((n, 3), dtype=np.float32)


@cases
def test_samples_follow_the_pdf(case: Case, precision: str) -> None:
    bsdf = bsdf_of(case, precision)
    for degrees, wo in viewers(case):
        if not resolved(case, precision, degrees):
            continue
        o = chi_square.run(bsdf, wo, n=20_000)
        where = f"{case.id} at {degrees} degrees, z={wo[2]:+.4f}: {o}"
        assert o.p_value > LEVEL, where
        # pdf + delta + rejected = 1, within five standard errors of the rejected share.
        assert o.uncertain < 2e-3 and abs(o.gap) < 5 * o.gap_error + 2e-3, where
        # What eval scatters, sample scatters: no lobe is out of its reach.
        gap = np.abs(o.albedo - o.albedo_sampled)
        assert (gap < 6 * o.albedo_error + 3e-3).all(), where


@cases
def test_the_weight_is_eval_over_pdf(case: Case, precision: str) -> None:
    bsdf = bsdf_of(case, precision)
    eps = float(np.finfo(np.float32 if precision == "float" else np.float64).eps)
    views = variants(case, eps)
    for degrees, wo in viewers(case):
        s = bsdf.sample(wo, random_u(2000, 2))
        dull = (s.lobe != 0) & ((s.lobe & 4) == 0)
        if not dull.any():
            continue
        wi, weight = s.wi[dull], s.weight[dull].astype(float)
        f = bsdf.eval(wo, wi).astype(float)
        pdf = bsdf.pdf(wo, wi).astype(float)
        if not resolved(case, precision, degrees):
            assert np.isfinite(f).all() and np.isfinite(pdf).all(), (case.id, degrees)
            continue
        assert (pdf > 0).all(), (case.id, degrees, wi[pdf <= 0][:3])

        def ratio(view: Any, o: np.ndarray, i: np.ndarray) -> np.ndarray:
            density = view.pdf(o, i)[:, None]
            return np.where(density > 0, view.eval(o, i) / np.maximum(density, 1e-300), 0)

        # The sampled direction is rounded: the ratio may move by what that rounding does to it.
        there = np.broadcast_to(wo, wi.shape)
        slack = 8 * rounding_of(ratio, views, there, wi.astype(float), eps)
        slack = slack + 64 * eps * np.maximum(weight.max(axis=1), 1e-3)
        gap = np.abs(f / pdf[:, None] - weight).max(axis=1)
        worst = int(np.argmax(gap / slack))
        assert (gap <= slack).all(), (case.id, degrees, gap[worst], wi[worst], weight[worst])


@cases
def test_scattering_is_reciprocal(case: Case, precision: str) -> None:
    if not case.reciprocal:
        pytest.skip("promises no reciprocity")
    bsdf = bsdf_of(case, precision)
    rng = np.random.default_rng(3)
    w = rng.normal(size=(2, 4000, 3))
    w /= np.linalg.norm(w, axis=2, keepdims=True)
    if not case.interface:
        w[..., 2] = np.abs(w[..., 2])
    a, b = w.astype(np.float32 if precision == "float" else np.float64)
    eta = case.eta

    def f(view: Any, o: np.ndarray, i: np.ndarray) -> np.ndarray:
        # Radiance is scaled by the square of the index on the viewer's side.
        index = np.where(o[:, 2:] > 0, 1.0, eta) ** 2
        return view.eval(o, i).astype(float) / np.abs(i[:, 2:].astype(float)) / index

    f_ab, f_ba = f(bsdf, a, b), f(bsdf, b, a)
    gap = np.abs(f_ab - f_ba).max(axis=1)
    size = np.maximum(f_ab.max(axis=1), f_ba.max(axis=1))
    eps = float(np.finfo(a.dtype).eps)
    slack = 16 * rounding_of(f, variants(case, eps), a.astype(float), b.astype(float), eps)
    # f cos below the smallest normal number is flushed to zero before the cosine is divided out.
    lost = float(np.finfo(a.dtype).tiny) / np.minimum(np.abs(a[:, 2]), np.abs(b[:, 2]))
    bad = gap > slack + 64 * eps * size + lost
    assert not bad.any(), (case.id, a[bad][:2], b[bad][:2], f_ab[bad][:2], f_ba[bad][:2])


@cases
def test_the_furnace_never_gains(case: Case, precision: str) -> None:
    bsdf = bsdf_of(case, precision)
    for degrees, wo in viewers(case):
        # What compensates losses has albedo 1 itself: its noise must be below the tolerance; so
        # must that of lobes sampled through half vectors, which lose samples.
        samples = 1 << (16 if case.params.get("multiscatter") else 15 if case.wasteful else 13)
        albedo = bsdf.albedo(wo, n=samples)[0]
        assert np.isfinite(albedo).all()
        if case.conserving:
            assert (albedo <= 1 + 1e-3).all(), (case.id, degrees, albedo)
        else:
            print(f"{case.id} at {degrees} degrees, {precision}: albedo {albedo.max():.3f}")
        assert (albedo >= 0).all(), (case.id, degrees, albedo)


@cases
def test_nothing_is_ever_non_finite_or_negative(case: Case, precision: str) -> None:
    bsdf = bsdf_of(case, precision)
    corners = [0.0, 1e-7, 0.5, 1 - 2**-24]
    u = np.array([(x, y, z) for x in corners for y in corners for z in corners])
    cosines = [1.0, 0.5, 1e-2, 1e-4, 1e-6, 1e-20, 0.0, -1e-20, -1e-6, -1e-4, -0.5, -1.0]
    dirs = np.array(
        [
            (np.sqrt(max(0.0, 1 - c * c)) * np.cos(p), np.sqrt(max(0.0, 1 - c * c)) * np.sin(p), c)
            for c in cosines
            for p in (0.0, 1.0, np.pi)
        ]
    )
    for wo in dirs:
        s = bsdf.sample(wo, u)
        for part in (s.wi, s.weight, s.pdf, s.eta):
            assert np.isfinite(part).all(), (case.id, wo, s)
        assert (s.weight >= 0).all() and (s.pdf >= 0).all(), (case.id, wo)
        f, pdf = bsdf.eval(wo, dirs), bsdf.pdf(wo, dirs)
        assert np.isfinite(f).all() and np.isfinite(pdf).all(), (case.id, wo)
        assert (f >= 0).all() and (pdf >= 0).all(), (case.id, wo)
        assert (f[pdf == 0] == 0).all(), (case.id, wo)


@cases
def test_sampled_directions_are_unit_and_on_the_lobes_side(case: Case, precision: str) -> None:
    bsdf = bsdf_of(case, precision)
    for degrees, wo in viewers(case):
        s = bsdf.sample(wo, random_u(500, 4))
        hit = s.lobe != 0
        assert np.allclose(np.linalg.norm(s.wi[hit], axis=1), 1, atol=3e-6), (case.id, degrees)
        same_side = s.wi[hit][:, 2] * wo[2] > 0
        assert (same_side == ((s.lobe[hit] & 8) != 0)).all(), (case.id, degrees)
        assert (same_side == ((s.lobe[hit] & 16) == 0)).all(), (case.id, degrees)
