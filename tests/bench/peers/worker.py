"""What the workers of all renderers share: the neutral scene and the loop that answers the driver.

A worker is one process with one scene and one renderer. It is started as
`python NAME_worker.py SCENE_FOLDER THREADS FD [VARIANT]`, builds the scene, writes one line of JSON
to FD, and then for each line {"spp", "seed", "out"} on stdin renders, saves the picture (height,
width, RGB; float32; top row first) to `out` and writes one line to FD: {"seconds", "spp", ...}.
Only numpy and the renderer are imported here: the renderers live in an environment of their own.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Image = npt.NDArray[np.float32]
Neutral = dict[str, Any]
Render = Callable[[int, int], tuple[Image, dict[str, Any]]]


def read_scene(folder: Path) -> Neutral:
    """Return the neutral scene of a folder, with the arrays its meshes and environment name."""
    scene: Neutral = json.loads((folder / "scene.json").read_text(encoding="utf-8"))
    for mesh in scene["meshes"]:
        for key in ("positions", "triangles", "normals"):
            if mesh.get(key):
                mesh[key] = np.load(folder / mesh[key])
    environment = scene["environment"]
    if isinstance(environment, str):
        scene["environment"] = np.load(folder / environment)
    return scene


def body_albedo(albedo: list[float], eta: float) -> list[float]:
    """Return what leaves the body of a smooth plastic per unit of light that entered it.

    For renderers whose plastic lacks the internal reflection: rho (1 - Fi) / (1 - rho Fi), with the
    hemispherical Fresnel reflectance from inside, Fi = 1 - (1 - Fe) / eta^2 (Egan & Hilgeman 1973).
    """
    cosine = (np.arange(20000) + 0.5) / 20000
    inner = np.sqrt(1 - (1 - cosine**2) / eta**2)
    parallel = (eta * cosine - inner) / (eta * cosine + inner)
    across = (cosine - eta * inner) / (cosine + eta * inner)
    outer = float(((parallel**2 + across**2) * cosine).mean())  # integral of 2 F cos dcos, F = mean
    fi = 1 - (1 - outer) / eta**2
    return [rho * (1 - fi) / (1 - rho * fi) for rho in albedo]


def rectangle(light: dict[str, Any]) -> tuple[Array, Array]:
    """Return the four corners and two triangles of a rectangle light, seen from its bright side."""
    corner, u, v = (np.array(light[key], float) for key in ("corner", "edge_u", "edge_v"))
    positions = np.array([corner, corner + u, corner + u + v, corner + v])
    return positions, np.array([[0, 1, 2], [0, 2, 3]])


def serve(build: Callable[[Neutral, int], tuple[Render, str]]) -> None:
    """Build the scene of the command line and answer the driver until it closes stdin."""
    scene = read_scene(Path(sys.argv[1]))
    with os.fdopen(int(sys.argv[3]), "w") as answers:
        render, version = build(scene, int(sys.argv[2]))
        print(json.dumps({"version": version}), file=answers, flush=True)
        for line in sys.stdin:
            order = json.loads(line)
            image, facts = render(int(order["spp"]), int(order["seed"]))
            np.save(order["out"], np.ascontiguousarray(image, dtype=np.float32))
            print(json.dumps(facts), file=answers, flush=True)
