"""One view of a material whose `eval` is an unbiased estimate: what is promised of expectations.

Its pdf is a stand-in for weighting, so samples are not held against it, nor weights against eval /
pdf. Promised is that eval and the sample weights have the same expectation in every cell.
"""

from __future__ import annotations

import math

import numpy as np

from matiere.stability.cells import Cells
from matiere.stability.charts import Chart, Floats, regions
from matiere.stability.statistics import chi_square_tail
from matiere.stability.views import CELLS, PILOT, Draw, Effort, Scatterer, View, flip

POINTS = 12_000  # directions at which eval is asked
FEWEST_SAMPLES = 20  # of a cell
MOST_NOISE = 0.3  # cells whose difference is known worse than this are pooled
UNKNOWN = math.nan


def is_estimate(bsdf: Scatterer) -> bool:
    """Tell whether eval is an estimate of a random walk, by the probe's `stochastic`."""
    return bool(getattr(bsdf, "stochastic", False))


def look_at_estimate(bsdf: Scatterer, wo: Floats, seed: int, effort: Effort) -> View:
    """Measure one view; `p_value` is that of eval against sampling, cell by cell."""
    pilot = Draw(bsdf, wo, min(PILOT, effort.samples), seed + 1000)
    s = Draw(bsdf, wo, effort.samples, seed)
    mirror, index = flip(wo), pilot.index
    guide, drawn = pilot.wi[pilot.dull] * mirror, s.wi[s.dull] * mirror
    density = np.asarray(bsdf.pdf(wo, pilot.wi[pilot.dull]), dtype=float)
    energy = s.energy[s.dull].mean(axis=1)

    def value(wi: Floats) -> Floats:
        f = np.asarray(bsdf.eval(wo, wi * mirror), dtype=float).mean(axis=1)
        return np.asarray(f * np.where(wi[:, 2] < 0, index**2, 1.0))

    def stand_in(wi: Floats) -> Floats:
        return np.asarray(bsdf.pdf(wo, wi * mirror), dtype=float)[:, None]

    rows = []
    # No cell is known better than the largest single event seen anywhere: where tails are heavy,
    # its own events tell too little of its variance.
    largest = float(energy.max(initial=0.0)) / s.n
    for region in regions(wo * mirror, index):
        mine, there = region.contains(guide), region.contains(drawn)
        chart = Chart.fitted(region, guide[mine], density[mine])
        share = np.count_nonzero(mine) / max(1, len(guide))
        cells = Cells(chart, guide[mine], round(CELLS / 2 * share))
        by_eval, noise, one = cells.estimate(stand_in, value, POINTS, seed)
        largest = max(largest, one)
        cell = cells.find(drawn[there])
        first = np.bincount(cell, energy[there], len(cells)) / s.n
        second = np.bincount(cell, energy[there] ** 2, len(cells)) / s.n
        met = np.bincount(cell, minlength=len(cells))
        rows.append(np.stack([by_eval, noise, first, (second - first**2) / s.n, met]))
    by_eval, noise, by_sample, spread, met = np.concatenate(rows, axis=1)
    delta_energy = s.energy[s.sharp].sum() / (3 * s.n)  # only samples tell it
    error = math.sqrt(noise.sum())
    return View(
        wo=wo,
        samples=s.n,
        p_value=_agreement(by_eval, by_sample, noise + spread + largest**2, met),
        integral=UNKNOWN,
        rejected=float(np.mean(s.lobe == 0)),
        delta=float(np.mean(s.sharp)),
        uncertain=3 * error,
        albedo=np.full(3, by_eval.sum() + delta_energy),
        albedo_sampled=np.full(3, s.energy.mean()),
        albedo_error=np.full(3, math.hypot(error, s.energy.mean(axis=1).std() / math.sqrt(s.n))),
        weight_gap=UNKNOWN,
        weight_gap_worst=UNKNOWN,
        largest_weight=float(s.energy.max(initial=0.0)),
    )


def _agreement(a: Floats, b: Floats, variance: Floats, met: Floats) -> float:
    """Return the chance of differences as large.

    Cells that are mostly noise, or whose variance few samples tell, are put together.
    """
    noisy = np.sqrt(variance) > MOST_NOISE * np.maximum(np.abs(a), np.abs(b))
    noisy |= met < FEWEST_SAMPLES
    if met[noisy].sum() < FEWEST_SAMPLES:
        a, b, variance, noisy = a[~noisy], b[~noisy], variance[~noisy], noisy[~noisy]
    difference = np.append((a - b)[~noisy], (a - b)[noisy].sum())
    variance = np.append(variance[~noisy], variance[noisy].sum())
    used = variance > 0
    if not used.any():
        return 1.0
    return chi_square_tail(float(np.sum(difference[used] ** 2 / variance[used])), int(used.sum()))
