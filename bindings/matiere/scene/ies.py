"""Read photometric files of luminaires: ANSI/IESNA LM-63 (1986 to 2002), type C photometry.

A file gives candela over vertical angles (0 along the luminaire's axis) and horizontal angles about
it. Files often state a quarter or a half of the circle, the rest by symmetry. Light of photometry
type A or B, and tilted lamps with a table in another file, are refused in words.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from matiere.errors import Fault, SceneValidationError
from matiere.scene.assets import AssetRoot

Angles = NDArray[np.float64]

MAX_BYTES = 16 << 20
MAX_ANGLES = 4096  # of one kind; a finer table than any goniophotometer's
EDGE_DEG = 1e-3  # how far an end may be from the angle it should be
PHOTOMETRY = {1: "C", 2: "B", 3: "A"}


@dataclass(frozen=True, slots=True)
class IesProfile:
    """Candela of a luminaire over the whole circle: `candela[h, v]` at the listed angles."""

    vertical_deg: Angles  # ascending, within 0 to 180
    horizontal_deg: Angles  # ascending from 0 to 360; one angle alone: the same all around
    candela: Angles  # (horizontal, vertical)
    lumens: float | None  # what the lamps are rated at together; None: absolute photometry

    @property
    def flux(self) -> float:
        """Lumens in all directions: the integral of the bilinear table over the sphere."""
        mean = self.candela[0]
        if len(self.horizontal_deg) > 1:
            share = np.diff(self.horizontal_deg) / 360
            mean = share @ (0.5 * (self.candela[1:] + self.candela[:-1]))
        total = 0.0
        for (a, fa), (b, fb) in pairwise(zip(np.radians(self.vertical_deg), mean, strict=True)):
            # Of (fa + (fb - fa) (t - a) / (b - a)) sin t over [a, b].
            slope = (fb - fa) / (b - a)
            total += fa * np.cos(a) - fb * np.cos(b) + slope * (np.sin(b) - np.sin(a))
        return float(2 * np.pi * total)


def load_ies(name: str, assets: AssetRoot) -> IesProfile:
    """Return the profile of a file; raise SceneValidationError without place."""
    data = assets.read(name)
    try:
        if len(data) > MAX_BYTES:
            raise ValueError(f"has more than {MAX_BYTES >> 20} MB, far more than a luminaire needs")
        return parse_ies(data.decode("latin-1"))
    except ValueError as error:
        raise SceneValidationError([Fault("", "asset_format", f"{name!r}: {error}")]) from None


def parse_ies(text: str) -> IesProfile:
    """Return the profile that the text of an LM-63 file states; ValueError says what is wrong."""
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    at = next((i for i, line in enumerate(lines) if line.strip().upper().startswith("TILT")), None)
    if at is None:
        raise ValueError("is no LM-63 file: it has no line TILT=")
    tilt = lines[at].partition("=")[2].strip().upper()
    if tilt not in ("NONE", "INCLUDE"):
        raise ValueError(f"takes its tilt from another file ({tilt[:40]!r}), which is not read")
    numbers = _Numbers(lines[at + 1 :], at + 2)
    if tilt == "INCLUDE":  # of lamps that dim when tilted: hung as it was measured, factor 1
        numbers.take(1, "the lamp's position in its tilt table")
        count = numbers.whole("the number of tilt angles", 1, MAX_ANGLES)
        numbers.take(2 * count, "the tilt table")
    return _body(numbers)


class _Numbers:
    """The numbers of a file in order, wherever its lines break."""

    def __init__(self, lines: list[str], first: int) -> None:
        self._words = [
            (word, first + i)
            for i, line in enumerate(lines)
            for word in line.replace(",", " ").split()
        ]
        self._at = 0

    def take(self, count: int, what: str) -> Angles:
        words = self._words[self._at : self._at + count]
        if len(words) < count:
            raise ValueError(f"ends within {what}: {count} numbers are due, {len(words)} are there")
        self._at += count
        return np.array([self._number(word, line, what) for word, line in words])

    def whole(self, what: str, low: int, high: int) -> int:
        value = float(self.take(1, what)[0])
        if value != int(value) or not low <= value <= high:
            raise ValueError(f"{what} is {value:g}, not a whole number from {low} to {high}")
        return int(value)

    @staticmethod
    def _number(word: str, line: int, what: str) -> float:
        try:
            value = float(word)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise ValueError(f"{word[:40]!r} on line {line} is not a number (of {what})")
        return value


def _body(numbers: _Numbers) -> IesProfile:
    lamps = numbers.whole("the number of lamps", 1, 1 << 20)
    per_lamp, multiplier = numbers.take(2, "lumens per lamp and candela multiplier")
    n_vertical = numbers.whole("the number of vertical angles", 2, MAX_ANGLES)
    n_horizontal = numbers.whole("the number of horizontal angles", 1, MAX_ANGLES)
    kind = numbers.whole("the photometric type", 1, 3)
    if kind != 1:
        raise ValueError(f"has photometry of type {PHOTOMETRY[kind]}; only type C is read")
    numbers.take(4, "units and size of the luminous opening")
    ballast = float(np.prod(numbers.take(3, "ballast factor, future use and watts")[:2]))
    vertical = numbers.take(n_vertical, "the vertical angles")
    horizontal = numbers.take(n_horizontal, "the horizontal angles")
    table = numbers.take(n_vertical * n_horizontal, "the candela values")
    candela = table.reshape(n_horizontal, n_vertical) * multiplier * ballast
    for name, angles in (("vertical", vertical), ("horizontal", horizontal)):
        if np.any(np.diff(angles) <= 0):
            raise ValueError(f"the {name} angles do not ascend")
    if candela.min() < 0:
        raise ValueError("holds negative candela values")
    if candela.max() <= 0:
        raise ValueError("is dark: no candela value is above 0")
    _check_vertical(vertical)
    circle, whole = _all_around(horizontal, candela)
    return IesProfile(vertical, circle, whole, None if per_lamp < 0 else float(per_lamp) * lamps)


def _check_vertical(angles: Angles) -> None:
    first, last = angles[0], angles[-1]
    starts = abs(first) <= EDGE_DEG or abs(first - 90) <= EDGE_DEG
    ends = abs(last - 90) <= EDGE_DEG or abs(last - 180) <= EDGE_DEG
    if not (starts and ends):
        raise ValueError(
            f"its vertical angles run from {first:g} to {last:g}; they must begin at 0 or 90 and "
            "end at 90 or 180"
        )


def _all_around(angles: Angles, candela: Angles) -> tuple[Angles, Angles]:
    """Return horizontal angles from 0 to 360 and their rows, by the symmetry that the angles say.

    One angle: the same all around. 0 to 90: both planes mirror. 0 to 180: the plane of 0 and 180
    mirrors. 90 to 270: that of 90 and 270 does. 0 to 360: all is there.
    """

    def spans(low: float, high: float) -> bool:
        return bool(abs(angles[0] - low) <= EDGE_DEG and abs(angles[-1] - high) <= EDGE_DEG)

    if len(angles) == 1:
        return np.zeros(1), candela
    if spans(90, 270):  # turn the table so that its mirror is at 0, mirror, turn back
        half, rows = _mirrored(angles - 90, candela, 180)
        return _turned(half, rows, 90)
    if spans(0, 90):
        angles, candela = _mirrored(angles, candela, 90)
    if spans(0, 180):
        angles, candela = _mirrored(angles, candela, 180)
    if not spans(0, 360):
        raise ValueError(
            f"its horizontal angles run from {angles[0]:g} to {angles[-1]:g}; they must run from 0 "
            "to 90, 180 or 360, or from 90 to 270"
        )
    return angles, candela


def _mirrored(angles: Angles, rows: Angles, at: float) -> tuple[Angles, Angles]:
    """Return what lies on both sides of an angle, given the side below."""
    return (
        np.concatenate([angles, 2 * at - angles[-2::-1]]),
        np.concatenate([rows, rows[-2::-1]]),
    )


def _turned(angles: Angles, rows: Angles, by: float) -> tuple[Angles, Angles]:
    """Return a full circle turned, with rows again at 0 and at 360."""
    inner = (angles[:-1] + by) % 360
    order = np.argsort(inner)
    inner, rows = inner[order], rows[:-1][order]
    if inner[0] > EDGE_DEG:  # between the last and the first row
        share = inner[0] / (inner[0] + 360 - inner[-1])
        seam = share * rows[-1] + (1 - share) * rows[0]
        inner, rows = np.concatenate([[0.0], inner]), np.concatenate([seam[None], rows])
    return np.concatenate([inner, [360.0]]), np.concatenate([rows, rows[:1]])
