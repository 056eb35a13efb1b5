"""Error against render time as an inline SVG: log-log, with its interval, target and forecast.

Colours come from the style sheet (classes, no attributes), so the plot follows light and dark.
`matiere.plot` draws the same for files; this one is small, live, and needs no NumPy.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from markupsafe import Markup, escape

from matiere.service.page import words

WIDTH, HEIGHT = 560, 320
LEFT, RIGHT, TOP, BOTTOM = 70, 14, 14, 52
FEWEST_TICKS = 2


@dataclass(frozen=True)
class Look:
    """An estimate of the error at some render time."""

    seconds: float
    spp: int
    relmse: float
    lower: float
    upper: float


@dataclass(frozen=True)
class Forecast:
    """Where the target is expected to be met: render seconds in all, and the relMSE then."""

    seconds: float
    relmse: float


def looks_of(rows: Sequence[Mapping[str, Any]]) -> list[Look]:
    """Return the rows whose error is known, by time; `wall_s` or `seconds` tells the time."""
    found = []
    for row in rows:
        at = row.get("wall_s") or row.get("seconds") or 0.0
        values = [row.get(key) or 0.0 for key in ("relmse", "lower", "upper")]
        if at > 0 and min(values) > 0:
            found.append(Look(at, row["spp"], *values))
    return sorted(found, key=lambda look: look.seconds)


@dataclass(frozen=True)
class _Axis:
    low: float
    high: float
    start: float
    end: float

    def at(self, value: float) -> float:
        share = math.log(value / self.low) / math.log(self.high / self.low)
        return round(self.start + share * (self.end - self.start), 2)

    def ticks(self) -> list[float]:
        """Return values to label: decades, or 1, 2, 5 where there are few of these."""
        for digits in ((1,), (1, 3), (1, 2, 5), tuple(range(1, 10))):
            found = [
                digit * 10.0**exponent
                for exponent in range(math.floor(math.log10(self.low)), 40)
                if 10.0**exponent <= self.high
                for digit in digits
                if self.low <= digit * 10.0**exponent <= self.high
            ]
            if len(found) >= FEWEST_TICKS:
                return found
        return found


def error_plot(looks: Sequence[Look], target: float | None, forecast: Forecast | None) -> Markup:
    """Return the plot; `target` is a relMSE to draw as a line. Empty while no error is known."""
    if not looks:
        return Markup("")
    times = [look.seconds for look in looks] + ([forecast.seconds] if forecast else [])
    errors = [v for look in looks for v in (look.lower, look.upper)]
    errors += [target] if target else []
    errors += [forecast.relmse] if forecast else []
    x = _axis(times, LEFT, WIDTH - RIGHT)
    y = _axis(errors, HEIGHT - BOTTOM, TOP)
    last = looks[-1]
    text = (
        f"Error against render time: {len(looks)} estimates; the last is relMSE "
        f"{last.relmse:.3g}, between {last.lower:.3g} and {last.upper:.3g} with 95 % confidence, "
        f"after {words.seconds(last.seconds)}."
    )
    parts = [
        f'<svg class="plot" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" '
        f'role="img" aria-label="{escape(text)}">',
        *_frame(x, y),
        *_reference(x, y, last),
        *_curve(x, y, looks),
        *_target(x, y, last, target, forecast),
        "</svg>",
    ]
    return Markup("".join(parts))


def _axis(values: Sequence[float], start: float, end: float) -> _Axis:
    low, high = min(values), max(values)
    pad = max((high / low) ** 0.06, 1.05)
    if high / low < 3:
        pad = max(pad, math.sqrt(3 * low / high))
    return _Axis(low / pad, high * pad, start, end)


def _frame(x: _Axis, y: _Axis) -> Iterator[str]:
    bottom, right = HEIGHT - BOTTOM, WIDTH - RIGHT
    for value in x.ticks():
        at = x.at(value)
        yield f'<path class="grid" d="M{at} {TOP}V{bottom}"/>'
        yield f'<text class="tick" x="{at}" y="{bottom + 19}" text-anchor="middle">'
        yield f"{_tick(value)}</text>"
    for value in y.ticks():
        at = y.at(value)
        yield f'<path class="grid" d="M{LEFT} {at}H{right}"/>'
        yield f'<text class="tick" x="{LEFT - 8}" y="{at + 4}" text-anchor="end">'
        yield f"{_tick(value)}</text>"
    yield f'<path class="axis" d="M{LEFT} {TOP}V{bottom}H{right}"/>'
    yield f'<text class="name" x="{(LEFT + right) / 2}" y="{HEIGHT - 8}" text-anchor="middle">'
    yield "render time / s</text>"
    middle = (TOP + bottom) / 2
    yield f'<text class="name" x="14" y="{middle}" text-anchor="middle" '
    yield f'transform="rotate(-90 14 {middle})">relMSE</text>'


def _reference(x: _Axis, y: _Axis, last: Look) -> Iterator[str]:
    """A dashed line that falls as 1 / time, as the error of independent samples does."""
    product = last.seconds * last.relmse
    start, end = max(x.low, product / y.high), min(x.high, product / y.low)
    if start < end:
        a, b = (f"{x.at(t)} {y.at(product / t)}" for t in (start, end))
        yield f'<path class="slope" d="M{a}L{b}"/>'


def _curve(x: _Axis, y: _Axis, looks: Sequence[Look]) -> Iterator[str]:
    if len(looks) > 1:
        upper = [f"{x.at(k.seconds)} {y.at(k.upper)}" for k in looks]
        lower = [f"{x.at(k.seconds)} {y.at(k.lower)}" for k in reversed(looks)]
        yield f'<path class="band" d="M{"L".join([*upper, *lower])}Z"/>'
        middle = "L".join(f"{x.at(k.seconds)} {y.at(k.relmse)}" for k in looks)
        yield f'<path class="curve" d="M{middle}"/>'
    for look in looks:
        at = x.at(look.seconds)
        yield f'<path class="bar" d="M{at} {y.at(look.lower)}V{y.at(look.upper)}"/>'
        yield f'<circle class="dot" cx="{at}" cy="{y.at(look.relmse)}" r="3.5"><title>'
        yield (
            f"{look.spp:,} spp, {words.seconds(look.seconds)}: relMSE {look.relmse:.3g} "
            f"({look.lower:.3g} to {look.upper:.3g})</title></circle>"
        )


def _target(
    x: _Axis, y: _Axis, last: Look, target: float | None, forecast: Forecast | None
) -> Iterator[str]:
    if target:
        at = y.at(target)
        yield f'<path class="target" d="M{LEFT} {at}H{WIDTH - RIGHT}"/>'
        yield f'<text class="target-name" x="{LEFT + 6}" y="{at - 6}">target {target:.3g}</text>'
    if forecast:
        here = f"{x.at(last.seconds)} {y.at(last.relmse)}"
        there = x.at(forecast.seconds), y.at(forecast.relmse)
        yield f'<path class="ahead" d="M{here}L{there[0]} {there[1]}"/>'
        yield f'<circle class="goal" cx="{there[0]}" cy="{there[1]}" r="4.5"><title>expected '
        yield f"after {words.seconds(forecast.seconds)} of rendering</title></circle>"


def _tick(value: float) -> str:
    if 1e-3 <= value < 1e4:
        return f"{value:.10g}"
    exponent = math.floor(math.log10(value) + 1e-9)
    return f"{round(value / 10.0**exponent)}e{exponent}"
