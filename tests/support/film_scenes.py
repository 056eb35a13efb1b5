"""Small scenes for measurements of the error estimate: diffuse, metal, glass, interior."""

from __future__ import annotations

from typing import Any

Scene = dict[str, Any]

_FLOOR = {
    "type": "mesh",
    "positions": [[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]],
    "triangles": [[0, 2, 1], [0, 3, 2]],
    "material": "floor",
}
_LAMP = {
    "type": "rectangle",
    "corner": [-1, 4, -1],
    "edge_u": [2, 0, 0],
    "edge_v": [0, 0, 2],
    "radiance": [10, 9, 8],
}


def _studio(size: int, ball: Scene, environment: list[float]) -> Scene:
    return {
        "version": 1,
        "camera": {"type": "pinhole", "origin": [0, 1.6, 5], "target": [0, 0.9, 0],
                   "up": [0, 1, 0], "vfov_deg": 35},
        "film": {"width": size, "height": size},
        "materials": {"ball": ball, "floor": {"type": "lambert", "albedo": [0.5, 0.45, 0.4]}},
        "shapes": [
            {"type": "sphere", "center": [0, 1, 0], "radius": 1, "material": "ball"}, _FLOOR],
        "lights": [_LAMP],
        "environment": {"radiance": environment},
    }  # fmt: skip


def _quad(a: list[float], b: list[float], c: list[float], d: list[float], material: str) -> Scene:
    return {"type": "mesh", "positions": [a, b, c, d], "triangles": [[0, 1, 2], [0, 2, 3]],
            "material": material}  # fmt: skip


def interior(size: int) -> Scene:
    """A closed box lit through the ceiling lamp: several bounces of indirect light."""
    return {
        "version": 1,
        "camera": {"type": "pinhole", "origin": [0, 1, 3.4], "target": [0, 1, 0],
                   "up": [0, 1, 0], "vfov_deg": 40},
        "film": {"width": size, "height": size},
        "materials": {"white": {"type": "lambert", "albedo": 0.73},
                      "red": {"type": "lambert", "albedo": [0.65, 0.05, 0.05]},
                      "green": {"type": "lambert", "albedo": [0.12, 0.45, 0.15]}},
        "shapes": [
            _quad([-1, 0, -1], [-1, 0, 1], [1, 0, 1], [1, 0, -1], "white"),
            _quad([-1, 2, -1], [1, 2, -1], [1, 2, 1], [-1, 2, 1], "white"),
            _quad([-1, 0, -1], [1, 0, -1], [1, 2, -1], [-1, 2, -1], "white"),
            _quad([-1, 0, -1], [-1, 2, -1], [-1, 2, 1], [-1, 0, 1], "red"),
            _quad([1, 0, -1], [1, 0, 1], [1, 2, 1], [1, 2, -1], "green"),
            {"type": "sphere", "center": [-0.4, 0.4, -0.3], "radius": 0.4, "material": "white"},
        ],
        "lights": [{"type": "rectangle", "corner": [-0.25, 1.99, -0.25], "edge_u": [0.5, 0, 0],
                    "edge_v": [0, 0, 0.5], "radiance": [17, 12, 4]}],
    }  # fmt: skip


def scenes(size: int = 64) -> dict[str, Scene]:
    """Return the scenes by name, `size` x `size` pixels."""
    return {
        "diffuse": _studio(size, {"type": "lambert", "albedo": 0.7}, [0.3, 0.4, 0.5]),
        "metal": _studio(size, {"type": "conductor", "metal": "Au", "alpha": 0.2}, [0.3, 0.4, 0.5]),
        "glass": _studio(size, {"type": "dielectric", "eta": 1.5}, [0.1, 0.12, 0.15]),
        "interior": interior(size),
    }
