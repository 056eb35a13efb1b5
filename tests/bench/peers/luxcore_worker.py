"""LuxCore, engine PATHCPU with the Sobol sampler, as one of the renderers.

It counts the emission seen directly as depth 1. Its metal2 has Schlick's (1994) distribution, which
with roughness alpha^2 is that of GGX, but Schlick's masking; its plastic is glossy2: Schlick's coat
over a body, here with the light the internal reflections leave.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pyluxcore
from worker import Array, Image, Neutral, Render, body_albedo, rectangle, serve

SHARP = 0.005  # alpha of the glossy2 that stands for a smooth coat


def triple(value: Any) -> list[float]:
    """Return a colour as three floats."""
    return [float(x) for x in np.broadcast_to(value, 3)]


def material(name: str, m: dict[str, Any]) -> dict[str, Any]:
    """Return the properties of a material."""
    key, kind = f"scene.materials.{name}", m["type"]
    if kind == "dielectric":
        return {f"{key}.type": "glass", f"{key}.interiorior": m["eta"], f"{key}.exteriorior": 1.0}
    if kind == "conductor":
        texture = f"scene.textures.{name}"
        return {
            f"{texture}.type": "fresnelconst",
            f"{texture}.n": triple(m["eta"]),
            f"{texture}.k": triple(m["k"]),
            f"{key}.type": "metal2",
            f"{key}.fresnel": name,
            f"{key}.uroughness": m["alpha"],
            f"{key}.vroughness": m["alpha"],
        }
    if kind == "plastic":
        return {
            f"{key}.type": "glossy2",
            f"{key}.kd": body_albedo(triple(m["albedo"]), m["eta"]),
            f"{key}.ks": [1.0, 1.0, 1.0],  # times the reflectance of the index
            f"{key}.index": m["eta"],
            f"{key}.uroughness": SHARP,
            f"{key}.vroughness": SHARP,
            f"{key}.multibounce": False,
        }
    return {f"{key}.type": "matte", f"{key}.kd": triple(m["albedo"])}


def properties(values: dict[str, Any]) -> Any:
    """Return LuxCore properties of a dictionary."""
    props = pyluxcore.Properties()
    for key, value in values.items():
        props.Set(pyluxcore.Property(key, value))
    return props


def add_mesh(scene: Any, name: str, arrays: list[Array | None], surface: str) -> None:
    """Define a mesh and the object that shows it."""
    positions, triangles, normals = arrays
    points = np.ascontiguousarray(positions, np.float32)
    faces = np.ascontiguousarray(triangles, np.uint32)
    shading = None if normals is None else np.ascontiguousarray(normals, np.float32)
    scene.DefineMeshExt(f"mesh-{name}", points, faces, normals=shading)
    key = f"scene.objects.{name}"
    scene.Parse(properties({f"{key}.shape": f"mesh-{name}", f"{key}.material": surface}))


def add_environment(scene: Any, environment: Any) -> None:
    """Define the environment; LuxCore's maps have z up and u the other way round."""
    key = "scene.lights.environment"
    if not isinstance(environment, np.ndarray):
        if environment:
            scene.Parse(
                properties({f"{key}.type": "constantinfinite", f"{key}.color": triple(environment)})
            )
        return
    height, width, _ = environment.shape
    turned = np.roll(environment[:, ::-1], -width // 4, axis=1)
    pixels = np.ascontiguousarray(turned, np.float32)
    scene.DefineImageMap("map", pixels.ravel(), 1.0, 3, width, height)
    turn = [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1]  # four columns
    scene.Parse(
        properties(
            {
                f"{key}.type": "infinite",
                f"{key}.file": "map",
                f"{key}.gamma": 1.0,
                f"{key}.transformation": [float(x) for x in turn],
            }
        )
    )


def world(neutral: Neutral) -> Any:
    """Return the scene."""
    scene = pyluxcore.Scene()
    camera = neutral["camera"]
    low = 2 / neutral["size"]  # LuxCore's camera looks one pixel too high
    scene.Parse(
        properties(
            {
                "scene.camera.type": "perspective",
                "scene.camera.lookat.orig": triple(camera["origin"]),
                "scene.camera.lookat.target": triple(camera["target"]),
                "scene.camera.up": [0.0, 1.0, 0.0],
                "scene.camera.fieldofview": float(camera["vfov_deg"]),
                "scene.camera.screenwindow": [-1.0, 1.0, -1.0 - low, 1.0 - low],
                "scene.camera.lensradius": 0.0,
                "scene.camera.autofocus.enable": False,
            }
        )
    )
    for name, m in neutral["materials"].items():
        scene.Parse(properties(material(name, m)))
    for number, mesh in enumerate(neutral["meshes"]):
        arrays = [mesh[key] for key in ("positions", "triangles", "normals")]
        add_mesh(scene, f"shape{number}", arrays, mesh["material"])
    for number, light in enumerate(neutral["lights"]):
        key = f"scene.materials.lamp{number}"
        values = {".type": "matte", ".kd": [0.0] * 3, ".emission": triple(light["radiance"])}
        scene.Parse(properties({key + end: value for end, value in values.items()}))
        add_mesh(scene, f"lamp{number}", [*rectangle(light), None], f"lamp{number}")
    add_environment(scene, neutral["environment"])
    return scene


def settings(neutral: Neutral, threads: int, spp: int, seed: int) -> dict[str, Any]:
    """Return the properties of a render: no clamping, no adaptive sampling, box filter."""
    depth = neutral["depth"] + 1
    ends = ("total", "diffuse", "glossy", "specular")
    return {
        "renderengine.type": "PATHCPU",
        "renderengine.seed": seed,
        "native.threads.count": threads,
        "sampler.type": "SOBOL",
        "sampler.sobol.adaptive.strength": 0.0,
        **{f"path.pathdepth.{end}": depth for end in ends},
        "path.clamping.variance.maxvalue": 0.0,
        "film.width": neutral["size"],
        "film.height": neutral["size"],
        "film.filter.type": "BOX",
        "film.filter.width": 0.5,
        "film.outputs.0.type": "RGB",
        "film.outputs.0.filename": "unused.exr",
        "batch.haltspp": spp,
    }


def build(neutral: Neutral, threads: int) -> tuple[Render, str]:
    """Build the scene; seconds run from LuxCore's first sample, by its own clock."""
    pyluxcore.Init(lambda text: None)
    scene = world(neutral)
    size = neutral["size"]

    def render(spp: int, seed: int) -> tuple[Image, dict[str, Any]]:
        config = pyluxcore.RenderConfig(properties(settings(neutral, threads, spp, seed)), scene)
        session = pyluxcore.RenderSession(config)
        session.Start()
        while not session.HasDone():
            time.sleep(0.01)
            session.UpdateStats()
        session.Stop()
        stats = session.GetStats()
        image = np.empty((size, size, 3), np.float32)
        session.GetFilm().GetOutputFloat(pyluxcore.FilmOutputType.RGB, image)
        samples = float(stats.Get("stats.renderengine.total.samplecount").GetFloat())
        facts = {
            "seconds": float(stats.Get("stats.renderengine.time").GetFloat()),
            "spp": samples / size**2,
        }
        return image[::-1], facts

    return render, str(pyluxcore.Version())


if __name__ == "__main__":
    serve(build)
