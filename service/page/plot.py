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

from matiere.log_axis import LogAxis
from matiere.service.page import words

WIDTH, HEIGHT = 560, 320
LEFT, RIGHT, TOP, BOTTOM = 70, 14, 14, 52


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


def error_plot(looks: Sequence[Look], target: float | None, forecast: Forecast | None) -> Markup:
    """Return the plot; `target` is a relMSE to draw as a line. Empty while no error is known."""
    if not looks:
        return Markup("")
    times = [look.seconds for look in looks] + ([forecast.seconds] if forecast else [])
    errors = [v for look in looks for v in (look.lower, look.upper)]
    errors += [target] if target else []
    errors += [forecast.relmse] if forecast else []
    x = LogAxis.around(times, LEFT, WIDTH - RIGHT, margin=0.06)
    y = LogAxis.around(errors, HEIGHT - BOTTOM, TOP, margin=0.06)
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


def _frame(x: LogAxis, y: LogAxis) -> Iterator[str]:
    bottom, right = HEIGHT - BOTTOM, WIDTH - RIGHT
    for at, value in _labelled(x):
        yield f'<path class="grid" d="M{at} {TOP}V{bottom}"/>'
        yield f'<text class="tick" x="{at}" y="{bottom + 19}" text-anchor="middle">'
        yield f"{_tick(value)}</text>"
    for at, value in _labelled(y):
        yield f'<path class="grid" d="M{LEFT} {at}H{right}"/>'
        yield f'<text class="tick" x="{LEFT - 8}" y="{at + 4}" text-anchor="end">'
        yield f"{_tick(value)}</text>"
    yield f'<path class="axis" d="M{LEFT} {TOP}V{bottom}H{right}"/>'
    yield f'<text class="name" x="{(LEFT + right) / 2}" y="{HEIGHT - 8}" text-anchor="middle">'
    yield "render time / s</text>"
    middle = (TOP + bottom) / 2
    yield f'<text class="name" x="14" y="{middle}" text-anchor="middle" '
    yield f'transform="rotate(-90 14 {middle})">relMSE</text>'


def _labelled(axis: LogAxis) -> Iterator[tuple[float, float]]:
    return ((_px(axis, value), value) for value, labelled in axis.ticks() if labelled)


def _px(axis: LogAxis, value: float) -> float:
    return round(axis.at(value), 2)


def _reference(x: LogAxis, y: LogAxis, last: Look) -> Iterator[str]:
    """A dashed line that falls as 1 / time, as the error of independent samples does."""
    product = last.seconds * last.relmse
    start, end = max(x.low, product / y.high), min(x.high, product / y.low)
    if start < end:
        a, b = (f"{_px(x, t)} {_px(y, product / t)}" for t in (start, end))
        yield f'<path class="slope" d="M{a}L{b}"/>'


def _curve(x: LogAxis, y: LogAxis, looks: Sequence[Look]) -> Iterator[str]:
    if len(looks) > 1:
        upper = [f"{_px(x, k.seconds)} {_px(y, k.upper)}" for k in looks]
        lower = [f"{_px(x, k.seconds)} {_px(y, k.lower)}" for k in reversed(looks)]
        yield f'<path class="band" d="M{"L".join([*upper, *lower])}Z"/>'
        middle = "L".join(f"{_px(x, k.seconds)} {_px(y, k.relmse)}" for k in looks)
        yield f'<path class="curve" d="M{middle}"/>'
    for look in looks:
        at = _px(x, look.seconds)
        yield f'<path class="bar" d="M{at} {_px(y, look.lower)}V{_px(y, look.upper)}"/>'
        yield f'<circle class="dot" cx="{at}" cy="{_px(y, look.relmse)}" r="3.5"><title>'
        yield (
            f"{look.spp:,} spp, {words.seconds(look.seconds)}: relMSE {look.relmse:.3g} "
            f"({look.lower:.3g} to {look.upper:.3g})</title></circle>"
        )


def _target(
    x: LogAxis, y: LogAxis, last: Look, target: float | None, forecast: Forecast | None
) -> Iterator[str]:
    if target:
        at = _px(y, target)
        yield f'<path class="target" d="M{LEFT} {at}H{WIDTH - RIGHT}"/>'
        yield f'<text class="target-name" x="{LEFT + 6}" y="{at - 6}">target {target:.3g}</text>'
    if forecast:
        here = f"{_px(x, last.seconds)} {_px(y, last.relmse)}"
        there = _px(x, forecast.seconds), _px(y, forecast.relmse)
        yield f'<path class="ahead" d="M{here}L{there[0]} {there[1]}"/>'
        yield f'<circle class="goal" cx="{there[0]}" cy="{there[1]}" r="4.5"><title>expected '
        yield f"after {words.seconds(forecast.seconds)} of rendering</title></circle>"


def _tick(value: float) -> str:
    if 1e-3 <= value < 1e4:
        return f"{value:.10g}"
    exponent = math.floor(math.log10(value) + 1e-9)
    return f"{round(value / 10.0**exponent)}e{exponent}"
