"""What one viewer sees of a material: does sampling follow the density, where does energy go?"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from matiere.stability.cells import Cells
from matiere.stability.charts import Chart, Floats, Mask, Region, regions
from matiere.stability.statistics import chi_square_p

SPECULAR, TRANSMISSION = 4, 16
PILOT = 8192
CELLS = 128
ROUNDED = 0.01  # p-value


class Scatterer(Protocol):
    """What is checked: a `matiere.Bsdf`, or anything that answers as it does."""

    def eval(self, wo: Any, wi: Any) -> NDArray[Any]:
        """Return f |cos theta_i|, (N, 3)."""
        ...

    def pdf(self, wo: Any, wi: Any) -> NDArray[Any]:
        """Return the density of `sample`, (N,)."""
        ...

    def sample(self, wo: Any, u: Any) -> Any:
        """Return wi, weight, pdf, lobe, eta of every row of u."""
        ...


@dataclass(frozen=True)
class Effort:
    """How hard to look."""

    samples: int = 20_000
    tolerance: float = 2e-6  # of each rectangle's integral
    budget: int = 1_000_000  # evaluations per region of the sphere


@dataclass(frozen=True)
class View:
    """What was found for one direction of view.

    Shares are of the light of a white furnace: energy, so transmission counts without 1 / eta^2.
    """

    wo: Floats
    samples: int
    p_value: float  # chi-square of sample against pdf
    integral: float  # of the pdf over the sphere
    rejected: float  # share of samples that gave nothing
    delta: float  # probability of delta events, as their pdf says
    uncertain: float  # how far the quadrature is from settled
    albedo: Floats  # (3,) by quadrature of eval, delta events as sampled
    albedo_sampled: Floats  # (3,) mean sample weight
    albedo_error: Floats  # (3,) standard error of the latter
    weight_gap: float  # mean |eval / pdf - weight| over the mean weight
    weight_gap_worst: float
    largest_weight: float
    p_value_float: float = math.nan  # of float samples; NaN where float cannot resolve the lobe

    @property
    def gap(self) -> float:
        """How far pdf, delta events and rejected samples are from making 1 together."""
        return self.integral + self.rejected + self.delta - 1

    @property
    def gap_error(self) -> float:
        """The standard error of `gap`: that of the share of rejected samples."""
        return math.sqrt(max(0.0, self.rejected * (1 - self.rejected)) / self.samples)


class Draw:
    """N samples for one view, as arrays of doubles in a frame where the viewer is above."""

    def __init__(self, bsdf: Scatterer, wo: Floats, n: int, seed: int) -> None:
        """Draw independent samples."""
        u = np.random.default_rng(seed).random((n, 3))
        s = bsdf.sample(wo, u)
        self.n, self.u = n, u
        self.lobe = np.asarray(s.lobe)
        self.wi = np.asarray(s.wi, dtype=float)
        self.pdf = np.asarray(s.pdf, dtype=float)
        self.eta = np.asarray(s.eta, dtype=float)
        self.through = (self.lobe & TRANSMISSION) != 0
        self.sharp = (self.lobe & SPECULAR) != 0
        self.dull: Mask = (self.lobe != 0) & ~self.sharp
        energy = np.where(self.through, self.eta**2, 1.0)
        self.weight = np.asarray(s.weight, dtype=float)
        self.energy = self.weight * energy[:, None]

    def rounded(self) -> Draw:
        """Return the samples as float holds them."""
        same = copy(self)
        same.wi = self.wi.astype(np.float32).astype(float)
        return same

    @property
    def index(self) -> float:
        """The relative index of what was transmitted; 1 where nothing was refracted."""
        eta = self.eta[self.through]
        if len(eta) == 0:
            return 1.0
        values, counts = np.unique(eta, return_counts=True)
        return float(values[int(np.argmax(counts))])

    @property
    def one_index(self) -> bool:
        """Tell whether all transmitted samples have the same relative index."""
        eta = self.eta[self.through]
        return len(eta) == 0 or bool(np.ptp(eta) <= 1e-6 * eta[0])


def flip(wo: Floats) -> Floats:
    """Return the factors that mirror a viewer below to above."""
    return np.array([1.0, 1.0, -1.0 if wo[2] < 0 else 1.0])


def look(
    bsdf: Scatterer,
    wo: Floats,
    seed: int = 1,
    effort: Effort | None = None,
    single: Scatterer | None = None,
) -> View:
    """Measure one view. The last classes of the chi-square are delta events and "rejected".

    `single` is the same material in float: its samples are held against the same cells.
    """
    effort = effort or Effort()
    pilot = Draw(bsdf, wo, min(PILOT, effort.samples), seed + 1000)
    s = Draw(bsdf, wo, effort.samples, seed)
    mass = _Mass(bsdf, wo, pilot, effort)
    delta, delta_albedo = delta_events(s)
    integral = float(mass.totals[0])
    expected = np.append(mass.expected, [delta, max(0.0, 1 - integral - delta)]) * s.n
    variance = (np.append(mass.uncertain, [0.0, mass.doubt]) * s.n) ** 2
    p_float = math.nan
    # Where rounding the double samples is seen already, float cannot tell the lobe's directions.
    if single is not None and chi_square_p(expected, mass.count(s.rounded()), variance) > ROUNDED:
        p_float = chi_square_p(expected, mass.count(Draw(single, wo, s.n, seed + 500)), variance)
    mean_gap, worst_gap = _weight_gap(bsdf, wo, s)
    return View(
        wo=wo,
        samples=s.n,
        p_value=chi_square_p(expected, mass.count(s), variance),
        p_value_float=p_float,
        integral=integral,
        rejected=float(np.mean(s.lobe == 0)),
        delta=delta,
        uncertain=float(mass.uncertain.sum()),
        albedo=mass.totals[1:] + delta_albedo,
        albedo_sampled=s.energy.mean(axis=0),
        albedo_error=s.energy.std(axis=0) / math.sqrt(s.n),
        weight_gap=mean_gap,
        weight_gap_worst=worst_gap,
        largest_weight=float(s.energy.max(initial=0.0)),
    )


class _Mass:
    """The shares of the density in every cell, and the samples found there."""

    def __init__(self, bsdf: Scatterer, wo: Floats, pilot: Draw, effort: Effort) -> None:
        self._mirror = mirror = flip(wo)
        index = pilot.index
        guide = pilot.wi[pilot.dull] * mirror
        density = np.asarray(bsdf.pdf(wo, pilot.wi[pilot.dull]), dtype=float)

        def value(wi: Floats) -> Floats:
            pdf = np.asarray(bsdf.pdf(wo, wi * mirror), dtype=float)
            f = np.asarray(bsdf.eval(wo, wi * mirror), dtype=float)
            energy = np.where(wi[:, 2:] < 0, index**2, 1.0)
            return np.concatenate([pdf[:, None], f * energy], axis=1)

        self._parts: list[tuple[Region, Cells]] = []
        found = []
        for region in regions(wo * mirror, index):
            mine = region.contains(guide)
            chart = Chart.fitted(region, guide[mine], density[mine])
            share = np.count_nonzero(mine) / max(1, len(guide))
            cells = Cells(chart, guide[mine], round(CELLS * share))
            found.append(cells.integrate(value, effort.tolerance, effort.budget))
            self._parts.append((region, cells))
        self.totals = np.sum([part.cells.sum(axis=0) for part in found], axis=0)
        self.doubt = sum(part.doubt for part in found)
        self.expected = np.concatenate([part.cells[:, 0] for part in found])
        self.uncertain = np.concatenate([part.uncertain for part in found])

    def count(self, s: Draw) -> Floats:
        """Return the samples in every cell, the delta events, and the rejected."""
        drawn = s.wi[s.dull] * self._mirror
        counts: list[Any] = []
        for region, cells in self._parts:
            there = drawn[region.contains(drawn)]
            counts.append(np.bincount(cells.find(there), minlength=len(cells)))
        counts.append([np.count_nonzero(s.sharp), np.count_nonzero(s.lobe == 0)])
        return np.concatenate(counts).astype(float)


def delta_events(s: Draw) -> tuple[float, Floats]:
    """Return the probability of delta events and their share of the energy."""
    probability, energy = 0.0, np.zeros(3)
    for lobe in np.unique(s.lobe[s.sharp]):
        these = s.lobe == lobe
        chance = float(np.median(s.pdf[these]))
        probability += chance
        energy += chance * np.median(s.energy[these], axis=0)
    return probability, energy


def _weight_gap(bsdf: Scatterer, wo: Floats, s: Draw, most: int = 4000) -> tuple[float, float]:
    """Return mean and worst |eval / pdf - weight| over the mean weight."""
    which = np.flatnonzero(s.dull)[:most]
    weight = s.weight[which]
    mean = float(weight.mean()) if len(which) else 0.0
    if mean == 0.0:
        return 0.0, 0.0
    f = np.asarray(bsdf.eval(wo, s.wi[which]), dtype=float)
    pdf = np.asarray(bsdf.pdf(wo, s.wi[which]), dtype=float)[:, None]
    ratio = np.where(pdf > 0, f / np.where(pdf > 0, pdf, 1.0), 0.0)
    gap = np.abs(ratio - weight).max(axis=1)
    return float(gap.mean()) / mean, float(gap.max()) / mean
