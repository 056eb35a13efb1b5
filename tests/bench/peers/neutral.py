"""The six scenes of the comparison, written so that every renderer's worker can read them.

A scene folder holds scene.json and the .npy arrays it names. y is up; lights are rectangles that
emit on the side edge_u x edge_v; `depth` counts scattering events; lat-long maps have +y on top and
-z in the middle; a mesh without normals is flat.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Neutral = dict[str, Any]
ROOT = Path(__file__).resolve().parents[3]
GREY = {"type": "lambert", "albedo": [0.5, 0.5, 0.5]}
METALS = (("Au", 0.05), ("Cu", 0.1), ("Al", 0.2), ("Au", 0.35), ("Cu", 0.6))


def icosphere(levels: int) -> tuple[Array, Array]:
    """Return unit vectors and outward triangles of an icosahedron split `levels` times."""
    g = (1 + 5**0.5) / 2
    points = [(-1, g, 0), (1, g, 0), (-1, -g, 0), (1, -g, 0), (0, -1, g), (0, 1, g)]
    points += [(0, -1, -g), (0, 1, -g), (g, 0, -1), (g, 0, 1), (-g, 0, -1), (-g, 0, 1)]
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4)]
    faces += [(11, 10, 2), (10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8)]
    faces += [(3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]
    vertices, triangles = np.array(points, float), np.array(faces)
    for _ in range(levels):
        edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        pairs, place = np.unique(edges, axis=0, return_inverse=True)
        middle = place.reshape(-1, 3) + len(vertices)
        vertices = np.concatenate([vertices, vertices[pairs].mean(axis=1)])
        a, b, c = triangles.T
        x, y, z = middle.T
        parts = [(a, x, z), (b, y, x), (c, z, y), (x, y, z)]
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    return vertices / np.linalg.norm(vertices, axis=1, keepdims=True), triangles


def ball(centre: list[float], radius: float, material: str, levels: int) -> dict[str, Any]:
    """Return a smooth ball."""
    unit, triangles = icosphere(levels)
    return {
        "positions": np.array(centre) + radius * unit,
        "triangles": triangles,
        "normals": unit,
        "material": material,
    }


def floor(half: float, material: str = "floor") -> dict[str, Any]:
    """Return a square floor at height 0."""
    corners = [[-half, 0, -half], [half, 0, -half], [half, 0, half], [-half, 0, half]]
    return {
        "positions": np.array(corners, float),
        "triangles": np.array([[0, 2, 1], [0, 3, 2]]),
        "normals": None,
        "material": material,
    }


def rough_mesh(rows: int) -> dict[str, Any]:
    """Return a displaced sphere of 2 rows^2 triangles (less the two poles), flat."""
    theta = np.linspace(0, np.pi, rows // 2 + 1)[:, None]
    phi = np.linspace(0, 2 * np.pi, 2 * rows, endpoint=False)[None, :]
    waves = np.sin(9 * theta) * np.cos(7 * phi) + 0.5 * np.sin(31 * theta) * np.sin(23 * phi)
    fine = 0.15 * np.sin(theta) * np.sin(160 * theta) * np.sin(121 * phi)
    radius = 1 + 0.06 * np.sin(theta) * waves + 0.06 * fine
    ring = radius * np.sin(theta)
    xyz = [ring * np.cos(phi), radius * np.cos(theta) + 0 * phi, -ring * np.sin(phi)]
    positions = np.stack(xyz, axis=-1).reshape(-1, 3)
    row, column = np.meshgrid(np.arange(rows // 2), np.arange(2 * rows), indexing="ij")
    a, b = row * 2 * rows + column, row * 2 * rows + (column + 1) % (2 * rows)
    c, d = a + 2 * rows, b + 2 * rows
    upper, lower = np.stack([a, c, b], -1)[1:], np.stack([b, c, d], -1)[:-1]
    triangles = np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)])
    return {
        "positions": positions + np.array([0, 1.15, 0]),
        "triangles": triangles,
        "normals": None,
        "material": "clay",
    }


def environment(assets: Path, name: str) -> Array:
    """Return a lat-long map of the assets, linear Rec.709."""
    import OpenImageIO as oiio

    path = assets / "hdri" / name
    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise FileNotFoundError(f"{path} is not there; give --assets")
    return np.ascontiguousarray(source.read_image("float")[..., :3], dtype=np.float32)


def scene(depth: int, camera: dict[str, Any], **parts: Any) -> Neutral:
    """Return a scene; lights and environment are none unless given."""
    return {"depth": depth, "camera": camera, "lights": [], "environment": 0.0, **parts}


def looking(origin: list[float], target: list[float], vfov_deg: float) -> dict[str, Any]:
    """Return a camera."""
    return {"origin": origin, "target": target, "vfov_deg": vfov_deg}


def cornell(assets: Path) -> Neutral:
    """Return the diffuse Cornell box of the examples."""
    del assets
    document = json.loads((ROOT / "examples/scenes/cornell.json").read_text(encoding="utf-8"))
    camera = {key: document["camera"][key] for key in ("origin", "target", "vfov_deg")}
    meshes = [
        {
            "positions": np.array(shape["positions"], float),
            "triangles": np.array(shape["triangles"]),
            "normals": None,
            "material": shape["material"],
        }
        for shape in document["shapes"]
    ]
    keys = ("corner", "edge_u", "edge_v", "radiance")
    lights = [{key: light[key] for key in keys} for light in document["lights"]]
    return scene(8, camera, materials=document["materials"], meshes=meshes, lights=lights)


def metals(assets: Path) -> Neutral:
    """Return balls of GGX conductors of five alphas under a studio map."""
    import matiere as mt

    table = mt.metals()
    materials: dict[str, Any] = {"floor": GREY}
    meshes = [floor(6)]
    for number, (metal, alpha) in enumerate(METALS):
        eta, k = (table[metal][key] for key in ("eta", "k"))
        name = f"metal{number}"
        materials[name] = {"type": "conductor", "eta": eta, "k": k, "alpha": alpha}
        back = number % 2
        meshes.append(ball([1.1 * (number - 2), 0.7, -1.3 * back], 0.7, name, 5))
    camera = looking([0, 2.6, 6.5], [0, 0.6, -0.5], 50)
    sky = environment(assets, "studio_small_03_1k.hdr")
    return scene(6, camera, materials=materials, meshes=meshes, environment=sky)


def glass(assets: Path) -> Neutral:
    """Return a glass ball whose caustic falls on a floor, under one lamp."""
    del assets
    materials = {"floor": GREY, "glass": {"type": "dielectric", "eta": 1.5}}
    lamp = {"corner": [-2.4, 4, -0.4], "edge_u": [0.8, 0, 0], "edge_v": [0, 0, 0.8]}
    return scene(
        8,
        looking([0, 2.4, 5], [0.3, 0.6, 0], 36),
        materials=materials,
        meshes=[floor(6), ball([0, 1, 0], 0.9, "glass", 6)],
        lights=[{**lamp, "radiance": [40.0, 36.0, 30.0]}],
    )


def plastic(assets: Path) -> Neutral:
    """Return smooth plastic balls under a lamp and a dim sky."""
    del assets
    colours = ([0.6, 0.1, 0.1], [0.7, 0.7, 0.7], [0.05, 0.2, 0.5])
    materials: dict[str, Any] = {"floor": GREY}
    meshes = [floor(6)]
    for number, albedo in enumerate(colours):
        name = f"plastic{number}"
        materials[name] = {"type": "plastic", "albedo": albedo, "eta": 1.5, "alpha": 0}
        meshes.append(ball([1.6 * (number - 1), 0.75, 0], 0.75, name, 5))
    lamp = {"corner": [-1, 4, 0], "edge_u": [2, 0, 0], "edge_v": [0, 0, 2]}
    return scene(
        8,
        looking([0, 2.2, 6], [0, 0.6, 0], 36),
        materials=materials,
        meshes=meshes,
        lights=[{**lamp, "radiance": [8.0, 7.5, 7.0]}],
        environment=0.3,
    )


def mesh(assets: Path) -> Neutral:
    """Return a displaced sphere of a million triangles under a map of a square."""
    return scene(
        5,
        looking([0, 2.2, 5], [0, 1.1, 0], 36),
        materials={"floor": GREY, "clay": {"type": "lambert", "albedo": [0.7, 0.6, 0.5]}},
        meshes=[floor(6), rough_mesh(708)],
        environment=environment(assets, "potsdamer_platz_1k.hdr"),
    )


def lamps(assets: Path) -> Neutral:
    """Return 500 small lamps of many colours above blocks on a floor."""
    del assets
    rng = np.random.default_rng(500)
    lights = []
    for _ in range(500):
        x, z = rng.uniform(-5, 5, 2)
        y, side = rng.uniform(1.2, 2.4), 0.06
        radiance = (rng.uniform(0.2, 1, 3) * 2 ** rng.uniform(3, 7)).round(3).tolist()
        corner = [round(float(v), 4) for v in (x, y, z)]
        edges = {"edge_u": [side, 0, 0], "edge_v": [0, 0, side]}
        lights.append({"corner": corner, **edges, "radiance": radiance})
    meshes = [floor(6)]
    for _ in range(12):
        x, z = rng.uniform(-4, 4, 2)
        meshes.append(ball([float(x), 0.45, float(z)], 0.45, "ball", 4))
    ivory = {"type": "lambert", "albedo": [0.7, 0.65, 0.55]}
    return scene(
        4,
        looking([0, 5, 9], [0, 0.4, 0], 40),
        materials={"floor": GREY, "ball": ivory},
        meshes=meshes,
        lights=lights,
    )


SCENES: dict[str, Callable[[Path], Neutral]] = {
    "cornell": cornell,
    "metals": metals,
    "glass": glass,
    "plastic": plastic,
    "mesh": mesh,
    "lamps": lamps,
}


def write(name: str, assets: Path, size: int, folder: Path) -> str:
    """Write a scene's folder and return its JSON text."""
    neutral = {"name": name, "size": size, **SCENES[name](assets)}
    folder.mkdir(parents=True, exist_ok=True)
    for number, mesh_ in enumerate(neutral["meshes"]):
        for key in ("positions", "triangles", "normals"):
            if mesh_[key] is not None:
                file = f"{number}-{key}.npy"
                kind = np.int32 if key == "triangles" else np.float32
                np.save(folder / file, np.asarray(mesh_[key], kind))
                mesh_[key] = file
    if isinstance(neutral["environment"], np.ndarray):
        np.save(folder / "environment.npy", neutral["environment"])
        neutral["environment"] = "environment.npy"
    text = json.dumps(neutral, indent=1)
    (folder / "scene.json").write_text(text, encoding="utf-8")
    return text
