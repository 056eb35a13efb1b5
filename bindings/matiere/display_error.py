"""The error of the picture people get: how many pixels are how many code values off.

The deviations of the replicates are pushed through the very view that develops the image: with
replicate means m_r around I, d_r = (V(I + s (m_r - I)) - V(I - s (m_r - I))) / 2 s with
s = 1 / sqrt(R - 1), which is a standard error of I wide. Their spread is the variance of V(I),
averaged over 5 x 5 pixels as that of the radiance. A pixel is within N code values if the true
value rounds to no more than N from the one delivered; the chance of that follows from Student's t,
and its mean over the pixels is the expected share. The three channels are judged together by the
sum of their chances to miss, which is on the safe side.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matiere import _core

Array = NDArray[np.float64]
CODES = 255.0
_RADIUS = 2  # of the pixels that a variance is averaged over
_FREEDOMS = (3.0, 5.0, 8.0, 13.0, 21.0, 34.0, 55.0, 89.0)
_GRID = np.concatenate([np.linspace(0.0, 8.0, 1601), np.geomspace(8.02, 1e4, 400)])
_SOLVE_PIXELS = 1 << 16  # the forecast is made from no more than these
_STEP = 0.05  # of log(standard error), for the slope


def display_error(film: _core.Film, target: Mapping[str, Any]) -> dict[str, float] | None:
    """Judge a film by `{"code_values", "pixels_percent", "through": view}`; None where unknown.

    Returns `share_percent` (of the pixels with evidence, expected to be within `code_values`),
    `lower_percent` (which it exceeds at the confidence of this look), `unknown_share`, and
    `excess`: how many times the samples are expected to be needed; at most 1 = reached.
    """
    if film.replicates < 2 or film.spp == 0:
        return None
    shown, se, dof = _display_spread(film, target["through"])
    delivered = _delivered(film, target["through"], shown)
    known = np.isfinite(film.standard_error()).any(-1)
    if not known.any():
        return None
    look = film.plan.look_number(film.spp)
    delivered, shown, se = (image[known] * CODES for image in (delivered, shown, se))
    most, layered = target["code_values"], film.has_light_layer
    pixels = _Pixels(delivered, shown, se, dof[known], most, layered)
    asked = target["pixels_percent"] / 100.0
    share, lower = pixels.share(1.0, look)
    some = pixels.some(_SOLVE_PIXELS)
    scale = _largest_scale(lambda f: some.share(f, look)[1] >= asked)
    forecast = 1.0 / scale**2
    excess = min(forecast, 1.0) if lower >= asked else max(forecast, 1.0 + 1e-6)
    return {
        "share_percent": 100.0 * share,
        "lower_percent": 100.0 * lower,
        "unknown_share": float(1.0 - known.mean()),
        "excess": float(excess),
    }


def code_differences(a: Array, b: Array) -> Array:
    """Return, per pixel, the largest difference in 8-bit code values of two developed images."""
    codes = [np.floor(np.clip(image, 0.0, 1.0) * CODES + 0.5) for image in (a, b)]
    return np.asarray(np.abs(codes[0] - codes[1]).max(-1))


def shown_as(mean: Array, view: Mapping[str, Any]) -> Array:
    """Develop linear (H, W, 4) means; if transparent over black, alpha as a fourth channel."""
    from matiere.develop import develop

    transparent = view.get("transparent", False)
    options = {k: view[k] for k in ("config", "display", "view", "exposure")}
    linear = np.asarray(mean if transparent else mean[..., :3], np.float32)
    values = develop(linear, **options).astype(np.float64)
    if transparent:
        values[..., :3] *= values[..., 3:]
    return np.asarray(np.clip(values, 0.0, 1.0))


def _display_spread(film: _core.Film, view: Mapping[str, Any]) -> tuple[Array, Array, Array]:
    """Return the developed image, its standard error, and that one's degrees of freedom."""
    mean, means = film.mean(), film.replicate_means()
    count = film.replicates
    step = 1.0 / np.sqrt(count - 1.0)
    shown = shown_as(mean, view)
    squares = np.zeros_like(shown)
    for one in means:
        away = step * (one - mean)
        slope = (shown_as(mean + away, view) - shown_as(mean - away, view)) / (2.0 * step)
        squares += slope**2
    variance = squares / (count * (count - 1.0))
    total, square_total, n = _box(variance), _box(variance**2), _box(np.ones_like(variance))
    with np.errstate(invalid="ignore", divide="ignore"):
        pixels = np.where(square_total > 0.0, total**2 / square_total, n)
    return shown, np.sqrt(total / n), (count + 1.0) * pixels


def _delivered(film: _core.Film, view: Mapping[str, Any], shown: Array) -> Array:
    """Return the developed image as it is written: without specks if the view leaves them out."""
    if not view.get("despeckle"):
        return shown
    from matiere.despeckle import despeckle

    means = film.replicate_means()
    alpha = means.mean(0)[..., 3:]
    return shown_as(np.concatenate([despeckle(means[..., :3]).mean, alpha], axis=2), view)


def _box(image: Array) -> Array:
    """Sum over 5 x 5 pixels, fewer at the edge. Adds what is positive only, and so keeps digits."""
    for axis in (0, 1):
        total = np.zeros_like(image)
        size = image.shape[axis]
        for shift in range(-min(_RADIUS, size - 1), min(_RADIUS, size - 1) + 1):
            to = [slice(None)] * 3
            at = [slice(None)] * 3
            to[axis] = slice(max(0, -shift), min(size, size - shift))
            at[axis] = slice(max(0, shift), min(size, size + shift))
            total[tuple(to)] += image[tuple(at)]
        image = total
    return image


def _largest_scale(holds: Any) -> float:
    """Return the largest factor of the standard errors that `holds`, within 2^-12 and 2^4."""
    low, high = -12.0, 4.0
    for _ in range(16):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(2.0**middle) else (low, middle)
    return float(2.0**low)


class _Pixels:
    """Code values of pixels (N, C), their standard errors and degrees of freedom."""

    def __init__(
        self, delivered: Array, codes: Array, se: Array, dof: Array, most: int, layered: bool
    ) -> None:
        nearest = np.floor(delivered + 0.5)
        low, high = nearest - most - 0.5, nearest + most + 0.5
        self._above = np.where(high >= CODES, np.inf, high - codes)
        self._below = np.where(low <= 0.0, np.inf, codes - low)
        self._se, self._dof, self._layered = se, dof, layered
        self._classes = np.searchsorted(_FREEDOMS, dof, side="right").clip(1) - 1

    def some(self, most: int) -> _Pixels:
        """Return evenly strided pixels, no more than `most`."""
        step = -(-len(self._se) // most)
        part = object.__new__(_Pixels)
        for name in ("_above", "_below", "_se", "_dof", "_classes", "_layered"):
            value = getattr(self, name)
            setattr(part, name, value[::step] if isinstance(value, np.ndarray) else value)
        return part

    def share(self, scale: float, look: int) -> tuple[float, float]:
        """Return the expected share within reach, and its lower bound at a look's confidence."""
        from matiere import _core

        miss = self._miss(scale)
        share, n = 1.0 - float(miss.mean()), len(miss)
        slope = (self._miss(scale * np.exp(_STEP)) - miss) / _STEP
        # Pixels miss or not on their own, but together with their neighbours where they share
        # light paths; standard errors are shared by 5 x 5 pixels.
        window = (2 * _RADIUS + 1) ** 2
        by_chance = float(np.sum(miss * (1.0 - miss))) * (window if self._layered else 1)
        by_spread = window * float(np.sum(slope**2 / (2.0 * self._dof.min(-1))))
        tail = 0.5 * (1.0 - _core.look_confidence(look))
        t = float(_core.student_quantile(tail, 1e4))
        return share, share - t * float(np.sqrt(by_chance + by_spread)) / n

    def _miss(self, scale: float) -> Array:
        """Chance of each pixel to be off by more."""
        least = np.finfo(float).tiny  # a standard error of 0 in the display: burnt out or black
        with np.errstate(over="ignore"):
            above = self._above / np.maximum(scale * self._se, least)
            below = self._below / np.maximum(scale * self._se, least)
        chance = np.zeros_like(above)
        for index, table in enumerate(_tails()):
            here = self._classes == index
            chance[here] = _tail(above[here], table) + _tail(below[here], table)
        return np.asarray(np.minimum(chance.sum(-1), 1.0))


def _tail(t: Array, table: Array) -> Array:
    """P(T > t) from the table of a class; t is negative where despeckling moved a pixel."""
    tail = np.interp(np.abs(t), _GRID, table, right=0.0)
    return np.asarray(np.where(t < 0.0, 1.0 - tail, tail))


_TABLES: list[Array] = []


def _tails() -> list[Array]:
    """Return P(T > t) on the grid for each class of degrees of freedom."""
    from matiere import _core

    if not _TABLES:
        _TABLES.extend(np.asarray(_core.student_tail(_GRID, dof)) for dof in _FREEDOMS)
    return _TABLES
