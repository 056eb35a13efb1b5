"""Make a scene of media that scatter: a ribbed candle of wax, a ball of jade, one of smoke.

    python examples/make_subsurface.py examples/scenes/subsurface.json

Light comes from behind, so that what is thin glows. The candle is one closed mesh with smooth
normals, made here.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

ROOT = Path(__file__).resolve().parent
TURNS, RINGS = 48, 14  # of the candle's mesh
RIBS, TWIST, RIB_DEPTH = 6, 1.6, 0.2  # TWIST in radians over the height
RADIUS, HEIGHT = 0.55, 1.5


def candle() -> tuple[npt.NDArray[Any], npt.NDArray[Any], npt.NDArray[Any]]:
    """Return positions, triangles and normals of a twisted column, closed by its two poles."""
    s = np.linspace(0, 1, RINGS)  # along the profile, pole to pole
    profile = np.minimum(1, (4 * s * (1 - s)) ** 0.25)[:, None]
    y = (HEIGHT * (0.5 - 0.5 * np.cos(np.pi * s)))[:, None]
    turn = np.linspace(0, 2 * np.pi, TURNS, endpoint=False)[None, :]
    rib = 1 + RIB_DEPTH * np.cos(RIBS * (turn - TWIST * y / HEIGHT))
    radius = RADIUS * profile * rib
    rings = np.stack([radius * np.cos(turn), np.broadcast_to(y, radius.shape),
                      radius * np.sin(turn)], axis=-1)[1:-1]  # fmt: skip
    positions = np.concatenate([rings.reshape(-1, 3), [[0, 0, 0], [0, HEIGHT, 0]]])

    at = np.arange((RINGS - 2) * TURNS).reshape(RINGS - 2, TURNS)
    right = np.roll(at, -1, axis=1)
    low, low_right, up, up_right = at[:-1], right[:-1], at[1:], right[1:]
    bottom, top = np.full(TURNS, at.size), np.full(TURNS, at.size + 1)
    triangles = np.concatenate([
        np.stack([low, up, low_right], -1).reshape(-1, 3),
        np.stack([low_right, up, up_right], -1).reshape(-1, 3),
        np.stack([at[0], right[0], bottom], -1),
        np.stack([right[-1], at[-1], top], -1),
    ])  # fmt: skip
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    faces = np.cross(b - a, c - a)
    normals = np.zeros_like(positions)
    for k in range(3):
        np.add.at(normals, triangles[:, k], faces)
    return positions, triangles, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def rows(array: npt.NDArray[Any]) -> list[list[float]]:
    """Return rows of numbers with four decimals."""
    return [[round(float(v), 4) + 0.0 for v in row] for row in array]


def subsurface(width: int = 360, spp: int = 256) -> dict[str, Any]:
    """Return the scene."""
    positions, triangles, normals = candle()
    positions[:, 1] += 0.01
    floor = [[-6, 0, 5], [6, 0, 5], [6, 0, -5], [-6, 0, -5]]
    return {
        "version": 1,
        "camera": {"type": "pinhole", "origin": [0, 1.5, 6], "target": [0, 0.72, 0],
                   "vfov_deg": 27},
        "film": {"width": width, "height": width * 5 // 9},
        "render": {"spp": spp},
        "materials": {
            "wax": {"type": "dielectric", "eta": 1.44, "alpha": 0.25,
                    "scattering_albedo": [0.995, 0.96, 0.75],
                    "mean_free_path": [0.09, 0.06, 0.04], "g": 0.4},
            "jade": {"type": "dielectric", "eta": 1.6, "alpha": 0.05,
                     "scattering_albedo": [0.8, 0.985, 0.9], "mean_free_path": 0.06, "g": 0.2},
            "smoke": {"type": "null", "sigma_s": [2.2, 2.5, 3.0], "sigma_a": 0.3, "g": 0.5},
            "floor": {"type": "lambert", "albedo": [0.32, 0.3, 0.28]},
        },
        "shapes": [
            {"type": "mesh", "name": "candle", "positions": rows(positions),
             "triangles": triangles.tolist(), "normals": rows(normals), "material": "wax"},
            {"type": "sphere", "name": "jade ball", "center": [-1.5, 0.61, 0.2], "radius": 0.6,
             "material": "jade"},
            {"type": "sphere", "name": "smoke ball", "center": [1.5, 0.71, 0.1], "radius": 0.7,
             "material": "smoke"},
            {"type": "mesh", "name": "floor", "positions": floor,
             "triangles": [[0, 1, 2], [0, 2, 3]], "material": "floor"},
        ],
        "lights": [
            {"type": "rectangle", "corner": [-5, 2.6, -4], "edge_u": [10, 0, 0],
             "edge_v": [0, 2.4, 3.2], "radiance": [4.5, 4, 3.2]},
        ],
        "environment": {"radiance": [0.4, 0.46, 0.6]},
    }  # fmt: skip


def main() -> None:
    """Write the scene."""
    parser = argparse.ArgumentParser(description="Make media that scatter (scene JSON).")
    parser.add_argument("output", type=Path)
    options = parser.parse_args()
    options.output.write_text(to_text(subsurface()), encoding="utf-8")
    print(options.output)


def to_text(scene: dict[str, Any]) -> str:
    """Return JSON with short arrays on one line, as the Cornell box has it."""
    spec = importlib.util.spec_from_file_location("cornell", ROOT / "make_cornell_box.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["cornell"] = module
    spec.loader.exec_module(module)
    return str(module.to_text(scene))


if __name__ == "__main__":
    main()
