"""Flat maps of the sphere of directions in which any lobe of a given viewer is wide.

A glossy lobe may be 1e-5 rad narrow, curved, and off any pole; in the plane of half-vectors it is
a round blob about the normal (reflection: h of wo + wi; refraction: h of wo + eta wi, Walter et al.
2007, eq. 16). The plane is the stereographic one of h, turned to the blob's main axes, and each
axis is stretched by asinh about the blob's peak: its core and its tails at every scale then have a
width near 1. Where the peak lies and how narrow it is comes from pilot samples of the sampler.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

CORE_QUANTILE = 0.005  # a lobe with a hundredth of the samples still sets the scale
NARROWEST = 1e-9


def norm(w: Floats) -> Floats:
    """Return the lengths of vectors, (N, 1)."""
    return np.asarray(np.linalg.norm(w, axis=1, keepdims=True))


@dataclass(frozen=True)
class Region:
    """One part of the sphere, told by how its directions come from half-vectors.

    `kind` is "reflected" (the viewer's side), "refracted" (what a facet can refract to, at the
    relative index `eta`) or "behind" (the rest of the other side). `wo` is a unit vector above.
    """

    kind: str
    wo: Floats
    eta: float = 1.0

    def half(self, wi: Floats) -> Floats:
        """Return the half-vectors of directions, (N, 3)."""
        if self.kind == "refracted":
            h = (self.wo + self.eta * wi) * (-1.0 if self.eta > 1 else 1.0)
        else:
            h = self.wo + (wi if self.kind == "reflected" else wi * (1, 1, -1))
        return h / np.maximum(norm(h), 1e-300)

    def contains(self, wi: Floats) -> Mask:
        """Tell which directions belong to this region."""
        if self.kind == "reflected":
            return wi[:, 2] > 0
        below = wi[:, 2] < 0
        if self.kind == "refracted":
            return below & self._refracts(wi)
        return below & ~self._refracts(wi) if self.eta != 1 else below

    def _refracts(self, wi: Floats) -> Mask:
        h = Region("refracted", self.wo, self.eta).half(wi)
        return np.asarray((h[:, 2] > 0) & (h @ self.wo > 0) & (np.sum(h * wi, axis=1) < 0))

    def direction(self, h: Floats) -> tuple[Floats, Floats]:
        """Return wi of half-vectors and d wi / d h; the latter 0 where h gives no wi here."""
        cos_o = h @ self.wo
        if self.kind == "refracted":
            g2 = (self.eta - 1) * (self.eta + 1) + cos_o**2  # (eta cos_t)^2
            g = np.sqrt(np.maximum(g2, 1e-300))
            wi = h * ((cos_o - g) / self.eta)[:, None] - self.wo / self.eta
            jacobian = ((self.eta**2 - 1) / (cos_o + g)) ** 2 / (self.eta * g)
            good = (cos_o > 0) & (g2 > 0) & (wi[:, 2] < 0)
        else:
            wi = h * (2 * cos_o)[:, None] - self.wo
            jacobian, good = 4 * cos_o, (cos_o > 0) & (wi[:, 2] > 0)
            if self.kind == "behind":
                wi = wi * (1, 1, -1)
                good = good & (~self._refracts(wi) if self.eta != 1 else True)
        wi = wi / np.maximum(norm(wi), 1e-300)
        return wi, np.where(good, jacobian, 0.0)


@dataclass(frozen=True)
class Chart:
    """A region laid out on a rectangle; coordinates are (N, 2) and without unit."""

    region: Region
    center: Floats = field(default_factory=lambda: np.zeros(2))
    axes: Floats = field(default_factory=lambda: np.eye(2))  # columns
    scale: Floats = field(default_factory=lambda: np.full(2, 1e-3))

    @classmethod
    def fitted(cls, region: Region, wi: Floats, density: Floats) -> Chart:
        """Return the chart whose middle is the peak of `density` [1/sr] at the samples `wi`."""
        if len(wi) < 4:
            return cls(region)
        h = region.half(wi)
        plane = _stereographic(h)
        jacobian = region.direction(h)[1] * _sphere_per_plane(plane)
        peak = density * jacobian
        center = plane[int(np.argmax(peak))]
        core = plane[peak >= np.median(peak)] - center
        axes = np.linalg.eigh(core.T @ core)[1]
        offsets = np.abs((plane - center) @ axes)
        scale = np.maximum(np.quantile(offsets, CORE_QUANTILE, axis=0), NARROWEST)
        return cls(region, center, axes, scale)

    def bounds(self) -> Floats:
        """Return (x0, x1, y0, y1) of the whole rectangle."""
        middle = self.center @ self.axes
        low, high = np.arcsinh((-1 - middle) / self.scale), np.arcsinh((1 - middle) / self.scale)
        return np.array([low[0], high[0], low[1], high[1]])

    def place(self, wi: Floats) -> Floats:
        """Return the coordinates of directions of the region."""
        plane = _stereographic(self.region.half(wi))
        return np.asarray(np.arcsinh(((plane - self.center) @ self.axes) / self.scale))

    def direction(self, xy: Floats) -> tuple[Floats, Floats]:
        """Return wi of coordinates and steradians per unit of area (0: none there)."""
        plane = (np.sinh(xy) * self.scale) @ self.axes.T + self.center
        stretch = np.prod(np.cosh(xy) * self.scale, axis=1)
        r2 = np.sum(plane**2, axis=1)
        h = np.concatenate([2 * plane, (1 - r2)[:, None]], axis=1) / (1 + r2)[:, None]
        wi, jacobian = self.region.direction(h)
        jacobian = jacobian * _sphere_per_plane(plane) * stretch
        return wi, np.where(r2 < 1, jacobian, 0.0)


def _stereographic(h: Floats) -> Floats:
    return h[:, :2] / (1 + h[:, 2:])


def _sphere_per_plane(plane: Floats) -> Floats:
    return np.asarray(4 / (1 + np.sum(plane**2, axis=1)) ** 2)


def regions(wo: Floats, eta: float) -> list[Region]:
    """Return the regions that together are the sphere; `eta` is that of transmitted samples."""
    kinds = ["reflected", *(["refracted"] if eta != 1 else []), "behind"]
    return [Region(kind, wo, eta) for kind in kinds]
