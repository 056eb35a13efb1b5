"""matiere as one of the renderers of the comparison."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from worker import Image, Neutral, Render, serve

import matiere as mt


def document(scene: Neutral) -> dict[str, Any]:
    """Return the neutral scene as matiere's."""
    environment = scene["environment"]
    if isinstance(environment, float | int):
        environment = {"radiance": environment} if environment else None
    else:
        environment = {"pixels": environment}
    meshes = [
        {"type": "mesh", **{key: value for key, value in mesh.items() if value is not None}}
        for mesh in scene["meshes"]
    ]
    return {
        "version": 1,
        "camera": {"type": "pinhole", **scene["camera"]},
        "film": {"width": scene["size"], "height": scene["size"], "filter": "box"},
        "render": {"max_depth": scene["depth"]},
        "materials": scene["materials"],
        "shapes": meshes,
        "lights": [{"type": "rectangle", **light} for light in scene["lights"]],
        "environment": environment,
    }


def build(neutral: Neutral, threads: int) -> tuple[Render, str]:
    """Build the scene; seconds are the film's own wall clock of the pass loop."""
    told = document(neutral)
    if len(sys.argv) > 4:
        told["render"]["replicates"] = int(sys.argv[4])
    scene = mt.load(told)
    scene.build(threads)

    def render(spp: int, seed: int) -> tuple[Image, dict[str, Any]]:
        film = mt.render(scene, spp=spp, seed=seed, threads=threads)
        report = film.report
        facts = {
            "seconds": float(report["wall_s"]),
            "spp": film.spp,
            "rays": int(report["rays"]),
            "kernel": report["kernel"]["name"],
            "replicates": film.replicates,
            "claimed_relmse": report["error"]["relmse"],
        }
        return np.asarray(film.mean, np.float32), facts

    return render, mt.__version__


if __name__ == "__main__":
    serve(build)
