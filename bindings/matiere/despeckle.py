"""Take specks out of a picture: light that too few samples vouch for.

A path that meets the sun by luck leaves one pixel far too bright.  The film keeps it, because the
mean of many films is right only with it; a picture for the eye can do without.  Each pixel has R
replicates with samples of their own, so a speck shows: one replicate far above the others and
above the pixels around.  What it has too much is held back and counted.  The idea of reading
trust off groups of samples is that of Zirr, Hanika and Dachsbacher (2018), "Re-weighting firefly
samples for improved finite-sample Monte Carlo estimates".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float64]

REACH = 2  # pixels to each side that vouch for a pixel
QUANTILE = 0.75  # of all replicates in that window
FACTOR = 2.0  # how far above what is vouched for a replicate may be
BATCH = 65536  # pixels whose windows are in memory at once
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # linear Rec.709


@dataclass(frozen=True, slots=True)
class Despeckled:
    """A film's mean without specks, and what was held back.

    `mean` is float64 (H, W, 3) in the film's unit; `pixels` is the share of pixels that lost more
    than 1 % of their luminance, `energy` the share of the image's luminance that was held back.
    """

    mean: Image
    pixels: float
    energy: float


def despeckle(replicates: Image) -> Despeckled:
    """Return the mean over replicates (R, H, W, 3) with each replicate held to what is vouched for.

    A replicate may have FACTOR times the luminance that its pixel's lower median replicate has, or
    FACTOR times the upper quartile of all replicates of the 5 x 5 pixels around, whichever is
    more; what is brighter is scaled down to that. So an edge or a highlight that the replicates
    agree on stays as it is, and with more samples the picture tends to the mean: all replicates
    agree in the end. With one replicate nothing can be told and nothing is changed.
    """
    light = replicates @ LUMINANCE
    vouched = np.sort(light, axis=0)[(light.shape[0] - 1) // 2]
    suspects = np.nonzero(light.max(axis=0) > FACTOR * np.maximum(vouched, 0.0))
    limit = np.full(vouched.shape, np.inf)
    for start in range(0, len(suspects[0]), BATCH):
        y, x = (part[start : start + BATCH] for part in suspects)
        limit[y, x] = FACTOR * np.maximum(vouched[y, x], _around(light, y, x))
    bright = light > limit
    held = np.where(bright, limit, 1.0) / np.where(bright, light, 1.0)
    mean = (replicates * held[..., None]).mean(axis=0)
    full, lost = light.mean(axis=0), (light * (1.0 - held)).mean(axis=0)
    total = float(full.sum())
    return Despeckled(
        mean,
        pixels=float(np.mean(lost > 0.01 * full)),
        energy=float(lost.sum()) / total if total > 0.0 else 0.0,
    )


def _around(light: Image, y: NDArray[np.intp], x: NDArray[np.intp]) -> Image:
    """Return the quantile over all replicates of the window around each pixel."""
    _, height, width = light.shape
    steps = range(-REACH, REACH + 1)
    window = [
        light[:, np.clip(y + dy, 0, height - 1), np.clip(x + dx, 0, width - 1)]
        for dy in steps
        for dx in steps
    ]
    values = np.maximum(np.concatenate(window), 0.0)
    rank = int(QUANTILE * len(values))
    found: Image = np.partition(values, rank, axis=0)[rank]
    return found
