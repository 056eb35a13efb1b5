"""The stability report of a material: measured, judged, and told as text, JSON and plots."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import isnan
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from matiere.stability import findings, measures
from matiere.stability.charts import Floats
from matiere.stability.estimates import is_estimate, look_at_estimate
from matiere.stability.findings import FAIL, PASS, WARN, Finding, Look
from matiere.stability.limits import find_limits, has_delta
from matiere.stability.measures import Viewer, direction
from matiere.stability.statistics import sidak
from matiere.stability.views import TRANSMISSION, Draw, Effort, Scatterer, View, look

VERSION = 1
EFFORT = Effort(samples=16_000, tolerance=1e-5, budget=150_000)
DEGREES = (0.0, 30.0, 60.0, 75.0, 85.0, 89.9)
CURVE_DEGREES = (*(float(d) for d in range(0, 86, 5)), 87.0, 89.0, 89.9)
CURVE_SAMPLES = 4096
CONFIRMED = 3  # views of the furnace that are measured again by quadrature
ORDER = {PASS: 0, WARN: 1, FAIL: 2}

Curve = list[tuple[Viewer, list[float]]]


@dataclass(frozen=True)
class Report:
    """How stable a material is at its exact parameters; `str(report)` is the table.

    Attributes:
        material: the description that was checked.
        verdict: "pass", "warn" or "fail": the worst of the findings.
        reason: why, in words.
        findings: one `Finding` per question.
        limits: parameters treated as limits, rows `{pointer, value, limit, text}`.
        views: what was measured from each viewer, rows of numbers.
        furnace: albedo by angle, rows `{degrees, side, albedo: [r, g, b]}`.
        seconds: how long the check took.
        asset_root: folder of the files that the material names; for the plots.
    """

    material: Mapping[str, Any]
    verdict: str
    reason: str
    findings: tuple[Finding, ...]
    limits: tuple[Mapping[str, Any], ...]
    views: tuple[Mapping[str, Any], ...]
    furnace: tuple[Mapping[str, Any], ...]
    seconds: float
    asset_root: str | PathLike[str] = "."

    def as_dict(self) -> dict[str, Any]:
        """Return the report as JSON holds it; `version` counts changes of the format."""
        return {
            "version": VERSION,
            "material": dict(self.material),
            "verdict": self.verdict,
            "reason": self.reason,
            "findings": [finding.as_dict() for finding in self.findings],
            "limits": [dict(row) for row in self.limits],
            "views": [dict(row) for row in self.views],
            "furnace": [dict(row) for row in self.furnace],
            "seconds": self.seconds,
        }

    def __str__(self) -> str:
        """Return the report as a table for people."""
        lines = [f"{self.verdict}: {self.reason}", ""]
        lines += [f"  {f.verdict:4}  {f.name:21}  {f.text}" for f in self.findings]
        if self.limits:
            lines += ["", "  limits"]
            lines += [f"        {row['pointer']:20}  {row['text']}" for row in self.limits]
        return "\n".join(lines)

    def plots(self) -> dict[str, str]:
        """Return the plots as SVG: "albedo" (furnace by angle) and "polar" (the lobes)."""
        from matiere.stability.draw import draw_plots

        return {name: canvas.svg() for name, canvas in draw_plots(self).items()}

    def save_plots(self, folder: str | Path) -> list[Path]:
        """Write albedo and polar plots into a folder (made if absent), as SVG and PNG."""
        from matiere.stability.draw import save_plots

        return save_plots(self, Path(folder))


@dataclass(frozen=True)
class Promises:
    """What a model promises, from its row of `materials()`."""

    reciprocal: bool = True
    two_sides: bool = False  # light may come from either side


def check_material(
    description: Mapping[str, Any], *, seed: int = 1, asset_root: str | PathLike[str] = "."
) -> Report:
    """Check a material given as in scene JSON; see `matiere.check`."""
    from matiere.probe import bsdf

    started = time.perf_counter()
    make = partial(bsdf, asset_root=asset_root)
    double, single = (make(description, precision=p) for p in ("double", "float"))
    promises = Promises(double.reciprocal, bool(double.lobes & TRANSMISSION))
    limits = find_limits(description, double.params, double, make)
    report = check_bsdf(
        double, single, promises, seed=seed, material=description, limits=limits, started=started
    )
    return replace(report, asset_root=asset_root)


def check_bsdf(
    double: Scatterer,
    single: Scatterer,
    promises: Promises,
    *,
    seed: int = 1,
    material: Mapping[str, Any] | None = None,
    limits: Sequence[Mapping[str, Any]] = (),
    started: float | None = None,
) -> Report:
    """Check anything that answers as `matiere.Bsdf` does, given in double and in float."""
    started = time.perf_counter() if started is None else started
    sides = (1.0, -1.0) if promises.two_sides else (1.0,)
    finite = [measures.finiteness(b, w) for b, w in ((double, "double"), (single, "float"))]
    if any(f.bad for f in finite):  # nothing can be measured with NaN
        return _assemble(material or {}, [findings.finite(finite)], limits, [], [], started)
    viewers = [(d, side) for d in DEGREES for side in sides]
    looks, one_index = _looks(double, single, viewers, seed)
    curve = _curve(single, [(d, side) for d in CURVE_DEGREES for side in sides])
    # A walk that ends on a delta counts as delta; from its other end it does not.
    reciprocal = promises.reciprocal and not (is_estimate(double) and has_delta(double))
    found = [
        findings.energy(looks, _brightest(double, curve, seed)),
        *_sampling(looks, is_estimate(double)),
        findings.reciprocal(looks, reciprocal, one_index),
        findings.largest_weight(looks),
        findings.finite(finite),
        findings.precision(looks),
    ]
    return _assemble(material or {}, found, limits, looks, curve, started)


def _sampling(looks: Sequence[Look], estimate: bool) -> list[Finding]:
    if estimate:
        return [findings.expectation(looks), findings.sampling(looks)]
    return [
        findings.pdf_integral(looks),
        findings.chi_square(looks),
        findings.sampling(looks),
        findings.weights(looks),
    ]


def _looks(
    double: Scatterer, single: Scatterer, viewers: Sequence[Viewer], seed: int
) -> tuple[list[Look], bool]:
    level = sidak(findings.LEVEL, len(viewers))
    looks, one_index = [], True
    for viewer in viewers:
        wo = direction(*viewer)
        view = again = see(double, wo, seed, single)
        if min(view.p_value, view.p_value_float) < level:
            again = see(double, wo, seed + 1, single)
        draw = Draw(double, wo, 2 * measures.PAIRS, seed + 2)
        one_index &= draw.one_index
        residual = measures.reciprocity(double, wo, draw)
        gap = measures.float_gap(single, double, wo, draw)
        looks.append(Look(viewer, view, again, residual, gap))
    return looks, one_index


def _curve(bsdf: Any, viewers: Sequence[Viewer]) -> Curve:
    wo = np.array([direction(*viewer) for viewer in viewers])
    albedo = np.asarray(bsdf.albedo(wo, n=CURVE_SAMPLES), dtype=float)
    return [(viewer, [float(x) for x in rgb]) for viewer, rgb in zip(viewers, albedo, strict=True)]


def _brightest(double: Scatterer, curve: Curve, seed: int) -> list[tuple[Viewer, float]]:
    """Return the furnace's values; the largest above 1, which may be noise, by quadrature."""
    values = [(viewer, max(rgb)) for viewer, rgb in curve]
    calm = [row for row in values if row[1] <= 1 + findings.GAIN]
    suspects = sorted((row[1], row[0]) for row in values if row[1] > 1 + findings.GAIN)
    for _, viewer in suspects[-CONFIRMED:]:
        view = see(double, direction(*viewer), seed)
        calm.append((viewer, float(view.albedo.max()) - view.uncertain))
    return calm


def _assemble(
    material: Mapping[str, Any],
    found: Sequence[Finding],
    limits: Sequence[Mapping[str, Any]],
    looks: Sequence[Look],
    curve: Curve,
    started: float,
) -> Report:
    verdict = max((f.verdict for f in found), key=ORDER.__getitem__)
    reasons = [f.text for f in found if f.verdict == verdict]
    reason = "; ".join(reasons) if verdict != PASS else "nothing wrong was found"
    return Report(
        material=material,
        verdict=verdict,
        reason=reason,
        findings=tuple(found),
        limits=tuple(limits),
        views=tuple(_row(each) for each in looks),
        furnace=tuple(
            {"degrees": degrees, "side": side, "albedo": rgb} for (degrees, side), rgb in curve
        ),
        seconds=round(time.perf_counter() - started, 3),
    )


def see(bsdf: Scatterer, wo: Floats, seed: int, single: Scatterer | None = None) -> View:
    """Measure one view, of an estimate by its expectations."""
    if is_estimate(bsdf):
        return look_at_estimate(bsdf, wo, seed, EFFORT)
    return look(bsdf, wo, seed, EFFORT, single)


def _row(each: Look) -> dict[str, Any]:
    view = each.view
    row = {
        "degrees": each.viewer[0],
        "side": each.viewer[1],
        "albedo": [float(x) for x in view.albedo],
        "albedo_sampled": [float(x) for x in view.albedo_sampled],
        "albedo_error": [float(x) for x in view.albedo_error],
        "chi_square_p": view.p_value,
        "chi_square_p_float": view.p_value_float,
        "pdf_integral": view.integral,
        "rejected": view.rejected,
        "delta": view.delta,
        "uncertain": view.uncertain,
        "weight_gap": view.weight_gap,
        "weight_gap_worst": view.weight_gap_worst,
        "largest_weight": view.largest_weight,
        "reciprocity_gap": each.reciprocity,
        "float_gap": each.float_gap.eval,
        "float_loss": each.float_gap.sample,
    }
    unknown = [key for key, value in row.items() if isinstance(value, float) and isnan(value)]
    return row | dict.fromkeys(unknown)
