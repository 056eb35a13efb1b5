"""The tests of one cell of two nights: is its image, or one of its tiles, another than before?

The image and its tiles (17 regions) are tested in each of R, G and B: the mean of night b minus
that of night a over its standard error. Replicates are few (4 by default), so variances come from
the groups of pixels in the signatures, which are independent of each other: every group brings the
variance of its own replicates, and the degrees of freedom follow from how many groups carry the
variance (Satterthwaite 1946; Welch 1947 for two nights of different seeds). Nights of one seed and
replicate count are compared by the replicates of the difference, d_r = b_r - a_r.

Far out in the tails, where tests of many thousand regions are decided, that alone is not honest:

- One group may carry nearly all variance and by chance show little of it: then p is far too small.
  So a change must also show when any one group is left out, p_without^2 <= p; the larger counts.
- Rare samples of one brightness may be in every replicate of one night and in none of the other,
  so that few replicates alone claim far too much. Where pixels share light paths, groups of pixels
  must show the change as well as replicates; a region of a single group claims no more than the
  ways of dealing its replicates allow.
- Where the nights differ in samples, rare bright samples that only one of them has met look like a
  change. So the variance is never taken smaller than what both nights' samples say together.

tests/jobs/test_night_statistics.py measures that the tests keep their level under normal, skewed
and rare contributions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matiere.signature import Signature

Figures = NDArray[np.float64]
_Moments: TypeAlias = tuple[Figures, Figures, Figures]  # differences, variances, variances^2 / nu
Pair: TypeAlias = "tuple[Signature, Signature]"  # of one cell, earlier and later
ROUNDING = 1e-6  # relative differences below are rounding, not change
WORTH_A_SECOND_LOOK = 0.05  # p above: leaving out groups cannot matter


@dataclass(frozen=True, slots=True)
class CellTests:
    """What the tests of one cell say; arrays are (regions, R G B), region 0 is the whole image.

    `p` is NaN where nothing is known; `error` is the standard error of `difference`, `alone` what
    it would be with unrelated seeds; `base` is the mean of night a.
    """

    base: Figures
    difference: Figures
    error: Figures
    dof: Figures
    p: Figures
    alone: Figures
    alone_dof: Figures
    paired: bool
    identical: bool
    shared: bool


@dataclass(frozen=True, slots=True)
class _Parts:
    """Independent contributions to the regions' means: (regions, parts, 3)."""

    mean: Figures
    variance: Figures
    nu: int  # degrees of freedom of each variance


def why_not(a: Signature, b: Signature) -> str | None:
    """Return why two signatures cannot be compared, or None."""
    if (a.width, a.height) != (b.width, b.height):
        return f"the sizes differ: {a.width} x {a.height} and {b.width} x {b.height} pixels"
    if a.digest != b.digest and min(a.replicates, b.replicates) < 2:
        return "one replicate tells nothing about its error: render with at least two"
    return None


def compare_cells(a: Signature, b: Signature) -> CellTests:
    """Test a cell of night b against the same cell of night a; `why_not` must be None."""
    return compare_many([(a, b)])[0]


def compare_many(pairs: Sequence[Pair]) -> list[CellTests]:
    """Test many cells, those of one kind together: a cell alone costs ten times as much."""
    alike: dict[Any, list[int]] = {}
    for number, (a, b) in enumerate(pairs):
        paired = bool(a.seeds) and a.seeds == b.seeds and a.means.shape == b.means.shape
        size = a.width, a.height, a.replicates, b.replicates
        kind = *size, a.spp, b.spp, a.shared or b.shared, paired
        alike.setdefault(kind, []).append(number)
    found: dict[int, CellTests] = {}
    for kind, numbers in alike.items():
        tests = _compare_alike([pairs[number] for number in numbers], *kind[-2:])
        found |= dict(zip(numbers, tests, strict=True))
    return [found[number] for number in range(len(pairs))]


def _compare_alike(pairs: Sequence[Pair], shared: bool, paired: bool) -> Iterator[CellTests]:
    whole, tiles = (_judge_regions(pairs, image, shared, paired) for image in (True, False))
    joined = [np.concatenate(both, axis=1) for both in zip(whole, tiles, strict=True)]
    for number, (a, b) in enumerate(pairs):
        base, difference, error, dof, p, alone, alone_dof = (x[number] for x in joined)
        identical = a.digest == b.digest and a.replicates == b.replicates
        if identical:
            p = np.ones_like(p)
        yield CellTests(
            base, difference, error, dof, p, alone, alone_dof, paired, identical, shared
        )


def _judge_regions(pairs: Sequence[Pair], image: bool, shared: bool, paired: bool) -> list[Figures]:
    """Test the whole images or all tiles; every array is (cells, regions, 3)."""
    a, b = pairs[0]
    groups = math.gcd(a.means.shape[2], b.means.shape[2])
    one = _contributions([before for before, _ in pairs], image, groups)
    two = _contributions([after for _, after in pairs], image, groups)
    base, other = one.sum(2).mean(0), two.sum(2).mean(0)
    floor = ROUNDING * np.maximum(abs(base), abs(other))
    alone, used, p = _test(one, two, (a.spp, b.spp), paired, floor)
    if shared:  # parts depend on each other: the region as a whole must show it too
        whole = one.sum(2, keepdims=True), two.sum(2, keepdims=True)
        alone, used, p_whole = _test(*whole, (a.spp, b.spp), paired, floor)
        p = np.maximum(p, p_whole)
    if one.shape[2] == 1:
        p = np.maximum(p, _fewest_deals(len(one), len(two), paired))
    all_of_them = [base, other - base, *_error(*used[1:]), p, *_error(*alone[1:])]
    return [x.reshape(len(pairs), -1, 3) for x in all_of_them]


def _test(
    one: Figures, two: Figures, spp: tuple[int, int], paired: bool, floor: Figures
) -> tuple[_Moments, _Moments, Figures]:
    """Return what unrelated seeds would give, what is used, and its p-values."""
    alone = used = _welch(_parts(one), _parts(two), *spp)
    if paired:
        d = _parts(two - one)
        used = d.mean, d.variance, d.variance**2 / max(d.nu, 1)
    return alone, used, _p_values(*used, floor=floor)


def _fewest_deals(replicates_a: int, replicates_b: int, paired: bool) -> float:
    """Return the smallest p-value that replicates alone can claim, whatever their distribution.

    A rare sample of one brightness may be in every replicate of one night and in none of the other:
    without change that happens as often as dealing the replicates (or their signs) that way.
    """
    ways = int(2 ** (replicates_a - 1))
    if not paired:
        ways = math.comb(replicates_a + replicates_b, replicates_a) // 2
    return 1.0 / max(ways, 1)


def _contributions(of: Sequence[Signature], image: bool, groups: int) -> Figures:
    """Return what each part adds to its region's mean: (replicates, regions, parts, 3).

    Parts are the groups of pixels, joined to `groups` in a tile (a divisor of their number); the
    regions of all cells follow each other.
    """
    pixels = of[0].pixels.astype(np.float64)
    weights = pixels / (pixels.sum() if image else pixels.sum(1, keepdims=True))
    stacked = np.stack([signature.means for signature in of], axis=1).astype(np.float64)
    found: Figures = stacked * weights[..., None]
    joined: Figures = found.reshape(*found.shape[:3], -1, groups, 3).sum(3)
    replicates, cells, tiles = joined.shape[:3]
    if image:
        return joined.reshape(replicates, cells, tiles * groups, 3)
    return joined.reshape(replicates, cells * tiles, groups, 3)


def _parts(contributions: Figures) -> _Parts:
    count = len(contributions)
    if count < 2:
        unknown = np.full(contributions.shape[1:], np.nan)
        return _Parts(contributions[0], unknown, 0)
    variance = contributions.var(0, ddof=1) / count
    return _Parts(contributions.mean(0), variance, count - 1)


def _welch(a: _Parts, b: _Parts, n: int, m: int) -> _Moments:
    """Return differences, variances and variances^2 / nu of every part, for unrelated seeds.

    n, m: samples per pixel of a and b.
    """
    d, u = b.mean - a.mean, a.variance + b.variance
    q = a.variance**2 / max(a.nu, 1) + b.variance**2 / max(b.nu, 1)
    if n != m:
        # Variance of one sample by both nights' samples together: what "no change" implies.
        total_a, total_b = a.variance.sum(1), b.variance.sum(1)
        together = (n * n * total_a + m * m * total_b) / (n + m) * (1.0 / n + 1.0 / m)
        alone = total_a + total_b
        ratio = np.divide(together, alone, out=np.ones_like(alone), where=alone > 0.0)
        scale = np.maximum(ratio, 1.0)[:, None]
        u, q = u * scale, q * scale**2
    return d, u, q


def _error(u: Figures, q: Figures) -> tuple[Figures, Figures]:
    """Return standard error and degrees of freedom of every region."""
    total, squares = u.sum(1), q.sum(1)
    dof = np.divide(total**2, squares, out=np.full_like(total, np.nan), where=squares > 0.0)
    return np.sqrt(total), dof


def _p_values(d: Figures, u: Figures, q: Figures, floor: Figures) -> Figures:
    """Return two-sided p-values of the regions, guarded by leaving out each part in turn."""
    total = d.sum(1)
    p = _student(total, u.sum(1), q.sum(1), floor)
    if d.shape[1] > 1:
        region, channel = np.nonzero(p < WORTH_A_SECOND_LOOK)
        if len(region):
            left = [x[region, :, channel] for x in (d, u, q)]
            rest = [np.maximum(x.sum(1, keepdims=True) - x, 0.0) for x in left[1:]]
            without = left[0].sum(1, keepdims=True) - left[0]
            limit = np.broadcast_to(floor[region, channel][:, None], without.shape)
            worst = _student(without, _clean(rest[0], left[1]), rest[1], limit).max(1) ** 2
            p[region, channel] = np.maximum(p[region, channel], worst)
    return p


def _clean(rest: Figures, parts: Figures) -> Figures:
    """Return sums without one part, zero where only rounding is left."""
    whole = parts.sum(1, keepdims=True)
    return np.where(rest > 1e-13 * whole, rest, 0.0)


def _student(d: Figures, variance: Figures, squares: Figures, floor: Figures) -> Figures:
    """Return two-sided p-values by Student's t; exact where there is no variance."""
    from matiere import _core

    p = np.full(d.shape, np.nan)
    moved = abs(d) > floor
    p[(variance == 0.0) | ~moved & np.isfinite(variance)] = 1.0
    p[(variance == 0.0) & moved] = 0.0  # constant in both nights, and not the same constant
    at = (variance > 0.0) & moved
    if at.any():
        dof = variance[at] ** 2 / np.maximum(squares[at], np.finfo(float).tiny)
        t = abs(d[at]) / np.sqrt(variance[at])
        p[at] = 2.0 * np.asarray(_core.student_tail(t, np.maximum(dof, 1.0)))
    return p


def corrected(p_values: Figures, method: str) -> Figures:
    """Correct p-values for their number; NaN (unknown) stays and does not count.

    `holm` (1979): the chance of any false alarm, whatever the dependence. `bh` (Benjamini &
    Hochberg 1995): the expected share of false ones among the alarms, for independent or
    positively dependent tests; `by` (Benjamini & Yekutieli 2001): for any dependence.
    """
    flat = p_values.ravel()
    known = np.flatnonzero(np.isfinite(flat))
    count = len(known)
    out = np.full(flat.shape, np.nan)
    if not count:
        return out.reshape(p_values.shape)
    order = known[np.argsort(flat[known], kind="stable")]
    rank = np.arange(1, count + 1)
    if method == "holm":
        found = np.maximum.accumulate(flat[order] * (count - rank + 1))
    else:
        factor = (1.0 / rank).sum() if method == "by" else 1.0
        raw = flat[order] * factor * count / rank
        found = np.minimum.accumulate(raw[::-1])[::-1]
    out[order] = np.minimum(found, 1.0)
    return out.reshape(p_values.shape)


def detectable(error: Figures, dof: Figures, level: float, power: float = 0.8) -> Figures:
    """Return the change that a two-sided test at `level` finds with probability `power`.

    About t(level / 2) + t(1 - power) standard errors; NaN where the error is zero or unknown.
    """
    good = np.isfinite(dof) & (error > 0.0)
    out = np.full(error.shape, np.nan)
    if good.any():
        nu = np.maximum(dof[good], 1.0)
        out[good] = (_quantiles(level / 2, nu) + _quantiles(1.0 - power, nu)) * error[good]
    return out


def _quantiles(tail: float, nu: Figures) -> Figures:
    """Return quantiles of Student's t to a relative 1e-3: between 300 degrees of freedom."""
    from matiere import _core

    grid = np.geomspace(1.0, max(float(nu.max()), 2.0), 300)
    t = np.asarray(_core.student_quantile(np.full(grid.shape, tail), grid))
    return np.asarray(np.exp(np.interp(np.log(nu), np.log(grid), np.log(t))))


def interval_half(error: Figures, dof: Figures, tail: float) -> Figures:
    """Return half the width of the two-sided interval that leaves out `tail` on each side."""
    from matiere import _core

    nu = np.where(np.isfinite(dof), np.maximum(dof, 1.0), 1.0)
    t = np.asarray(_core.student_quantile(np.full(nu.shape, tail), nu))
    return np.where(error > 0.0, t * error, 0.0)
