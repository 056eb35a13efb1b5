"""Mitsuba 3, variants `scalar_rgb` and `llvm_ad_rgb`, as one of the renderers.

Its `path` integrator counts the emission seen directly as depth 1; its opaque BSDFs are one-sided,
so they are wrapped in `twosided`; the middle of its lat-long maps is where matiere's ends are.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from worker import Array, Image, Neutral, Render, rectangle, serve

MOST_PATHS = 2**22  # of one render of an LLVM variant: a few hundred bytes each
SEED_STEP = 1_000_003  # between the parts of a render


def bsdf(material: dict[str, Any]) -> dict[str, Any]:
    """Return the plugin of a material."""

    def colour(value: Any) -> dict[str, Any]:
        return {"type": "rgb", "value": list(np.broadcast_to(value, 3))}

    kind = material["type"]
    if kind == "dielectric":
        return {"type": "dielectric", "int_ior": material["eta"], "ext_ior": 1.0}
    inner: dict[str, Any] = {"type": "diffuse"}
    if kind == "lambert":
        inner["reflectance"] = colour(material["albedo"])
    elif kind == "conductor":
        inner = {
            "type": "roughconductor",
            "distribution": "ggx",
            "alpha": material["alpha"],
            "eta": colour(material["eta"]),
            "k": colour(material["k"]),
        }
    elif kind == "plastic":
        inner = {
            "type": "plastic",
            "nonlinear": True,
            "int_ior": material["eta"],
            "ext_ior": 1.0,
            "diffuse_reflectance": colour(material["albedo"]),
        }
    return {"type": "twosided", "bsdf": inner}


def shape(
    positions: Array, triangles: Array, normals: Array | None, plugins: dict[str, Any]
) -> Any:
    """Return a triangle mesh with the given BSDF or emitter."""
    props = mi.Properties()
    for key, plugin in plugins.items():
        props[key] = mi.load_dict(plugin) if isinstance(plugin, dict) else plugin
    mesh = mi.Mesh("mesh", len(positions), len(triangles), props, normals is not None)
    params = mi.traverse(mesh)
    params["vertex_positions"] = np.asarray(positions, np.float32).ravel()
    params["faces"] = np.asarray(triangles, np.uint32).ravel()
    if normals is not None:
        params["vertex_normals"] = np.asarray(normals, np.float32).ravel()
    params.update()
    return mesh


def lamp(light: dict[str, Any]) -> Any:
    """Return a rectangle light: two black triangles that emit."""
    radiance = list(np.broadcast_to(light["radiance"], 3))
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    emitter = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
    return shape(*rectangle(light), None, {"bsdf": black, "emitter": emitter})


def world(scene: Neutral) -> dict[str, Any]:
    """Return the scene as Mitsuba's dictionary."""
    camera, size = scene["camera"], scene["size"]
    look = mi.ScalarTransform4f().look_at(camera["origin"], camera["target"], [0, 1, 0])
    film = {"type": "hdrfilm", "width": size, "height": size, "pixel_format": "rgb"}
    result: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": scene["depth"] + 1},
        "sensor": {
            "type": "perspective",
            "fov": camera["vfov_deg"],
            "fov_axis": "y",
            "to_world": look,
            "film": {**film, "rfilter": {"type": "box"}, "component_format": "float32"},
            "sampler": {"type": "multijitter"},
        },
    }
    made = {name: mi.load_dict(bsdf(m)) for name, m in scene["materials"].items()}
    for number, mesh in enumerate(scene["meshes"]):
        plugins = {"bsdf": made[mesh["material"]]}
        arrays = (mesh[key] for key in ("positions", "triangles", "normals"))
        result[f"mesh{number}"] = shape(*arrays, plugins)
    for number, light in enumerate(scene["lights"]):
        result[f"lamp{number}"] = lamp(light)
    environment = scene["environment"]
    if isinstance(environment, np.ndarray):
        turned = np.roll(environment, environment.shape[1] // 2, axis=1)
        result["environment"] = {"type": "envmap", "bitmap": mi.Bitmap(turned)}
    elif environment:
        result["environment"] = {
            "type": "constant",
            "radiance": {"type": "rgb", "value": float(environment)},
        }
    return result


def build(neutral: Neutral, threads: int) -> tuple[Render, str]:
    """Build the scene; seconds are those of mi.render until the pixels are in memory.

    LLVM variants keep every path of a render in memory, so theirs are split into parts; their
    kernels are compiled before the clock starts.
    """
    dr.set_thread_count(threads)
    mi.set_log_level(mi.LogLevel.Error)
    scene = mi.load_dict(world(neutral))
    compiled = mi.variant().startswith("llvm")
    warm: set[int] = set()

    def render(spp: int, seed: int) -> tuple[Image, dict[str, Any]]:
        part = min(spp, MOST_PATHS // neutral["size"] ** 2) if compiled else spp
        parts = -(-spp // part)
        if compiled and part not in warm:
            np.array(mi.render(scene, spp=part, seed=seed + SEED_STEP // 2))
            warm.add(part)
        begun = time.perf_counter()
        total = np.zeros((neutral["size"], neutral["size"], 3))
        for number in range(parts):
            total += np.array(mi.render(scene, spp=part, seed=seed + number * SEED_STEP))
        facts = {"seconds": time.perf_counter() - begun, "spp": part * parts}
        return (total / parts).astype(np.float32), facts

    return render, str(mi.__version__)


if __name__ == "__main__":
    mi.set_variant(sys.argv[4])
    serve(build)
