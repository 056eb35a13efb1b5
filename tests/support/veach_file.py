"""Veach's test of multiple importance sampling, read from ../shared/assets/scenes/veach_mis.

Four plates of rising roughness reflect four lamps of falling size and rising radiance (Veach and
Guibas 1995, section 6). The file is for pbrt-v4; what it holds and no more is read: spheres that
shine, meshes in PLY with a diffuse or a coated material.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

FOLDER = Path(__file__).resolve().parents[3] / "shared" / "assets" / "scenes" / "veach_mis"
FILE = FOLDER / "veach-mis.pbrt"
VFOV_DEG = 36.8  # as wide as the file's 28 deg at 4:3, in a square

Scene = dict[str, Any]


def veach_file(size: int) -> Scene:
    """Return the scene, `size` x `size` pixels. Raises FileNotFoundError without the assets."""
    text = FILE.read_text()
    eye, target, up = np.reshape(_numbers(_one(r"LookAt([^A-Z]*)", text)), (3, 3)).tolist()
    materials: dict[str, Scene] = {}
    shapes: list[Scene] = []
    for k, block in enumerate(re.findall(r"AttributeBegin(.*?)AttributeEnd", text, re.DOTALL)):
        name = f"m{k}"
        materials[name] = _material(block)
        shapes.append(_shape(block) | {"material": name})
    return {
        "version": 1,
        "camera": {"type": "pinhole", "origin": eye, "target": target, "up": up,
                   "vfov_deg": VFOV_DEG},
        "film": {"width": size, "height": size},
        "materials": materials,
        "shapes": shapes,
    }  # fmt: skip


def _material(block: str) -> Scene:
    albedo = _values("reflectance", block)
    if "coateddiffuse" in block:
        return {"type": "plastic", "albedo": albedo, "alpha": _values("roughness", block)[0]}
    shines = {"emission": _values("L", block)} if "AreaLightSource" in block else {}
    return {"type": "lambert", "albedo": albedo} | shines


def _shape(block: str) -> Scene:
    if '"sphere"' in block:
        center = _numbers(_one(r"Translate([^A-Z]*)", block))
        return {"type": "sphere", "center": center, "radius": _values("radius", block)[0]}
    head, _, data = (
        (FOLDER / _one(r'filename" \[ "([^"]*)"', block)).read_bytes().partition(b"end_header\n")
    )
    corners = int(_one(r"element vertex (\d+)", head.decode()))
    faces = int(_one(r"element face (\d+)", head.decode()))
    stride = 4 * head.count(b"property float")
    points = np.frombuffer(data, np.uint8, corners * stride).reshape(corners, stride)
    index = np.frombuffer(data, np.dtype([("n", "u1"), ("of", "<i4", 3)]), faces, corners * stride)
    assert set(index["n"]) == {3}, "the file holds triangles"
    positions = np.ascontiguousarray(points[:, :12]).view("<f4").astype(float)
    return {"type": "mesh", "positions": positions.tolist(), "triangles": index["of"].tolist()}


def _one(pattern: str, text: str) -> str:
    found = re.search(pattern, text)
    assert found is not None, f"no {pattern!r} in {FILE}"
    return found[1]


def _values(name: str, block: str) -> list[float]:
    return _numbers(_one(rf'"\w+ {name}" \[([^\]]*)\]', block))


def _numbers(text: str) -> list[float]:
    return [float(word) for word in text.split()]
