"""Does `sample` draw from `pdf`?

Cells follow the samples of an independent pilot run, so that lobes of any width and slant fill them
evenly; expected counts come from adaptive quadrature of the pdf.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

SPECULAR = 4
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Outcome:
    """What one run of the test found."""

    p_value: float
    integral: float  # of the pdf over the sphere
    rejected: float  # share of samples that gave nothing
    delta: float  # probability of delta events, as their pdf says
    albedo: Floats  # of the non-delta part, by quadrature of f cos
    samples: int

    @property
    def gap(self) -> float:
        """How far pdf, delta events and rejected samples are from making 1 together."""
        return self.integral + self.rejected + self.delta - 1


def angles(w: Floats) -> tuple[Floats, Floats]:
    """Return polar angle (with its digits near both poles) and azimuth."""
    return np.arctan2(np.hypot(w[:, 0], w[:, 1]), w[:, 2]), np.arctan2(w[:, 1], w[:, 0])


class Cells:
    """Rectangles in polar angle and azimuth over one hemisphere, filled evenly by pilot samples."""

    def __init__(self, pilot: Floats, side: float, *, fine: bool = False) -> None:
        strips, sectors = (24, 24) if fine else (12, 10)
        self.tolerance = 1e-7 if fine else 2e-6
        theta, phi = angles(pilot)
        mean = np.exp(1j * phi).mean()
        self.center = float(np.angle(mean)) if abs(mean) > 1e-3 else 0.0
        phi = self._turn(phi)
        low, high = (0.0, np.pi / 2) if side > 0 else (np.pi / 2, np.pi)
        inner = np.quantile(theta, np.linspace(0, 1, strips + 1)[1:-1])
        self.theta = np.unique(np.clip(np.concatenate([[low], inner, [high]]), low, high))
        strip = np.clip(np.searchsorted(self.theta, theta) - 1, 0, len(self.theta) - 2)
        self.phi = [self._sectors(phi[strip == k], sectors) for k in range(len(self.theta) - 1)]

    def _turn(self, phi: Floats) -> Floats:
        return (phi - self.center + np.pi) % (2 * np.pi) - np.pi

    @staticmethod
    def _sectors(phi: Floats, n: int) -> Floats:
        if len(phi) < 2 * n:
            return np.array([-np.pi, np.pi])
        inner = np.quantile(phi, np.linspace(0, 1, n + 1)[1:-1])
        return np.unique(np.concatenate([[-np.pi], inner, [np.pi]]))

    def rectangles(self) -> tuple[Floats, NDArray[np.intp]]:
        """Return (theta0, theta1, phi0, phi1) of pieces of cells and the cell each belongs to.

        The wide outer cells hold the tail of a peak that may be far narrower: they are cut into
        pieces that grow geometrically away from it. Azimuths are relative to the center.
        """
        found: list[Floats] = []
        owners: list[NDArray[np.intp]] = []
        first = 0
        thetas = _pieces(self.theta)
        for k, edges in enumerate(self.phi):
            sectors = _pieces(edges)
            for j, phi in enumerate(sectors):
                t, p = thetas[k], phi
                grid = np.stack(
                    [
                        np.repeat(t[:-1], len(p) - 1),
                        np.repeat(t[1:], len(p) - 1),
                        np.tile(p[:-1], len(t) - 1),
                        np.tile(p[1:], len(t) - 1),
                    ],
                    axis=1,
                )
                found.append(grid)
                owners.append(np.full(len(grid), first + j))
            first += len(sectors)
        return np.concatenate(found), np.concatenate(owners)

    def count(self, w: Floats) -> Floats:
        theta, phi = angles(w)
        phi = self._turn(phi)
        strip = np.clip(np.searchsorted(self.theta, theta, "right") - 1, 0, len(self.phi) - 1)
        counts = [np.histogram(phi[strip == k], edges)[0] for k, edges in enumerate(self.phi)]
        return np.concatenate(counts).astype(float)

    def integrate(self, value: Callable[[Floats], Floats]) -> Floats:
        """Integrate `value(directions) -> (N, K)` over every cell; the first column steers."""
        cells, owner = self.rectangles()
        coarse = self._quadrature(cells, value)
        total = np.zeros((owner[-1] + 1, coarse.shape[1]))
        for _ in range(40):
            children = _quarters(cells)
            fine = self._quadrature(children, value)
            sums = fine.reshape(4, len(cells), -1).sum(axis=0)
            good = np.abs(sums - coarse)[:, 0] <= self.tolerance
            np.add.at(total, owner[good], sums[good])
            if good.all():
                return total
            bad = np.tile(~good, 4)
            owner = np.tile(owner, 4)[bad]
            cells, coarse = children[bad], fine[bad]
        np.add.at(total, owner, coarse)
        return total

    def _quadrature(self, cells: Floats, value: Callable[[Floats], Floats]) -> Floats:
        x, w = np.polynomial.legendre.leggauss(5)
        x, w = (x + 1) / 2, w / 2
        theta = cells[:, 0, None] + (cells[:, 1] - cells[:, 0])[:, None] * x
        phi = cells[:, 2, None] + (cells[:, 3] - cells[:, 2])[:, None] * x + self.center
        t = np.repeat(theta, len(x), axis=1).ravel()
        p = np.tile(phi, (1, len(x))).ravel()
        s = np.sin(t)
        values = value(np.stack([s * np.cos(p), s * np.sin(p), np.cos(t)], axis=1))
        area = (cells[:, 1] - cells[:, 0]) * (cells[:, 3] - cells[:, 2])
        weights = area[:, None] * np.outer(w, w).ravel() * s.reshape(len(cells), -1)
        return np.einsum("cq,cqk->ck", weights, values.reshape(len(cells), len(x) ** 2, -1))


def _pieces(edges: Floats) -> list[Floats]:
    """Return the edges within each interval: the first and last ones cut geometrically."""
    inner = [edges[k : k + 2] for k in range(len(edges) - 1)]
    if len(edges) < 4:
        return [np.linspace(a, b, 9) for a, b in inner]
    for k, anchor, width in (
        (0, edges[1], edges[2] - edges[1]),
        (-1, edges[-2], edges[-3] - edges[-2]),
    ):
        length = abs(inner[k][1] - inner[k][0])
        steps = abs(width) * (2.0 ** np.arange(1, 60) - 1)
        steps = np.concatenate([[0.0], steps[steps < 0.75 * length], [length]])
        cut = anchor - np.sign(width) * steps
        inner[k] = np.sort(np.clip(cut, edges[0], edges[-1]))
    return inner


def _quarters(cells: Floats) -> Floats:
    a, b, c, d = cells.T
    m, n = (a + b) / 2, (c + d) / 2
    parts = [(a, m, c, n), (a, m, n, d), (m, b, c, n), (m, b, n, d)]
    return np.concatenate([np.stack(p, axis=1) for p in parts])


def draw(bsdf: Any, wo: Floats, n: int, seed: int) -> Any:
    """Return n samples for one wo."""
    u = np.random.default_rng(seed).random((n, 3), dtype=np.float32)
    return bsdf.sample(wo, u)


def run(bsdf: Any, wo: Floats, n: int = 40_000, seed: int = 1, *, fine: bool = False) -> Outcome:
    """Sample, integrate, compare. The last class of the chi-square is "rejected".

    `fine` is for lobes that are thin and slanting, which rectangles fit badly.
    """
    pilot = draw(bsdf, wo, 16_000 if fine else 4000, seed + 1000)
    s = draw(bsdf, wo, n, seed)
    dull = (s.lobe != 0) & ((s.lobe & SPECULAR) == 0)
    delta = _delta_mass(s)
    rejected = float(np.mean(s.lobe == 0))
    pilot_dull = pilot.wi[(pilot.lobe != 0) & ((pilot.lobe & SPECULAR) == 0)].astype(float)

    def value(w: Floats) -> Floats:
        pdf = np.asarray(bsdf.pdf(wo, w), dtype=float)
        return np.concatenate([pdf[:, None], np.asarray(bsdf.eval(wo, w), dtype=float)], axis=1)

    observed, expected, totals = [], [], np.zeros(4)
    for side in (1.0, -1.0):
        there = pilot_dull[pilot_dull[:, 2] * side > 0]
        if len(there) < 10:
            continue
        cells = Cells(there, side, fine=fine)
        mass = cells.integrate(value)
        totals += mass.sum(axis=0)
        expected.append(mass[:, 0] * n)
        observed.append(cells.count(s.wi[dull & (s.wi[:, 2] * side > 0)].astype(float)))
    missing = max(0.0, 1 - totals[0] - delta)
    sharp = float(np.count_nonzero((s.lobe & SPECULAR) != 0))
    e = np.concatenate([*expected, [delta * n, missing * n]])
    o = np.concatenate([*observed, [sharp, rejected * n]])
    return Outcome(_p_value(e, o), float(totals[0]), rejected, delta, totals[1:], n)


def _delta_mass(s: Any) -> float:
    """Return the sum of the probabilities of the delta lobes that were met."""
    lobes = np.unique(s.lobe[(s.lobe & SPECULAR) != 0])
    return float(sum(np.median(s.pdf[s.lobe == lobe]) for lobe in lobes))


def _p_value(expected: Floats, observed: Floats) -> float:
    """Pool cells that expect fewer than 10, then Pearson's chi-square."""
    few = expected < 10
    e = np.append(expected[~few], expected[few].sum())
    o = np.append(observed[~few], observed[few].sum())
    if e[-1] < 10:  # too few even together for chi-square: what Poisson allows
        if stats.poisson.sf(o[-1] - 1, max(e[-1], 1e-3)) < 1e-9:
            return 0.0
        e, o = e[:-1], o[:-1]
    if len(e) < 2:
        return 1.0
    chi2 = float(np.sum((o - e) ** 2 / e))
    return float(stats.chi2.sf(chi2, len(e) - 1))


def sidak(level: float, tests: int) -> float:
    """Return the level of one test so that all together keep `level`."""
    return float(1 - (1 - level) ** (1 / tests))
