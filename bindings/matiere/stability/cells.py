"""Cells that samples fill evenly, and integrals over them that miss no peak.

The cells of a chart are the leaves of a k-d tree over pilot samples. Integrals refine each cell
until both halves of every cut agree with the whole: tensor Gauss-Legendre, four children at a time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matiere.stability.charts import Chart, Floats

LONGEST_SIDE = 2.0  # of a first rectangle: charts stretch every scale to about 1
ORDER = 5
MAX_LEVELS = 30
MESH_TOLERANCE, MESH_BUDGET = 3e-5, 60_000
FEWEST = 4  # random points in a rectangle
FEW = 256  # points that decide which way a cell is cut

Value = Callable[[Floats], Floats]


@dataclass(frozen=True)
class _Leaf:
    """One cell: x0, x1, y0, y1."""

    box: tuple[float, float, float, float]
    index: int


@dataclass(frozen=True)
class _Cut:
    axis: int
    at: float
    below: _Cut | _Leaf
    above: _Cut | _Leaf


@dataclass(frozen=True)
class Mesh:
    """Rectangles (x0, x1, y0, y1), the cell of each, and its share of the first column."""

    boxes: Floats
    owner: NDArray[np.intp]
    mass: Floats


@dataclass(frozen=True)
class Integral:
    """Values integrated over each cell, (cells, K), and how uncertain the first column is.

    `uncertain`: what the budget left open in each cell. `doubt`: the last changes of all that was
    settled, summed without regard to sign: far more than the error of a smooth integrand.
    """

    cells: Floats
    uncertain: Floats
    doubt: float
    mesh: Mesh


class Cells:
    """A chart cut into cells."""

    def __init__(self, chart: Chart, pilot: Floats, count: int) -> None:
        """Cut into about `count` cells, each with an equal share of the pilot directions."""
        self.chart = chart
        self._boxes: list[tuple[float, float, float, float]] = []
        x0, x1, y0, y1 = (float(v) for v in chart.bounds())
        depth = max(0, round(np.log2(max(1, count))))
        self._root = self._grow(chart.place(pilot), (x0, x1, y0, y1), depth)

    def __len__(self) -> int:
        """Return the number of cells."""
        return len(self._boxes)

    def _grow(
        self, points: Floats, box: tuple[float, float, float, float], depth: int
    ) -> _Cut | _Leaf:
        if depth == 0 or len(points) < 2:
            self._boxes.append(box)
            return _Leaf(box, len(self._boxes) - 1)
        some = points[:FEW]
        axis = int(np.argmax(np.abs(some - some.mean(axis=0)).sum(axis=0)))
        at = float(np.median(points[:, axis]))
        low, high = list(box), list(box)
        low[2 * axis + 1] = high[2 * axis] = at
        under = points[:, axis] < at
        return _Cut(
            axis,
            at,
            self._grow(points[under], (low[0], low[1], low[2], low[3]), depth - 1),
            self._grow(points[~under], (high[0], high[1], high[2], high[3]), depth - 1),
        )

    def find(self, wi: Floats) -> NDArray[np.intp]:
        """Return the cell of each direction."""
        found = np.zeros(len(wi), dtype=np.intp)
        _descend(self._root, self.chart.place(wi), np.arange(len(wi)), found)
        return found

    def integrate(self, value: Value, tolerance: float, budget: int) -> Integral:
        """Integrate `value(directions) -> (N, K)` over every cell.

        Rectangles are cut while the sum of all columns changes by more than `tolerance`; what is
        still open when `budget` evaluations are spent is told in `uncertain`.
        """
        boxes, owner = self._pieces()
        coarse = self._quadrature(boxes, value)
        total = np.zeros((len(self), coarse.shape[1]))
        open_ = np.zeros(len(self))
        doubt, settled = 0.0, []
        spent = len(boxes) * ORDER**2
        for _ in range(MAX_LEVELS):
            children = _quarters(boxes)
            fine = self._quadrature(children, value)
            spent += len(children) * ORDER**2
            sums = fine.reshape(4, len(boxes), -1).sum(axis=0)
            change = np.abs(sums - coarse)
            bad = ~(change.max(axis=1) <= tolerance)
            if spent > budget:
                np.add.at(open_, owner[bad], change[bad, 0])
                bad[:] = False
            doubt += float(change[~bad, 0].sum())
            np.add.at(total, owner[~bad], sums[~bad])
            settled.append(Mesh(boxes[~bad], owner[~bad], sums[~bad, 0]))
            if not bad.any():
                break
            again = np.tile(bad, 4)
            boxes, coarse, owner = children[again], fine[again], np.tile(owner, 4)[again]
        else:
            np.add.at(total, owner, coarse)
            settled.append(Mesh(boxes, owner, coarse[:, 0]))
        mesh = Mesh(*(np.concatenate(part) for part in zip(*map(_parts, settled), strict=True)))
        return Integral(total, open_, doubt, mesh)

    def estimate(
        self, guide: Value, value: Value, points: int, seed: int
    ) -> tuple[Floats, Floats, float]:
        """Return estimates of the integral of `value(directions) -> (N,)`, and their variances.

        The last is the largest share that a single direction has in any of them. For values that
        are estimates themselves: they are taken at random directions, about `points` in all, in
        rectangles over which `guide`, a smooth stand-in, is smooth.
        """
        mesh = self.integrate(guide, MESH_TOLERANCE, MESH_BUDGET).mesh
        boxes, owner = mesh.boxes, mesh.owner
        share = mesh.mass / max(float(mesh.mass.sum()), 1e-300)
        counts = np.maximum(FEWEST, np.round(points * share)).astype(int)
        which = np.repeat(np.arange(len(boxes)), counts)
        low, size = boxes[:, 0::2], boxes[:, 1::2] - boxes[:, 0::2]
        xy = low[which] + size[which] * np.random.default_rng(seed).random((len(which), 2))
        wi, jacobian = self.chart.direction(xy)
        there = jacobian > 0
        values = np.zeros(len(wi))
        values[there] = value(wi[there]) * jacobian[there]
        mean = np.bincount(which, values) / counts
        spread = np.bincount(which, (values - mean[which]) ** 2) / (counts - 1) / counts
        area = size.prod(axis=1)
        means, variances = np.zeros(len(self)), np.zeros(len(self))
        np.add.at(means, owner, mean * area)
        np.add.at(variances, owner, spread * area**2)
        one = values * (area / counts)[which]
        return means, variances, float(one.max(initial=0.0))

    def _pieces(self) -> tuple[Floats, NDArray[np.intp]]:
        """Cells cut into rectangles whose sides are short enough to see every peak."""
        found, owners = [], []
        for k, (x0, x1, y0, y1) in enumerate(self._boxes):
            x = np.linspace(x0, x1, 1 + max(1, int(np.ceil((x1 - x0) / LONGEST_SIDE))))
            y = np.linspace(y0, y1, 1 + max(1, int(np.ceil((y1 - y0) / LONGEST_SIDE))))
            a, c = (g.ravel() for g in np.meshgrid(x[:-1], y[:-1], indexing="ij"))
            b, d = (g.ravel() for g in np.meshgrid(x[1:], y[1:], indexing="ij"))
            found.append(np.stack([a, b, c, d], axis=1))
            owners.append(np.full(len(a), k, dtype=np.intp))
        return np.concatenate(found), np.concatenate(owners)

    def _quadrature(self, boxes: Floats, value: Value) -> Floats:
        nodes, weights = np.polynomial.legendre.leggauss(ORDER)
        nodes, weights = (nodes + 1) / 2, weights / 2
        x = boxes[:, 0, None] + (boxes[:, 1] - boxes[:, 0])[:, None] * nodes
        y = boxes[:, 2, None] + (boxes[:, 3] - boxes[:, 2])[:, None] * nodes
        xy = np.stack([np.repeat(x, ORDER, axis=1).ravel(), np.tile(y, (1, ORDER)).ravel()], axis=1)
        wi, jacobian = self.chart.direction(xy)
        there = jacobian > 0
        values = value(wi[there]) * jacobian[there, None]
        spread = np.zeros((len(xy), values.shape[1]))
        spread[there] = values
        area = (boxes[:, 1] - boxes[:, 0]) * (boxes[:, 3] - boxes[:, 2])
        both = np.outer(weights, weights).ravel()
        sums = np.einsum("q,cqk->ck", both, spread.reshape(len(boxes), ORDER**2, -1))
        return np.asarray(sums * area[:, None])


def _descend(
    node: _Cut | _Leaf, points: Floats, which: NDArray[np.intp], found: NDArray[np.intp]
) -> None:
    if isinstance(node, _Leaf):
        found[which] = node.index
        return
    under = points[which, node.axis] < node.at
    _descend(node.below, points, which[under], found)
    _descend(node.above, points, which[~under], found)


def _parts(mesh: Mesh) -> tuple[Floats, NDArray[np.intp], Floats]:
    return mesh.boxes, mesh.owner, mesh.mass


def _quarters(boxes: Floats) -> Floats:
    a, b, c, d = boxes.T
    m, n = (a + b) / 2, (c + d) / 2
    parts = [(a, m, c, n), (a, m, n, d), (m, b, c, n), (m, b, n, d)]
    return np.concatenate([np.stack(p, axis=1) for p in parts])
