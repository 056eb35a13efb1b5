"""Films of integrands of known mean: truth, realised error, and what an honest interval holds."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from matiere import _core

COLOURS = np.array([1.0, 0.5, 0.25])  # of every synthetic integrand


def true_mean(size: int) -> np.ndarray:
    y, x = np.mgrid[0:size, 0:size]
    return _core.synthetic_mean(x, y)[..., None] * COLOURS


def box(image: np.ndarray) -> np.ndarray:
    """5 x 5 average over the pixels that exist."""
    total, count = np.zeros_like(image), np.zeros(image.shape[:2])
    h, w = count.shape
    for dy in range(-2, 3):
        for dx in range(-2, 3):
            to = slice(max(0, -dy), min(h, h - dy)), slice(max(0, -dx), min(w, w - dx))
            at = slice(max(0, dy), min(h, h + dy)), slice(max(0, dx), min(w, w + dx))
            total[to] += image[at]
            count[to] += 1
    return total / count[..., None]


def true_weights(size: int) -> np.ndarray:
    smooth = box(true_mean(size))
    m = np.exp(np.log(smooth @ [0.2126, 0.7152, 0.0722]).mean())
    return 1.0 / (smooth**2 + 0.01 * m * m)


def crc64(data: bytes) -> int:
    table = []
    for i in range(256):
        crc = i
        for _ in range(8):
            crc = (crc >> 1) ^ (0xC96C5795D7870F42 if crc & 1 else 0)
        table.append(crc)
    crc = 2**64 - 1
    for byte in data:
        crc = table[(crc ^ byte) & 0xFF] ^ (crc >> 8)
    return crc ^ (2**64 - 1)


def runs_of(films: Iterable[_core.Film]) -> list[dict[str, Any]]:
    """The same of films of a synthetic integrand."""
    rows = []
    for film in films:
        weights, mean = true_weights(film.width), true_mean(film.width)
        realised = float((weights * (film.mean()[..., :3] - mean) ** 2).mean())
        rows.append({**film.estimate(), "realised": realised})
    return rows


def assert_honest(rows: list[dict[str, Any]]) -> None:
    """80 seeds: at least 69 inside (P < 0.1 % for a true 95 % interval), and no bias."""
    below = sum(r["realised"] < r["lower"] for r in rows)
    above = sum(r["realised"] > r["upper"] for r in rows)
    assert below + above <= 11, (below, above)
    estimate = np.array([r["relmse"] for r in rows])
    realised = np.array([r["realised"] for r in rows])
    gap = (estimate - realised) / realised.mean()
    bias, deviation = gap.mean(), gap.std(ddof=1) / np.sqrt(len(rows))
    assert abs(bias) < 3.5 * deviation + 0.01, (bias, deviation)  # 1 %: second order in S
    assert np.median([r["upper"] / r["lower"] for r in rows]) < 1.6
