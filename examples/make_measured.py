"""Make MERL files for examples/materials/measured.json: closed forms in place of measurements.

    python examples/make_measured.py          # into examples/materials/stage/measured, 33 MB each
    matiere sweep examples/materials/measured.json -o out

The project carries no measured data. Real files (MERL `.binary`, RGL `.bsdf`) go to the same folder
and are named in the sweep in place of these.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

FOLDER = Path(__file__).resolve().parent / "materials" / "stage" / "measured"
SHAPE = (90, 90, 180)
SCALE = (1.0 / 1500, 1.15 / 1500, 1.66 / 1500)  # of the format, per channel
Table = Callable[[Any, Any], Any]


def lobe(theta_h: Any, theta_d: Any, alpha: float, F0: float) -> Any:
    """Return a Beckmann lobe with Schlick's Fresnel term, without masking, in 1/sr."""
    cos_h, cos_d = np.cos(theta_h), np.cos(theta_d)
    D = np.exp(-((np.tan(theta_h) / alpha) ** 2)) / (np.pi * alpha**2 * cos_h**4)
    F = F0 + (1 - F0) * (1 - cos_d) ** 5
    return D * F / (4 * np.maximum(cos_h * cos_d, 0.1) ** 2)


def body(color: tuple[float, float, float], gloss: Any = 0.0) -> Any:
    """Return a diffuse body under a lobe, three channels in 1/sr."""
    return [c / np.pi + gloss for c in color]


TABLES: dict[str, Table] = {
    "lambert": lambda h, d: body((0.5, 0.5, 0.5), 0 * (h + d)),
    "satin": lambda h, d: body((0.35, 0.05, 0.04), lobe(h, d, 0.35, 0.05)),
    "lacquer": lambda h, d: body((0.02, 0.06, 0.25), lobe(h, d, 0.06, 0.05)),
    "velvet": lambda h, d: body(
        (0.02, 0.08, 0.03), 0.08 * np.sin(h) ** 4 * (0.4 + 0.6 * np.sin(d))
    ),
}


def write(folder: Path = FOLDER) -> list[Path]:
    """Write every table and return the files."""
    folder.mkdir(parents=True, exist_ok=True)
    h = (np.pi / 2 * ((np.arange(90) + 0.5) / 90) ** 2)[:, None, None]
    d = ((np.arange(90) + 0.5) / 90 * np.pi / 2)[None, :, None]
    written = []
    for name, table in TABLES.items():
        path = folder / f"{name}.binary"
        planes = [
            np.broadcast_to(plane, SHAPE) / s for plane, s in zip(table(h, d), SCALE, strict=True)
        ]
        path.write_bytes(struct.pack("<3i", *SHAPE) + np.stack(planes).astype("<f8").tobytes())
        written.append(path)
    return written


if __name__ == "__main__":
    for path in write():
        print(path)
