"""Error against run time as an SVG: log-log axes with units, one curve with its 95 % band per film.

    from matiere.plot import error_plot
    Path("error.svg").write_text(error_plot([("gold", film.report["log"])]))

Written by hand so that a report costs no plotting library.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

Log = Sequence[Mapping[str, Any]]
Curve = tuple[str, Log]

# Okabe and Ito 2008: eight colours told apart by colour-blind readers too.
COLOURS = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f00", "#000000",
)  # fmt: skip
WIDTH, HEIGHT = 760, 480
LEFT, RIGHT, TOP, BOTTOM = 82, 24, 48, 62
MAX_LEGEND = 16
MAX_BANDS = 8  # beyond that the bands hide each other


@dataclass(frozen=True)
class _Axis:
    """A logarithmic axis from `low` to `high` onto pixels `start` to `end`."""

    low: float
    high: float
    start: float
    end: float

    def at(self, value: float) -> float:
        share = math.log(value / self.low) / math.log(self.high / self.low)
        return self.start + share * (self.end - self.start)

    def ticks(self) -> list[tuple[float, bool]]:
        """Return (value, labelled): 1, 2, 5 on short axes, decades on long ones."""
        decades = math.log10(self.high / self.low)
        labelled = (1, 2, 5) if decades <= 2.5 else (1,)
        found = []
        for exponent in range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high))):
            for digit in range(1, 10):
                value = digit * 10.0**exponent
                if self.low <= value <= self.high * (1 + 1e-12):
                    found.append((value, digit in labelled))
        top = 10.0 ** math.ceil(math.log10(self.high))
        if top <= self.high * (1 + 1e-12):
            found.append((top, True))
        return found


def error_plot(curves: Iterable[Curve], title: str = "error against run time") -> str:
    """Return the SVG of relMSE against wall seconds; looks without a known error are left out.

    Bands are the 95 % prediction intervals; the dashed line falls as 1 / time, as independent
    samples do. Raises ValueError if no look has a known error.
    """
    known = [(name, _points(log)) for name, log in curves]
    known = [(name, points) for name, points in known if points]
    if not known:
        raise ValueError("no look at the error is known, there is nothing to plot")
    points = [point for _, some in known for point in some]
    bands = len(known) <= MAX_BANDS
    x = _axis([p[0] for p in points], LEFT, WIDTH - RIGHT)
    errors = [v for p in points for v in (p[1:] if bands else p[1:2])]
    y = _axis(errors, HEIGHT - BOTTOM, TOP)
    parts = [*_frame(x, y, title, bands), _slope(x, y, points)]
    for index, (_, some) in enumerate(known):
        parts += _curve(x, y, some, COLOURS[index % len(COLOURS)], bands)
    parts += _legend([name for name, _ in known])
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" '
        f'height="{HEIGHT}" font-family="sans-serif" font-size="12">\n'
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>\n{body}\n</svg>\n'
    )


def write_error_plot(
    path: str | os.PathLike[str], curves: Iterable[Curve], title: str = "error against run time"
) -> None:
    """Write the plot as an SVG file, whole or not at all."""
    from matiere.imageio import atomic_file

    text = error_plot(curves, title)
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _points(log: Log) -> list[tuple[float, float, float, float]]:
    """(seconds, relMSE, lower, upper) of the looks where all is known and positive."""
    keys = ("wall_s", "relmse", "lower", "upper")
    rows = [[row.get(key) or 0.0 for key in keys] for row in log]
    return sorted((r[0], r[1], r[2], r[3]) for r in rows if min(r) > 0)


def _axis(values: Sequence[float], start: float, end: float) -> _Axis:
    low, high = min(values), max(values)
    pad = max((high / low) ** 0.04, 1.02)
    if high / low < 3:  # a single look still gets readable ticks
        pad = max(pad, math.sqrt(3 * low / high))
    return _Axis(low / pad, high * pad, start, end)


def _frame(x: _Axis, y: _Axis, title: str, bands: bool) -> list[str]:
    parts = [_text(WIDTH / 2, 26, title, size=15)]
    for value, labelled in x.ticks():
        at = x.at(value)
        parts.append(_line(at, TOP, at, HEIGHT - BOTTOM, "#d0d0d0" if labelled else "#eeeeee"))
        if labelled:
            parts.append(_text(at, HEIGHT - BOTTOM + 18, _number(value)))
    for value, labelled in y.ticks():
        at = y.at(value)
        parts.append(_line(LEFT, at, WIDTH - RIGHT, at, "#d0d0d0" if labelled else "#eeeeee"))
        if labelled:
            parts.append(_text(LEFT - 8, at + 4, _number(value), anchor="end"))
    width, height = WIDTH - RIGHT - LEFT, HEIGHT - BOTTOM - TOP
    parts.append(
        f'<rect x="{LEFT}" y="{TOP}" width="{width}" height="{height}" fill="none" stroke="#444"/>'
    )
    parts.append(_text(LEFT + width / 2, HEIGHT - 18, "render time / s (wall clock)", size=13))
    label = "estimated relMSE" + (" (band: 95 % prediction interval)" if bands else "")
    middle = TOP + height / 2
    parts.append(
        f'<text transform="translate(20 {middle:.1f}) rotate(-90)" text-anchor="middle" '
        f'font-size="13">{label}</text>'
    )
    return parts


def _curve(
    x: _Axis,
    y: _Axis,
    points: Sequence[tuple[float, float, float, float]],
    colour: str,
    band: bool,
) -> list[str]:
    parts = []
    if band and len(points) > 1:
        upper = [(x.at(t), y.at(high)) for t, _, _, high in points]
        lower = [(x.at(t), y.at(low)) for t, _, low, _ in reversed(points)]
        outline = _path([*upper, *lower])
        parts.append(f'<path d="{outline} Z" fill="{colour}" fill-opacity="0.18"/>')
    elif band:
        t, _, low, high = points[0]
        parts.append(_line(x.at(t), y.at(low), x.at(t), y.at(high), colour, 2))
    middle = [(x.at(t), y.at(error)) for t, error, _, _ in points]
    parts.append(f'<path d="{_path(middle)}" fill="none" stroke="{colour}" stroke-width="1.6"/>')
    parts += [f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2.6" fill="{colour}"/>' for a, b in middle]
    return parts


def _slope(x: _Axis, y: _Axis, points: Sequence[tuple[float, float, float, float]]) -> str:
    """A line of slope -1 through the geometric middle of all points, clipped to the frame."""
    n = len(points)
    t0 = math.exp(sum(math.log(p[0]) for p in points) / n)
    e0 = math.exp(sum(math.log(p[1]) for p in points) / n)
    start = max(x.low, t0 * e0 / y.high)
    end = min(x.high, t0 * e0 / y.low)
    if start >= end:
        return ""
    line = _path([(x.at(t), y.at(t0 * e0 / t)) for t in (start, end)])
    return f'<path d="{line}" fill="none" stroke="#888" stroke-dasharray="5 4"/>'


def _legend(names: Sequence[str]) -> list[str]:
    shown = [*names[:MAX_LEGEND]]
    entries = [(name, COLOURS[i % len(COLOURS)], "") for i, name in enumerate(shown)]
    if len(names) > MAX_LEGEND:
        entries.append((f"and {len(names) - MAX_LEGEND} more", "#ffffff", ""))
    entries.append(("1 / time", "#888", ' stroke-dasharray="5 4"'))
    width = 34 + 6.6 * max(len(name) for name, _, _ in entries)
    left, top = WIDTH - RIGHT - width - 6, TOP + 6
    parts = [
        f'<rect x="{left:.1f}" y="{top}" width="{width:.1f}" height="{16 * len(entries) + 8}" '
        'fill="white" fill-opacity="0.85" stroke="#ccc"/>'
    ]
    for row, (name, colour, dash) in enumerate(entries):
        at = top + 16 + 16 * row
        parts.append(
            f'<path d="M{left + 6:.1f} {at - 4} h18" stroke="{colour}" stroke-width="2"{dash}/>'
        )
        parts.append(_text(left + 29, at, name, anchor="start"))
    return parts


def _path(points: Sequence[tuple[float, float]]) -> str:
    return "M" + " L".join(f"{a:.1f} {b:.1f}" for a, b in points)


def _line(x0: float, y0: float, x1: float, y1: float, colour: str, width: float = 1) -> str:
    return (
        f'<path d="M{x0:.1f} {y0:.1f} L{x1:.1f} {y1:.1f}" stroke="{colour}" '
        f'stroke-width="{width:g}"/>'
    )


def _text(x: float, y: float, text: str, anchor: str = "middle", size: int = 12) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-size="{size}">'
        f"{escape(text)}</text>"
    )


def _number(value: float) -> str:
    """A tick label: plain near 1, a power of ten elsewhere."""
    if 1e-3 <= value < 1e4:
        return f"{value:.10g}"
    exponent = math.floor(math.log10(value) + 1e-9)
    digit = round(value / 10.0**exponent)
    power = "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return power if digit == 1 else f"{digit}·{power}"
