"""Small scenes that span what the tracer does, for coverage and unbiasedness.

`twelve(size)` returns documents by name; each takes a fraction of a second at 32 x 32. They are our
own but for `veach_mis`, which is read from ../shared/assets; where that is absent, plates and lamps
of our own stand in.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from film_scenes import interior
from veach_file import FILE, veach_file

Scene = dict[str, Any]
BOX_TRIANGLES = [
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
]  # fmt: skip
GREY = {"type": "lambert", "albedo": 0.5}
SKY = {"radiance": [0.3, 0.4, 0.5]}


def _lamp(corner: list[float], u: float, w: float, radiance: float) -> Scene:
    """A lamp that shines down."""
    return {"type": "rectangle", "corner": corner, "edge_u": [u, 0, 0], "edge_v": [0, 0, w],
            "radiance": radiance}  # fmt: skip


def _quad(corners: list[list[float]], material: str) -> Scene:
    return {"type": "mesh", "positions": corners, "triangles": [[0, 1, 2], [0, 2, 3]],
            "uv": [[0, 0], [1, 0], [1, 1], [0, 1]], "material": material}  # fmt: skip


def _box(low: list[float], high: list[float], material: str) -> Scene:
    corners = [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1])
               for z in (low[2], high[2])]  # fmt: skip
    return {"type": "mesh", "positions": corners, "triangles": BOX_TRIANGLES, "material": material}


def _ball(center: list[float], radius: float, material: str) -> Scene:
    return {"type": "sphere", "center": center, "radius": radius, "material": material}


FLOOR = _quad([[-9, 0, 9], [9, 0, 9], [9, 0, -9], [-9, 0, -9]], "floor")


def _set(
    size: int,
    materials: dict[str, Scene],
    shapes: list[Scene],
    lights: list[Scene],
    environment: Scene | None = None,
) -> Scene:
    """A floor seen slightly from above."""
    document: Scene = {
        "version": 1,
        "camera": {"type": "pinhole", "origin": [0, 1.8, 5], "target": [0, 0.8, 0],
                   "up": [0, 1, 0], "vfov_deg": 36},
        "film": {"width": size, "height": size},
        "materials": {"floor": GREY, **materials},
        "shapes": [*shapes, FLOOR],
        "lights": lights,
    }  # fmt: skip
    return document | ({"environment": environment} if environment else {})


def _veach_mis(size: int) -> Scene:
    if FILE.exists():
        return veach_file(size)
    plates, materials = [], {}
    for k, (y, z, alpha) in enumerate(
        [(0.15, 1.2, 0.005), (0.4, 0.4, 0.02), (0.8, -0.4, 0.08), (1.4, -1.1, 0.2)]
    ):
        name = f"plate{k}"
        materials[name] = {"type": "conductor", "metal": "Ag", "alpha": alpha}
        rise = 0.12 + 0.16 * k
        plates.append(
            _quad([[-1.6, y - rise / 2, z + 0.35], [1.6, y - rise / 2, z + 0.35],
                   [1.6, y + rise / 2, z - 0.35], [-1.6, y + rise / 2, z - 0.35]], name)
        )  # fmt: skip
    shapes = list(plates)
    for k, (x, radius, power) in enumerate([(-1.4, 0.03, 900.0), (-0.5, 0.1, 90.0),
                                            (0.5, 0.25, 14.0), (1.4, 0.5, 3.6)]):  # fmt: skip
        materials[f"lamp{k}"] = {"type": "lambert", "albedo": 0.0, "emission": power}
        shapes.append(_ball([x, 2.6, -1.8], radius, f"lamp{k}"))
    return _set(size, materials, shapes, [], {"radiance": 0.02})


def _glass(size: int, alpha: float) -> Scene:
    ball = {"type": "dielectric", "eta": 1.5, "alpha": alpha}
    lamp = _lamp([-0.4, 4, -0.4], 0.8, 0.8, 60.0)
    return _set(size, {"ball": ball}, [_ball([0, 1, 0], 0.9, "ball")], [lamp], SKY)


def _nested(size: int) -> Scene:
    """Ice in tinted water in a glass, the glass of higher priority where they overlap."""
    materials = {
        "glass": {"type": "dielectric", "eta": 1.5, "sigma_a": [0.3, 0.1, 0.2], "priority": 2},
        "water": {"type": "dielectric", "eta": 1.33, "sigma_a": [1.5, 0.5, 0.2]},
        "ice": {"type": "dielectric", "eta": 1.31, "sigma_a": 0.05, "priority": 1},
    }
    shapes = [
        _box([-0.9, 0.01, -0.9], [0.9, 0.2, 0.9], "glass"),
        _box([-0.8, 0.15, -0.8], [0.8, 1.4, 0.8], "water"),
        _ball([0.2, 1.1, 0.1], 0.4, "ice"),
    ]
    return _set(size, materials, shapes, [_lamp([-1, 4, -1], 2, 2, 10.0)], SKY)


def _exterior(size: int) -> Scene:
    """A sky with a sun of 3 x 3 texels, 3000 times as bright."""
    height, width = 32, 64
    y = np.linspace(1, -1, height)[:, None, None]
    sky = np.broadcast_to(0.3 + 0.7 * np.maximum(y, 0.0), (height, width, 3)) * [0.6, 0.8, 1.0]
    pixels = np.array(sky, np.float32)
    pixels[7:10, 20:23] = 3000.0
    balls = {"red": {"type": "plastic", "albedo": [0.6, 0.1, 0.1], "alpha": 0.15},
             "gold": {"type": "conductor", "metal": "Au", "alpha": 0.25}}  # fmt: skip
    shapes = [_ball([-0.9, 0.8, 0], 0.8, "red"), _ball([0.9, 0.8, 0], 0.8, "gold")]
    return _set(size, balls, shapes, [], {"pixels": pixels})


def _textures(size: int) -> Scene:
    checker = np.kron(np.indices((4, 4)).sum(0) % 2, np.ones((4, 4)))
    leaf = (np.hypot(*(np.indices((16, 16)) - 7.5)) < 6).astype(np.float32)
    materials = {
        "floor": {"type": "lambert", "albedo": {"texture": "checker"}},
        "leaf": {"type": "lambert", "albedo": [0.2, 0.5, 0.1], "opacity": {"texture": "leaf"}},
    }
    shapes = [
        _quad([[x - 0.7, 0.3 + 0.2 * k, z], [x + 0.7, 0.3 + 0.2 * k, z],
               [x + 0.7, 1.7 + 0.2 * k, z - 0.4], [x - 0.7, 1.7 + 0.2 * k, z - 0.4]], "leaf")
        for k, (x, z) in enumerate([(-0.8, 0.6), (0.1, 0.0), (0.9, -0.7)])
    ]  # fmt: skip
    document = _set(size, materials, shapes, [_lamp([-1, 4, 0], 2, 1, 14.0)], SKY)
    both = np.stack([0.1 + 0.7 * checker] * 3, axis=-1)
    document["textures"] = {
        "checker": {"pixels": both.astype(np.float32)},
        "leaf": {"pixels": leaf},
    }
    return document


def _layered(size: int) -> Scene:
    coat = {"type": "layered", "eta": 1.5, "alpha": 0.1}
    materials = {
        "lacquer": coat | {"base": {"type": "conductor", "metal": "Cu", "alpha": 0.3}},
        "varnish": coat | {"sigma_a": [200.0, 600.0, 1500.0], "thickness": 0.001,
                           "base": {"type": "lambert", "albedo": 0.8}},
    }  # fmt: skip
    shapes = [_ball([-0.9, 0.8, 0], 0.8, "lacquer"), _ball([0.9, 0.8, 0], 0.8, "varnish")]
    return _set(size, materials, shapes, [_lamp([-1, 4, -1], 2, 2, 10.0)], SKY)


def _subsurface(size: int) -> Scene:
    """Wax with a smooth surface, and smoke without one, in which the lamp is looked for."""
    wax = {"scattering_albedo": [0.98, 0.9, 0.7], "mean_free_path": [0.2, 0.12, 0.08], "g": 0.3}
    materials = {
        "wax": {"type": "dielectric", "eta": 1.44} | wax,
        "smoke": {"type": "null", "sigma_s": [1.0, 1.5, 2.5], "sigma_a": 0.2, "g": -0.2},
    }
    shapes = [_box([-1.5, 0.02, -0.6], [-0.3, 1.2, 0.6], "wax"), _ball([0.9, 0.9, 0], 0.8, "smoke")]
    return _set(size, materials, shapes, [_lamp([-1, 4, -1], 2, 2, 10.0)], SKY)


def _dispersion(size: int) -> Scene:
    glass = {"type": "dielectric", "eta": [1.50, 1.55, 1.62]}
    block = _box([-0.7, 0.02, -0.7], [0.7, 1.4, 0.7], "glass")
    block["transform"] = [{"rotate_deg": 30, "axis": [0, 1, 0]}]
    return _set(size, {"glass": glass}, [block], [_lamp([-1, 4, -1], 2, 2, 10.0)], SKY)


def _enclosure(size: int) -> Scene:
    """A closed box of albedo 0.95 and a small lamp: a hundred bounces."""
    document = interior(size)
    white = {"type": "lambert", "albedo": 0.95}
    document["materials"] = dict.fromkeys(document["materials"], white)
    front = [[-1, 0, 3.6], [1, 0, 3.6], [1, 2, 3.6], [-1, 2, 3.6]]
    sides = [_quad([[x, 0, 1], [x, 0, 3.6], [x, 2, 3.6], [x, 2, 1]], "white") for x in (-1, 1)]
    sides += [_quad([[-1, y, 1], [1, y, 1], [1, y, 3.6], [-1, y, 3.6]], "white") for y in (0, 2)]
    document["shapes"] += [_quad(front, "white"), *sides]
    document["lights"][0]["radiance"] = 3.0
    return document


def _metals(size: int) -> Scene:
    materials = {
        "gold": {"type": "conductor", "metal": "Au", "alpha": 0.05},
        "brushed": {"type": "conductor", "metal": "Al", "alpha_x": 0.4, "alpha_y": 0.05},
        "rough": {"type": "conductor", "metal": "Cu", "alpha": 0.5, "multiscatter": True},
    }
    shapes = [_ball([1.25 * (k - 1), 0.6, 0], 0.6, name) for k, name in enumerate(materials)]
    return _set(size, materials, shapes, [_lamp([-1, 4, -1], 2, 2, 10.0)], SKY)


def _many_lights(size: int) -> Scene:
    rng = np.random.default_rng(7)
    lights = []
    for _ in range(500):
        x, z = (float(v) for v in rng.uniform(-4, 4, 2))
        lights.append(_lamp([x, float(rng.uniform(1.9, 3.0)), z], 0.1, 0.1,
                            float(rng.lognormal(0.9, 1.0))))  # fmt: skip
    plastic = {"type": "plastic", "albedo": [0.2, 0.3, 0.6], "alpha": 0.2}
    return _set(size, {"ball": plastic}, [_ball([0, 0.9, 0], 0.9, "ball")], lights,
                {"radiance": 0.05})  # fmt: skip


def twelve(size: int = 32) -> dict[str, Scene]:
    """Return the scenes by name, `size` x `size` pixels."""
    return {
        "cornell": interior(size),
        "veach_mis": _veach_mis(size),
        "glass_caustic": _glass(size, 0.0),
        "rough_glass": _glass(size, 0.2),
        "nested": _nested(size),
        "exterior": _exterior(size),
        "textures": _textures(size),
        "layered": _layered(size),
        "dispersion": _dispersion(size),
        "subsurface": _subsurface(size),
        "enclosure": _enclosure(size),
        "metals": _metals(size),
        "many_lights": _many_lights(size),
    }
