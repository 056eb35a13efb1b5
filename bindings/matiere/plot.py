"""Error against run time as SVG or PNG: log-log axes with units, a curve with its band per film.

    from matiere.plot import error_plot
    Path("error.svg").write_text(error_plot([("gold", film.report["log"])]))

Drawn by hand so that a report costs no plotting library.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from matiere.canvas import Canvas
from matiere.log_axis import LogAxis

if TYPE_CHECKING:
    from matiere.film import Film

Log = Sequence[Mapping[str, Any]]
Curve = tuple[str, Log]

# Okabe and Ito 2008: eight colours told apart by colour-blind readers too.
COLOURS = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#7f7f00", "#000000",
)  # fmt: skip
WIDTH, HEIGHT = 760, 480
MAX_INSIDE = 4  # curves whose key finds room above them
LEFT, RIGHT, TOP, BOTTOM = 82, 24, 52, 62
MAX_LEGEND = 16
MAX_BANDS = 8  # beyond that the bands hide each other
MAX_CURVES = 24  # beyond that one band stands for all curves
MAX_DOTS = 1000
CROWD_STEPS = 48  # of the band, evenly spaced in the logarithm of time
FEWEST, FEWEST_SHARE = 3, 0.05  # curves at a time, without which the band has no say there


@dataclass(frozen=True)
class Goal:
    """A target on the plot: in words, and how many times the time so far it is expected to take."""

    text: str
    excess: float | None  # None = unknown; at most 1 = reached


def error_plot(curves: Iterable[Curve], title: str = "error against run time") -> str:
    """Return the SVG of relMSE against wall seconds; looks without a known error are left out.

    Bands are the 95 % prediction intervals; the dashed line falls as 1 / time, as independent
    samples do. Of more than 24 curves it draws where they end, the spread of all of them (median,
    middle half, 5 % to 95 %) and the one that ends with the largest error. Raises ValueError if no
    look has a known error.
    """
    return draw_errors(curves, title).svg()


def certificate_plot(film: Film, label: str = "this film") -> Canvas:
    """Draw a film's error against time, what its target asks for and when that is expected.

    The dark band is the 95 % interval of each look, the light one holds at all looks at once.
    Raises ValueError if no look has a known error.
    """
    state, error = film.certificate()["target"], film.error
    goal = None if state is None else Goal(state["text"], state["excess"])
    title = f"relMSE {_short(error['relmse'])}"
    if error["known"]:
        title += f", with 95 % confidence {_short(error['lower'])} to {_short(error['upper'])}"
    return draw_errors([(label, film.report["log"])], title, goal)


def draw_errors(curves: Iterable[Curve], title: str, goal: Goal | None = None) -> Canvas:
    """Draw relMSE against wall seconds. Raises ValueError if no look has a known error."""
    known = [(name, _points(log)) for name, log in curves]
    known = [(name, points) for name, points in known if points]
    if not known:
        raise ValueError("no look at the error is known, there is nothing to plot")
    points = [point for _, some in known for point in some]
    if len(known) > MAX_CURVES:
        return _crowd(known, points, title)
    ahead = _forecast(known[0][1][-1], goal)
    bands = len(known) <= MAX_BANDS
    x = LogAxis.around([p.seconds for p in points] + ahead[:1], LEFT, WIDTH - RIGHT)
    errors = [v for p in points for v in (p.all() if bands else [p.relmse])]
    y = LogAxis.around(errors + ahead[1:], HEIGHT - BOTTOM, TOP)
    beside = len(known) > MAX_INSIDE
    longest = max(len(name) for name, _ in known[:MAX_LEGEND])
    page = Canvas(WIDTH + (int(_key_width(longest)) if beside else 0), HEIGHT)
    _frame(page, x, y, title, bands)
    _slope(page, x, y, points)
    for index, (_, some) in enumerate(known):
        _curve(page, x, y, some, COLOURS[index % len(COLOURS)], bands)
    if goal is not None:
        _goal(page, x, y, known[0][1][-1], goal, ahead)
    wide = any(p.any_time for p in points) and bands
    _legend(page, [name for name, _ in known], wide, beside)
    return page


def _crowd(known: Sequence[tuple[str, list[_Look]]], points: Sequence[_Look], title: str) -> Canvas:
    """Draw many curves as one: the spread of errors at equal time, and where each curve ends."""
    x = LogAxis.around([p.seconds for p in points], LEFT, WIDTH - RIGHT)
    y = LogAxis.around([p.relmse for p in points], HEIGHT - BOTTOM, TOP)
    page = Canvas(WIDTH, HEIGHT)
    _frame(page, x, y, title, bands=False)
    spread = _spread([looks for _, looks in known], x)
    for outer, opacity in (((0, 4), 0.15), ((1, 3), 0.25)):
        _band(page, x, y, [(t, q[outer[0]], q[outer[1]]) for t, q in spread], COLOURS[0], opacity)
    _slope(page, x, y, points)
    step = -(-len(known) // MAX_DOTS)
    for _, looks in known[::step]:
        page.dot((x.at(looks[-1].seconds), y.at(looks[-1].relmse)), "#7f8fa6", 1.6)
    worst, looks = max(known, key=lambda curve: curve[1][-1].relmse)
    _curve(page, x, y, looks, COLOURS[1], band=False)
    entries = [(f"largest error: {worst}", COLOURS[1], 0), ("dots: ends of curves", "#7f8fa6", 0)]
    if len(spread) > 1:
        page.line([(x.at(t), y.at(q[2])) for t, q in spread], COLOURS[0], 2)
        entries[:0] = [(f"median of {len(known):,}", COLOURS[0], 0),
                       ("bands: middle half, 5 % to 95 %", "#bfd9ec", 0)]  # fmt: skip
    if step > 1:
        entries.append((f"every {step}th end is shown", "#ffffff", 0))
    _key(page, [*entries, ("1 / time", "#888888", 5)])
    return page


def _spread(curves: Sequence[Sequence[_Look]], x: LogAxis) -> list[tuple[float, list[float]]]:
    """Return (seconds, quantiles 5, 25, 50, 75, 95 %) of the errors of all curves known then."""
    found = []
    for step in range(CROWD_STEPS + 1):
        t = x.low * (x.high / x.low) ** (step / CROWD_STEPS)
        values = sorted(v for looks in curves if (v := _error_at(looks, t)) is not None)
        if len(values) >= max(FEWEST, FEWEST_SHARE * len(curves)):
            last = len(values) - 1
            found.append((t, [values[round(q * last)] for q in (0.05, 0.25, 0.5, 0.75, 0.95)]))
    return found


def _error_at(looks: Sequence[_Look], t: float) -> float | None:
    """Return the error after `t` seconds on the straight lines between looks; None outside."""
    for a, b in itertools.pairwise(looks):
        if a.seconds <= t <= b.seconds and a.seconds < b.seconds:
            share = math.log(t / a.seconds) / math.log(b.seconds / a.seconds)
            return float(a.relmse * (b.relmse / a.relmse) ** share)
    return None


def write_error_plot(
    path: str | os.PathLike[str], curves: Iterable[Curve], title: str = "error against run time"
) -> None:
    """Write the plot as an SVG or PNG file, whole or not at all."""
    draw_errors(curves, title).save(Path(path))


@dataclass(frozen=True)
class _Look:
    """A look whose figures are all known and positive."""

    seconds: float
    relmse: float
    lower: float
    upper: float
    any_time: tuple[float, float] | None

    def all(self) -> list[float]:
        return [self.relmse, self.lower, self.upper, *(self.any_time or ())]


def _points(log: Log) -> list[_Look]:
    found = []
    for row in log:
        values = [row.get(key) or 0.0 for key in ("wall_s", "relmse", "lower", "upper")]
        wide = [row.get(key) or 0.0 for key in ("any_time_lower", "any_time_upper")]
        if min(values) > 0:
            any_time = (wide[0], wide[1]) if min(wide) > 0 else None
            found.append(_Look(values[0], values[1], values[2], values[3], any_time))
    return sorted(found, key=lambda look: look.seconds)


def _forecast(last: _Look, goal: Goal | None) -> list[float]:
    """Seconds and relMSE where the target is expected to be met, if it is not yet."""
    if goal is None or goal.excess is None or goal.excess <= 1.0:
        return []
    return [last.seconds * goal.excess, last.relmse / goal.excess]


def _frame(page: Canvas, x: LogAxis, y: LogAxis, title: str, bands: bool) -> None:
    page.text((WIDTH / 2, 26), title, size=15)
    for value, labelled in x.ticks():
        at = x.at(value)
        page.line([(at, TOP), (at, HEIGHT - BOTTOM)], "#d0d0d0" if labelled else "#eeeeee")
        if labelled:
            page.text((at, HEIGHT - BOTTOM + 18), _number(value))
    for value, labelled in y.ticks():
        at = y.at(value)
        page.line([(LEFT, at), (WIDTH - RIGHT, at)], "#d0d0d0" if labelled else "#eeeeee")
        if labelled:
            page.text((LEFT - 8, at + 4), _number(value), anchor="end")
    right, bottom = WIDTH - RIGHT, HEIGHT - BOTTOM
    corners = [(LEFT, TOP), (right, TOP), (right, bottom), (LEFT, bottom), (LEFT, TOP)]
    page.line(corners, "#444444")
    page.text(((LEFT + right) / 2, HEIGHT - 18), "render time / s (wall clock)", size=13)
    label = "estimated relMSE" + (" (band: 95 % prediction interval)" if bands else "")
    page.text((20, (TOP + bottom) / 2), label, size=13, turned=True)


def _curve(
    page: Canvas, x: LogAxis, y: LogAxis, looks: Sequence[_Look], colour: str, band: bool
) -> None:
    if band:
        spans = [(look.seconds, *look.any_time) for look in looks if look.any_time]
        _band(page, x, y, spans, colour, 0.10)
        _band(page, x, y, [(k.seconds, k.lower, k.upper) for k in looks], colour, 0.22)
    middle = [(x.at(look.seconds), y.at(look.relmse)) for look in looks]
    if len(middle) > 1:
        page.line(middle, colour, 1.6)
    for at in middle:
        page.dot(at, colour, 2.6)


def _band(
    page: Canvas,
    x: LogAxis,
    y: LogAxis,
    spans: Sequence[tuple[float, float, float]],
    colour: str,
    opacity: float,
) -> None:
    if len(spans) > 1:
        upper = [(x.at(t), y.at(high)) for t, _, high in spans]
        lower = [(x.at(t), y.at(low)) for t, low, _ in reversed(spans)]
        page.area([*upper, *lower], colour, opacity)
    elif spans:
        ((t, low, high),) = spans
        left, right, top, bottom = x.at(t) - 2, x.at(t) + 2, y.at(high), y.at(low)
        page.area([(left, top), (right, top), (right, bottom), (left, bottom)], colour, opacity)


def _slope(page: Canvas, x: LogAxis, y: LogAxis, looks: Sequence[_Look]) -> None:
    """A line of slope -1 through the geometric middle of all points, clipped to the frame."""
    n = len(looks)
    t0 = math.exp(sum(math.log(p.seconds) for p in looks) / n)
    e0 = math.exp(sum(math.log(p.relmse) for p in looks) / n)
    start = max(x.low, t0 * e0 / y.high)
    end = min(x.high, t0 * e0 / y.low)
    if start < end:
        page.line([(x.at(t), y.at(t0 * e0 / t)) for t in (start, end)], "#888888", 1, (5, 4))


def _goal(
    page: Canvas, x: LogAxis, y: LogAxis, last: _Look, goal: Goal, ahead: Sequence[float]
) -> None:
    """Say below the title whether the target is reached, or where it is expected to be."""
    state = "reached" if goal.excess is not None else "no forecast: the error is unknown"
    if ahead:
        seconds, relmse = ahead
        here, there = (last.seconds, last.relmse), (seconds, relmse)
        page.line([(x.at(t), y.at(e)) for t, e in (here, there)], "#d55e00", 1.6, (2, 4))
        page.line([(x.at(seconds), y.at(relmse)), (x.at(seconds), HEIGHT - BOTTOM)], "#d55e00")
        page.dot((x.at(seconds), y.at(relmse)), "#d55e00", 4)
        state = f"expected after {_seconds(seconds)}"
    page.text((WIDTH / 2, 43), f"target: {goal.text}; {state}", color="#a04000")


def _legend(page: Canvas, names: Sequence[str], wide: bool, beside: bool) -> None:
    shown = [*names[:MAX_LEGEND]]
    entries = [(name, COLOURS[i % len(COLOURS)], 0) for i, name in enumerate(shown)]
    if len(names) > MAX_LEGEND:
        entries.append((f"and {len(names) - MAX_LEGEND} more", "#ffffff", 0))
    if wide:
        entries.append(("light band: all looks at once", "#ffffff", 0))
    _key(page, [*entries, ("1 / time", "#888888", 5)], beside)


def _key_width(letters: int) -> float:
    return 34 + 6.6 * max(letters, len("and 99 more"))


def _key(page: Canvas, entries: Sequence[tuple[str, str, int]], beside: bool = False) -> None:
    """Write what colours mean into the upper right corner, or beside it: (text, colour, dash)."""
    width = _key_width(max(len(name) for name, _, _ in entries))
    left, top = WIDTH - RIGHT - width - 6, TOP + 6
    if beside:
        left, top = WIDTH - RIGHT + 6, TOP
    bottom = top + 16 * len(entries) + 8
    box = [(left, top), (left + width, top), (left + width, bottom), (left, bottom)]
    page.area(box, "#ffffff", 0.85)
    page.line([*box, box[0]], "#cccccc")
    for row, (name, colour, dash) in enumerate(entries):
        at = top + 16 + 16 * row
        ends = [(left + 6, at - 4), (left + 24, at - 4)]
        page.line(ends, colour, 2, (dash, 4) if dash else None)
        page.text((left + 29, at), name, anchor="start")


def _short(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.2g}"


def _seconds(value: float) -> str:
    """A duration as people say it."""
    if value < 120:
        return f"{value:.2g} s"
    if value < 7200:
        return f"{value / 60:.2g} min"
    return f"{value / 3600:.2g} h" if value < 172800 else f"{value / 86400:.2g} days"


def _number(value: float) -> str:
    """A tick label: plain near 1, as 2e-5 elsewhere."""
    if 1e-3 <= value < 1e4:
        return f"{value:.10g}"
    exponent = math.floor(math.log10(value) + 1e-9)
    digit = round(value / 10.0**exponent)
    return f"{digit}e{exponent}"
