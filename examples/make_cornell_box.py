"""Make the Cornell box as a scene JSON with inline geometry.

    python examples/make_cornell_box.py cornell.json

The room's measures are those of the Cornell Program of Computer Graphics (millimetres there,
decimetres here), turned so that the camera looks along -z and the red wall is on the left.  Walls
are Rec.709 approximations of the measured paints.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

Point = tuple[float, float, float]
Quad = tuple[Point, Point, Point, Point]

DECIMETRES = 0.01  # one unit of the scene is 0.1 m
CENTER_X = 278.0

FLOOR: Quad = ((552.8, 0, 0), (0, 0, 0), (0, 0, 559.2), (549.6, 0, 559.2))
CEILING: Quad = ((556, 548.8, 0), (556, 548.8, 559.2), (0, 548.8, 559.2), (0, 548.8, 0))
BACK: Quad = ((549.6, 0, 559.2), (0, 0, 559.2), (0, 548.8, 559.2), (556, 548.8, 559.2))
GREEN: Quad = ((0, 0, 559.2), (0, 0, 0), (0, 548.8, 0), (0, 548.8, 559.2))
RED: Quad = ((552.8, 0, 0), (549.6, 0, 559.2), (556, 548.8, 559.2), (556, 548.8, 0))
SHORT_TOP: Quad = ((130, 165, 65), (82, 165, 225), (240, 165, 272), (290, 165, 114))
TALL_TOP: Quad = ((423, 330, 247), (265, 330, 296), (314, 330, 456), (472, 330, 406))
LAMP_CORNER, LAMP_WIDTH, LAMP_DEPTH = (343.0, 548.7, 332.0), 130.0, 105.0
LAMP_RADIANCE = (17.0, 12.0, 4.0)  # W/m^2/sr


def placed(point: Sequence[float]) -> list[float]:
    """Turn a measured point (mm, camera looking along +z) into the scene's frame."""
    x, y, z = ((CENTER_X - point[0]), point[1], -point[2])
    return [round(v * DECIMETRES, 6) + 0.0 for v in (x, y, z)]


def block(top: Quad) -> list[Quad]:
    """Return top and four sides of an upright block."""
    sides = []
    for a, b in zip(top, (*top[1:], top[0]), strict=True):
        sides.append((a, (a[0], 0.0, a[2]), (b[0], 0.0, b[2]), b))
    return [top, *sides]


def mesh(name: str, quads: Sequence[Quad], material: str) -> dict[str, Any]:
    """Return an inline mesh of quads."""
    positions = [placed(corner) for quad in quads for corner in quad]
    triangles = []
    for first in range(0, 4 * len(quads), 4):
        triangles += [[first, first + 1, first + 2], [first, first + 2, first + 3]]
    return {
        "type": "mesh",
        "name": name,
        "positions": positions,
        "triangles": triangles,
        "material": material,
    }


def cornell_box(width: int = 256, spp: int = 64) -> dict[str, Any]:
    """Return the scene (version 1) as a plain dict."""
    corner = placed(LAMP_CORNER)
    return {
        "version": 1,
        "camera": {
            "type": "pinhole",
            "origin": [0.0, 2.73, 8.0],
            "target": [0.0, 2.73, 0.0],
            "vfov_deg": 39.3,
        },
        "film": {"width": width, "height": width},
        "render": {"spp": spp},
        "materials": {
            "white": {"type": "lambert", "albedo": [0.73, 0.73, 0.73]},
            "red": {"type": "lambert", "albedo": [0.63, 0.06, 0.05]},
            "green": {"type": "lambert", "albedo": [0.14, 0.45, 0.09]},
        },
        "shapes": [
            mesh("room", [FLOOR, CEILING, BACK], "white"),
            mesh("right wall", [GREEN], "green"),
            mesh("left wall", [RED], "red"),
            mesh("short block", block(SHORT_TOP), "white"),
            mesh("tall block", block(TALL_TOP), "white"),
        ],
        "lights": [
            {
                "type": "rectangle",
                "corner": corner,
                "edge_u": [round(LAMP_WIDTH * DECIMETRES, 6), 0.0, 0.0],
                "edge_v": [0.0, 0.0, round(LAMP_DEPTH * DECIMETRES, 6)],
                "radiance": list(LAMP_RADIANCE),
            }
        ],
        "output": {"exposure": 1.5},
    }


def to_text(scene: dict[str, Any]) -> str:
    """Return JSON with short arrays on one line."""
    text = json.dumps(scene, indent=1)
    for _ in range(2):
        text = re.sub(
            r"\[\s+([^\[\]{}]*?)\s+\]", lambda m: "[" + " ".join(m.group(1).split()) + "]", text
        )
    return text + "\n"


def main() -> None:
    """Write the scene."""
    parser = argparse.ArgumentParser(description="Make the Cornell box (scene JSON).")
    parser.add_argument("output", type=Path)
    parser.add_argument("--width", type=int, default=256)
    parser.add_argument("--spp", type=int, default=64)
    options = parser.parse_args()
    options.output.write_text(to_text(cornell_box(options.width, options.spp)), encoding="utf-8")
    print(options.output)


if __name__ == "__main__":
    main()
