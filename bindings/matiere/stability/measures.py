"""Measures that need no quadrature: reciprocity, finiteness, float against double, the furnace."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from matiere.stability.charts import Floats, Mask
from matiere.stability.estimates import is_estimate
from matiere.stability.views import Draw, Scatterer

AZIMUTH = 0.4  # of all viewers: along no axis of an anisotropic material [rad]
PAIRS = 2000
FEWEST = 100  # terms of a mean that is held against anything

Viewer = tuple[float, float]  # degrees from the normal, side (1 above, -1 below)


def direction(degrees: float, side: float = 1.0, azimuth: float = AZIMUTH) -> Floats:
    """Return the unit direction at an angle from the normal of a side."""
    theta = math.radians(degrees)
    s = math.sin(theta)
    return np.array([s * math.cos(azimuth), s * math.sin(azimuth), side * math.cos(theta)])


def reciprocity(bsdf: Scatterer, wo: Floats, draw: Draw) -> float:
    """Return the mean |f(o, i) - f(i, o)| over the mean f, where the lobes are.

    Radiance scales with the square of the index: f(o, i) = f(i, o) / eta^2 for a refraction from o
    into i, with eta the index of i's side over that of o's (Veach 1997, section 5.2; our eval
    carries 1 / eta^2).
    """
    which = np.flatnonzero(draw.dull)[:PAIRS]
    wi = draw.wi[which]
    if len(wi) == 0:
        return 0.0
    there = np.broadcast_to(wo, wi.shape)
    f_oi = np.asarray(bsdf.eval(there, wi), dtype=float) / np.abs(wi[:, 2:])
    f_io = np.asarray(bsdf.eval(wi, there), dtype=float) / abs(float(wo[2]))
    f_io = f_io / draw.eta[which, None] ** 2
    # Over the density of the samples: an integral over the sphere, not a mean over the peak.
    share = np.abs(wi[:, 2:]) / np.maximum(draw.pdf[which, None], 1e-300)
    whole = float(np.mean(np.maximum(f_oi, f_io) * share))
    if is_estimate(bsdf):
        return _beyond_noise(((f_oi - f_io) * share).mean(axis=1)) / max(whole, 1e-300)
    return float(np.mean(np.abs(f_oi - f_io) * share)) / whole if whole > 0 else 0.0


def _beyond_noise(differences: Floats) -> float:
    """Return how far a mean is from zero beyond four standard errors, or four largest terms.

    Too few terms say nothing.
    """
    n = len(differences)
    if n < FEWEST:
        return 0.0
    largest = float(np.abs(differences).max(initial=0.0))
    error = max(float(differences.std()) / math.sqrt(n), largest / n)
    return max(0.0, abs(float(differences.mean())) - 4 * error)


@dataclass(frozen=True)
class Finiteness:
    """Answers that are no numbers, or below zero, among the extreme questions asked."""

    asked: int
    bad: int
    example: str  # the first bad question, "" if there is none


def finiteness(bsdf: Scatterer, what: str) -> Finiteness:
    """Ask at grazing, behind, at the corners of the random numbers, and everywhere between."""
    rng = np.random.default_rng(11)
    cosines = [1.0, 0.5, 1e-2, 1e-4, 1e-6, 1e-20, 0.0, -1e-20, -1e-6, -1e-4, -0.5, -1.0]
    edges = np.array([direction(math.degrees(math.acos(c)), 1.0, p)
                      for c in cosines for p in (0.0, 1.0, math.pi)])  # fmt: skip
    edges[:, 2] = np.repeat(cosines, 3)
    corners = np.array([0.0, 1e-7, 0.5, 1 - 2.0**-24])
    u = np.stack(np.meshgrid(corners, corners, corners), axis=-1).reshape(-1, 3)
    u = np.concatenate([u, rng.random((64, 3))])
    wo = np.repeat(edges, len(u), axis=0)
    s = bsdf.sample(wo, np.tile(u, (len(edges), 1)))
    bad = [_bad_rows(part) for part in (s.wi, s.weight, s.pdf, s.eta)]
    bad[0] = ~np.isfinite(s.wi).all(axis=1)
    rows = np.any(bad, axis=0)
    o, i = np.repeat(edges, len(edges), axis=0), np.tile(edges, (len(edges), 1))
    lost = _bad_rows(bsdf.eval(o, i)) | _bad_rows(bsdf.pdf(o, i))
    example = ""
    if rows.any():
        example = f"sample({what}) for wo = {_shown(wo[int(np.argmax(rows))])}"
    elif lost.any():
        k = int(np.argmax(lost))
        example = f"eval or pdf({what}) for wo = {_shown(o[k])}, wi = {_shown(i[k])}"
    return Finiteness(len(rows) + len(lost), int(rows.sum() + lost.sum()), example)


def _bad_rows(values: Floats) -> Mask:
    array = np.asarray(values, dtype=float).reshape(len(values), -1)
    return np.asarray(~(np.isfinite(array) & (array >= 0)).all(axis=1))


def _shown(w: Floats) -> str:
    return "[" + ", ".join(f"{x:.3g}" for x in w) + "]"


@dataclass(frozen=True)
class FloatGap:
    """How far single precision is from double, as shares of the energy scattered."""

    eval: float  # mean |eval_float - eval_double|, at the same float directions
    sample: float  # |mean weight_float - mean weight_double|, for the same random numbers


def float_gap(single: Scatterer, double: Scatterer, wo: Floats, draw: Draw) -> FloatGap:
    """Compare the two precisions where the lobes are; `draw` is of `double`."""
    rounded = wo.astype(np.float32).astype(float)
    which = np.flatnonzero(draw.dull)[:PAIRS]
    wi = draw.wi[which].astype(np.float32).astype(float)
    share = 1 / np.maximum(draw.pdf[which], 1e-300)[:, None]
    a = np.asarray(single.eval(rounded, wi), dtype=float) * share
    b = np.asarray(double.eval(rounded, wi), dtype=float) * share
    estimate = is_estimate(double)
    eval_gap = 0.0
    if len(wi):
        gap = _beyond_noise((a - b).mean(axis=1)) if estimate else float(np.mean(np.abs(a - b)))
        eval_gap = gap / max(float(np.mean(b)), 1e-30)
    u = draw.u[: 2 * PAIRS].astype(np.float32)
    u = np.minimum(u, np.float32(1 - 2.0**-24)).astype(float)
    energies = [_energy(b.sample(rounded, u)) for b in (single, double)]
    change = energies[0] - energies[1]
    gap = _beyond_noise(change) if estimate else abs(float(change.mean()))
    return FloatGap(eval_gap, gap / max(float(energies[1].mean()), 1e-30))


def _energy(s: Draw) -> Floats:
    weight = np.asarray(s.weight, dtype=float).mean(axis=1)
    factor = np.where((np.asarray(s.lobe) & 16) != 0, np.asarray(s.eta, dtype=float) ** 2, 1.0)
    return np.asarray(weight * factor)
