"""Does `sample` draw from `pdf`? The measure of the stability report, at the tests' own effort.

What makes it sound for stiff lobes stands in matiere/stability and is tested in tests/stability.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from matiere.stability.statistics import sidak
from matiere.stability.views import Effort, View, look

__all__ = ["run", "sidak"]


def run(bsdf: Any, wo: NDArray[np.float64], n: int = 40_000, seed: int = 1) -> View:
    """Sample, integrate, compare; see `View`. The last class of the chi-square is "rejected"."""
    return look(bsdf, np.asarray(wo, dtype=float), seed, Effort(n, 1e-5, 500_000))
