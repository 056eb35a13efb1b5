"""A page of lines and words that can be written as SVG or drawn into pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matiere.drawtext import TextMark

Point = tuple[float, float]
FINEST = 0.4  # points of a line nearer than this are one [pixels]


@dataclass(frozen=True)
class Stroke:
    """A line through points; `dash` alternates lengths of line and gap (pixels)."""

    points: tuple[Point, ...]
    color: str
    width: float = 1.0
    dash: tuple[float, float] | None = None


@dataclass(frozen=True)
class Area:
    """A filled outline."""

    points: tuple[Point, ...]
    color: str
    opacity: float = 1.0


@dataclass(frozen=True)
class Label:
    """A line of text; `at` is the start, middle or end of its baseline; `turned` reads upwards."""

    at: Point
    text: str
    anchor: str = "middle"
    size: int = 12
    color: str = "#000000"
    turned: bool = False


@dataclass
class Canvas:
    """A white page, width x height pixels, y down. Colours are "#rrggbb"."""

    width: int
    height: int
    strokes: list[Stroke | Area] = field(default_factory=list)
    labels: list[Label] = field(default_factory=list)

    def line(
        self,
        points: Sequence[Point],
        color: str,
        width: float = 1.0,
        dash: tuple[float, float] | None = None,
    ) -> None:
        """Draw a line through points."""
        kept = list(points[:1])
        for x, y in points[1:-1]:
            if abs(x - kept[-1][0]) + abs(y - kept[-1][1]) > FINEST:
                kept.append((x, y))
        self.strokes.append(Stroke((*kept, *points[-1:]), color, width, dash))

    def dot(self, at: Point, color: str, radius: float = 2.5) -> None:
        """Draw a filled circle."""
        self.strokes.append(Stroke((at, at), color, 2 * radius))

    def area(self, points: Sequence[Point], color: str, opacity: float = 1.0) -> None:
        """Fill the outline through points."""
        self.strokes.append(Area(tuple(points), color, opacity))

    def text(
        self,
        at: Point,
        text: str,
        anchor: str = "middle",
        size: int = 12,
        color: str = "#000000",
        turned: bool = False,
    ) -> None:
        """Write a line of text; `anchor` is "start", "middle" or "end"; `turned` reads upwards."""
        self.labels.append(Label(at, text, anchor, size, color, turned))

    # -- SVG ------------------------------------------------------------------------------------
    def svg(self) -> str:
        """Return the page as an SVG document."""
        body = "\n".join([*map(_svg_shape, self.strokes), *map(_svg_label, self.labels)])
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width} {self.height}"'
            f' width="{self.width}" height="{self.height}" font-family="sans-serif">\n'
            f'<rect width="{self.width}" height="{self.height}" fill="white"/>\n{body}\n</svg>\n'
        )

    # -- pixels ---------------------------------------------------------------------------------
    def pixels(self, scale: float = 2.0) -> NDArray[np.float32]:
        """Return the page as display-encoded RGB, (height * scale, width * scale, 3)."""
        from matiere.drawtext import draw_text

        shape = (round(self.height * scale), round(self.width * scale), 3)
        page = np.ones(shape, dtype=np.float32)
        for stroke in self.strokes:
            if isinstance(stroke, Area):
                _fill(page, stroke, scale)
            else:
                _paint(page, stroke, scale)
        for turned in (True, False):
            page = np.ascontiguousarray(np.rot90(page, -1) if turned else page)
            page = draw_text(page, self._marks(turned, scale))
            page = np.ascontiguousarray(np.rot90(page) if turned else page)
        return page

    def _marks(self, turned: bool, scale: float) -> list[TextMark]:
        """Return the lines that are turned, or the others; turned ones on a page turned back."""
        from matiere.drawtext import TextMark, text_width

        marks = []
        for label in self.labels:
            if label.turned != turned:
                continue
            x, y = label.at if not turned else (self.height - label.at[1], label.at[0])
            size = round(label.size * scale)
            shift = {"start": 0.0, "middle": 0.5, "end": 1.0}[label.anchor]
            spot = (round(x * scale - shift * text_width(label.text, size)), round(y * scale))
            marks.append(TextMark(spot, label.text, size, _rgb(label.color)))
        return marks

    def save(self, path: Path) -> None:
        """Write .svg or .png, whole or not at all."""
        from matiere.imageio import atomic_file, write_image

        if path.suffix == ".svg":
            with atomic_file(path) as temporary:
                temporary.write_text(self.svg(), encoding="utf-8")
        else:
            write_image(path, self.pixels())


def _svg_shape(s: Stroke | Area) -> str:
    if isinstance(s, Area):
        path = "M" + " L".join(f"{x:.1f} {y:.1f}" for x, y in s.points)
        return f'<path d="{path} Z" fill="{s.color}" fill-opacity="{s.opacity:g}"/>'
    if len(s.points) == 2 and s.points[0] == s.points[1]:
        (x, y), _ = s.points
        return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{s.width / 2:g}" fill="{s.color}"/>'
    dash = f' stroke-dasharray="{s.dash[0]:g} {s.dash[1]:g}"' if s.dash else ""
    path = "M" + " L".join(f"{x:.1f} {y:.1f}" for x, y in s.points)
    return (
        f'<path d="{path}" fill="none" stroke="{s.color}" stroke-width="{s.width:g}"'
        f' stroke-linecap="round" stroke-linejoin="round"{dash}/>'
    )


def _svg_label(label: Label) -> str:
    x, y = label.at
    place = f'x="{x:.1f}" y="{y:.1f}"'
    if label.turned:
        place = f'transform="translate({x:.1f} {y:.1f}) rotate(-90)"'
    return (
        f'<text {place} text-anchor="{label.anchor}" font-size="{label.size}"'
        f' fill="{label.color}">{escape(label.text)}</text>'
    )


def _rgb(color: str) -> tuple[float, float, float]:
    r, g, b = (int(color[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return r, g, b


def _paint(page: NDArray[np.float32], stroke: Stroke, scale: float) -> None:
    """Blend one stroke, its edges smooth over a pixel."""
    points = np.array(stroke.points, dtype=float) * scale
    segments = list(pairwise(points))
    if stroke.dash:
        segments = _dashes(segments, stroke.dash[0] * scale, stroke.dash[1] * scale)
    if not segments:
        return
    half = stroke.width * scale / 2
    cover = np.zeros(page.shape[:2], dtype=np.float32)
    for a, b in segments:
        low = np.floor(np.minimum(a, b) - half - 1).astype(int)
        high = np.ceil(np.maximum(a, b) + half + 1).astype(int)
        x0, y0 = np.maximum(low, 0)
        x1, y1 = np.minimum(high, (page.shape[1], page.shape[0]))
        if x0 >= x1 or y0 >= y1:
            continue
        grid = np.stack(np.meshgrid(np.arange(x0, x1) + 0.5, np.arange(y0, y1) + 0.5), axis=-1)
        along = b - a
        t = np.clip((grid - a) @ along / max(float(along @ along), 1e-12), 0, 1)
        distance = np.linalg.norm(grid - a - t[..., None] * along, axis=-1)
        part = cover[y0:y1, x0:x1]
        np.maximum(part, np.clip(half + 0.5 - distance, 0, 1), out=part)
    color = np.array(_rgb(stroke.color), dtype=np.float32)
    page += cover[..., None] * (color - page)


def _fill(page: NDArray[np.float32], area: Area, scale: float) -> None:
    """Blend an area: even-odd rule, 2 x 2 samples a pixel."""
    points = np.array(area.points, dtype=float) * scale
    cover = np.zeros(page.shape[:2], dtype=np.float32)
    for dy in (0.25, 0.75):
        for dx in (0.25, 0.75):
            cover += 0.25 * _inside(points, cover.shape, dx, dy)
    color = np.array(_rgb(area.color), dtype=np.float32)
    page += area.opacity * cover[..., None] * (color - page)


def _inside(
    points: NDArray[np.float64], shape: tuple[int, ...], dx: float, dy: float
) -> NDArray[np.bool_]:
    x, y = np.arange(shape[1]) + dx, np.arange(shape[0]) + dy
    odd = np.zeros(shape, dtype=bool)
    for (ax, ay), (bx, by) in pairwise([*points, points[0]]):
        rows = np.flatnonzero((ay <= y) != (by <= y))
        crossing = ax + (y[rows] - ay) * (bx - ax) / (by - ay if by != ay else 1.0)
        odd[rows] ^= x[None, :] < crossing[:, None]
    return odd


def _dashes(
    segments: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]], on: float, off: float
) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    found, run = [], 0.0
    for a, b in segments:
        length = float(np.linalg.norm(b - a))
        at = 0.0
        while at < length:
            phase = (run + at) % (on + off)
            step = min((on if phase < on else on + off) - phase, length - at)
            step = max(step, 1e-3)
            if phase < on:
                found.append((a + (b - a) * (at / length), a + (b - a) * ((at + step) / length)))
            at += step
        run += length
    return found
