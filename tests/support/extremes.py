"""The stiff values that every model must survive: one place for all tests."""

from __future__ import annotations

import math

ALPHAS = (0.0, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 0.5, 1.0)
ETAS = (
    1.0, 1 + 1e-6, 1 - 1e-6, 1 + 1e-4, 1 - 1e-4, 0.5, 1 / 1.5, 1.33, 1.5, 2.4, 5.0, 100.0,
)  # fmt: skip
EXTINCTIONS = (0.0, 1e-3, 3.0, 50.0)
COSINES = (1.0, 0.5, 1e-2, 1e-4, 1e-6)
DEGREES = (0.0, 30.0, 60.0, 75.0, 85.0, 89.9)
OPTICAL_DEPTHS = (0.0, 1e-6, 1.0, 1e3)
ALBEDOS = (0.0, 0.999, 1.0)


def direction(degrees: float, azimuth: float = 0.0) -> tuple[float, float, float]:
    """Return the unit direction at an angle from +z, azimuth in radians."""
    theta = math.radians(degrees)
    s = math.sin(theta)
    return s * math.cos(azimuth), s * math.sin(azimuth), math.cos(theta)
