"""Plots of a report: the furnace by angle, and the lobes in the plane of incidence."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from matiere.canvas import Canvas, Point
from matiere.plot import COLOURS
from matiere.stability.charts import Floats
from matiere.stability.measures import AZIMUTH, direction
from matiere.stability.views import Draw, Scatterer

if TYPE_CHECKING:
    from matiere.stability.report import Report

LEFT, RIGHT, TOP, BOTTOM = 64, 24, 52, 52
WIDTH, HEIGHT = 620, 400
CHANNELS = ("#d62728", "#2c8a2c", "#1f4fd8")  # R, G, B where they differ
VIEWERS = (0.0, 30.0, 60.0, 85.0)
DECADES = 3
RADIUS = 215.0
GRID, AXIS = "#d8d8d8", "#444444"


def draw_plots(report: Report) -> dict[str, Canvas]:
    """Return the pages "albedo" and "polar" of a report on a real material."""
    from matiere.probe import bsdf

    plots = {"albedo": albedo_plot(report)} if report.furnace else {}
    double = bsdf(report.material, precision="double", asset_root=report.asset_root)
    return {**plots, "polar": polar_plot(double, report)}


def save_plots(report: Report, folder: Path) -> list[Path]:
    """Write every page as SVG and PNG; return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for name, canvas in draw_plots(report).items():
        for suffix in ("svg", "png"):
            canvas.save(folder / f"{name}.{suffix}")
            files.append(folder / f"{name}.{suffix}")
    return files


def title_of(material: Any) -> str:
    """Return type and parameters on one line that fits a page."""
    words = [f"{k} {_short(v)}" for k, v in material.items() if k != "type"]
    text = f"{material.get('type', '')}: {', '.join(words)}" if words else str(material["type"])
    return text if len(text) <= 76 else text[:75] + "…"


def _short(value: Any) -> str:
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_short(v) for v in value) + "]"
    if isinstance(value, dict):
        return str(value.get("type", "..."))
    return f"{value:g}" if isinstance(value, float) else str(value)


# -- the furnace ----------------------------------------------------------------------------------
def albedo_plot(report: Report) -> Canvas:
    """Return the page of albedo against the angle of view."""
    curves = _furnace_curves(report)
    page = Canvas(WIDTH, HEIGHT + 16 * (len(curves) + 1))
    top = max([1.0, *(max(row["albedo"]) for row in report.furnace)])
    ceiling = max(1.1, math.ceil(top * 11) / 10)

    def at(degrees: float, value: float) -> Point:
        x = LEFT + (WIDTH - LEFT - RIGHT) * degrees / 90
        return x, HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * value / ceiling

    _grid(page, at, ceiling)
    page.text((WIDTH / 2, 22), title_of(report.material), size=14)
    page.text((LEFT - 40, 42), "furnace albedo (share of the light scattered on)", "start")
    page.text((WIDTH / 2, HEIGHT - 14), "angle of view / degrees from the normal")
    page.line([at(0, 1), at(90, 1)], "#000000", 1.2, (6, 4))
    page.text(
        (at(1, 1)[0], at(0, 1)[1] - 5), "1: nothing is lost; above, energy is gained", "start"
    )
    for k, curve in enumerate(curves):
        page.line([at(*point) for point in curve.sampled], curve.color, 2, curve.dash)
        for point in curve.integrated:
            page.dot(at(*point), curve.color, 3)
        y = HEIGHT + 8 + 16 * k
        page.line([(LEFT, y - 4), (LEFT + 24, y - 4)], curve.color, 2, curve.dash)
        page.text((LEFT + 32, y), curve.name, "start")
    return page


def _grid(page: Canvas, at: Any, ceiling: float) -> None:
    for degrees in range(0, 91, 15):
        page.line([at(degrees, 0), at(degrees, ceiling)], GRID)
        page.text((at(degrees, 0)[0], HEIGHT - BOTTOM + 18), str(degrees))
    step = 0.2 if ceiling < 2.5 else 10 ** math.ceil(math.log10(ceiling / 8))
    for k in range(int(ceiling / step + 1e-9) + 1):
        page.line([at(0, k * step), at(90, k * step)], GRID)
        page.text((LEFT - 8, at(0, k * step)[1] + 4), f"{k * step:g}", "end")
    page.line([at(0, ceiling), at(0, 0), at(90, 0), at(90, ceiling), at(0, ceiling)], AXIS)


@dataclass(frozen=True)
class _Curve:
    """Albedo of one side and channel: (degrees, albedo) by sampling and by quadrature."""

    name: str
    color: str
    dash: tuple[float, float] | None
    sampled: list[Point]
    integrated: list[Point]


def _furnace_curves(report: Report) -> list[_Curve]:
    curves: list[_Curve] = []
    for side, word, dash in ((1.0, "from outside", None), (-1.0, "from inside", (5.0, 4.0))):
        rows = [row for row in report.furnace if row["side"] == side]
        views = [row for row in report.views if row["side"] == side]
        if not rows:
            continue
        grey = max(max(row["albedo"]) - min(row["albedo"]) for row in rows) < 1e-3
        for c in range(1 if grey else 3):
            color = COLOURS[0 if side > 0 else 1] if grey else CHANNELS[c]
            name = f"{word}{'' if grey else ', ' + ('red', 'green', 'blue')[c]}"
            sampled = [(row["degrees"], row["albedo"][c]) for row in rows]
            integrated = [(row["degrees"], row["albedo"][c]) for row in views]
            name += " (line: by sampling, dots: by quadrature)" if not curves else ""
            curves.append(_Curve(name, color, dash, sampled, integrated))
    return curves


# -- the lobes ------------------------------------------------------------------------------------
def polar_plot(bsdf: Scatterer, report: Report) -> Canvas:
    """Return the page of f |cos theta_i| in the plane of incidence, three decades deep."""
    looks = [_slice(bsdf, degrees) for degrees in VIEWERS]
    whole = any(look.below for look in looks)
    height = TOP + RADIUS * (2 if whole else 1) + 80 + 16 * len(VIEWERS)
    page = Canvas(WIDTH, round(height))
    center = (WIDTH / 2, TOP + 26 + RADIUS)
    page.text((WIDTH / 2, 22), title_of(report.material), size=14)
    what = f"each lobe over its own peak, log scale, {DECADES} decades"
    page.text((WIDTH / 2, 40), f"f |cos theta_i| in the plane of incidence: {what}")
    _rings(page, center, whole)
    top = center[1] + (RADIUS if whole else 0) + 36
    for k, (look, color) in enumerate(zip(looks, COLOURS, strict=False)):
        look.draw(page, center, color)
        y = top + 16 * k
        page.line([(LEFT, y - 4), (LEFT + 24, y - 4)], color, 2)
        page.text((LEFT + 32, y), look.words(), "start")
    return page


def _rings(page: Canvas, center: Point, whole: bool) -> None:
    end = 180 if whole else 90
    for decade in range(DECADES):
        share = 1 - decade / DECADES
        angles = np.radians(np.linspace(-end, end, 181))
        page.line([_polar(center, a, share) for a in angles], GRID)
        word = "peak" if decade == 0 else f"1/{10**decade}"
        x, y = _polar(center, math.radians(-90), share)
        page.text((x + 4, y + 12), word, "start", size=10)
    for degrees in range(-end, end + 1, 30):
        angle = math.radians(degrees)
        page.line([center, _polar(center, angle, 1)], GRID)
        x, y = _polar(center, angle, 1.09)
        if abs(degrees) not in (90,) and degrees != -180:
            page.text((x, y + 4), f"{abs(degrees)}", size=10)
    page.line([_polar(center, math.radians(a), 1) for a in (-90, 90)], AXIS, 1.5)


def _polar(center: Point, angle: float, share: float) -> Point:
    """Angles are from the normal, positive away from the viewer (to the right)."""
    return (
        center[0] + RADIUS * share * math.sin(angle),
        center[1] - RADIUS * share * math.cos(angle),
    )


class _Slice:
    """The lobes of one viewer in the plane of incidence."""

    def __init__(self, degrees: float, angles: Floats, values: Floats, draw: Draw) -> None:
        self.degrees, self.angles, self.values = degrees, angles, values
        sharp = draw.sharp
        self.deltas: list[tuple[float, float]] = []  # angle, share of the energy
        for lobe in np.unique(draw.lobe[sharp]):
            mine = draw.lobe == lobe
            angle = float(_angle(draw.wi[mine][:1])[0])
            self.deltas.append((angle, float(draw.energy[mine].mean(axis=1).sum()) / draw.n))
        self.below = bool((draw.wi[draw.lobe != 0][:, 2] < 0).any())

    def draw(self, page: Canvas, center: Point, color: str) -> None:
        """Draw the viewer's mark, the lobes and the delta lobes."""
        viewer = math.radians(-self.degrees)
        page.line([_polar(center, viewer, 1.0), _polar(center, viewer, 1.035)], color, 4)
        peak = float(self.values.max(initial=0.0))
        if peak > 0:
            with np.errstate(divide="ignore"):
                share = np.maximum(0, 1 + np.log10(self.values / peak) / DECADES)
            points = [_polar(center, a, r) for a, r in zip(self.angles, share, strict=True)]
            page.line(points, color, 1.6)
        for angle, _ in self.deltas:
            page.line([center, _polar(center, angle, 1.0)], color, 2, (3, 4))
            page.dot(_polar(center, angle, 1.0), color, 4)

    def words(self) -> str:
        """Return the line of the legend."""
        peak = float(self.values.max(initial=0.0))
        parts = [f"viewer at {self.degrees:g} degrees"]
        if peak > 0:
            parts.append(f"peak {peak:.3g} / sr")
        for angle, share in self.deltas:
            where = "reflected" if abs(angle) < math.pi / 2 else "transmitted"
            parts.append(f"delta {where} {100 * share:.3g} % at {math.degrees(abs(angle)):.4g}")
        return ", ".join(parts)


def _slice(bsdf: Scatterer, degrees: float) -> _Slice:
    wo = direction(degrees)
    draw = Draw(bsdf, wo, 4000, 3)
    dull = draw.wi[draw.dull]
    angles = np.linspace(-math.pi, math.pi, 1441)
    if len(dull):
        angles = np.sort(np.concatenate([angles, _spread(_angle(dull))]))
    away = np.array([math.cos(AZIMUTH), math.sin(AZIMUTH), 0.0])
    wi = -np.sin(angles)[:, None] * away
    wi[:, 2] = np.cos(angles)
    values = np.asarray(bsdf.eval(wo, wi), dtype=float).mean(axis=1)
    return _Slice(degrees, angles, values, draw)


def _angle(wi: Floats) -> Floats:
    """Return the signed angle from the normal of directions, in the plane of incidence."""
    along = -(wi[:, 0] * math.cos(AZIMUTH) + wi[:, 1] * math.sin(AZIMUTH))
    return np.asarray(np.arctan2(along, wi[:, 2]))


def _spread(angles: Floats) -> Floats:
    """Return angles dense where samples are, and a little beyond on every scale."""
    inner = np.quantile(angles, np.linspace(0, 1, 600))
    middle = [float(np.median(part)) for part in _sides(angles)]
    steps = np.concatenate([-np.geomspace(1e-7, 1, 120), np.geomspace(1e-7, 1, 120)])
    outer = [m + steps for m in middle]
    every = np.concatenate([inner, *outer])
    return np.asarray(every[np.abs(every) <= math.pi])


def _sides(angles: Floats) -> Sequence[Floats]:
    upper = np.abs(angles) < math.pi / 2
    return [part for part in (angles[upper], angles[~upper]) if len(part)]
