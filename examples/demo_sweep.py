"""The scenes of the demo: a shader ball, a light, and 24 materials to put on the ball.

Six columns (metals with measured constants, plastics, tinted glass) by four rows of roughness go
to the service as one `zip` sweep: whole material objects for the pointer `/materials/ball`, and the
samples per pixel that each needs.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import make_shader_ball
import make_studio_light

Material = dict[str, Any]

ROUGHNESS = (0.02, 0.12, 0.28, 0.5)  # alpha of each row
MATERIALS: tuple[tuple[str, Material], ...] = (
    ("gold", {"type": "conductor", "metal": "Au"}),
    ("copper", {"type": "conductor", "metal": "Cu"}),
    ("chromium", {"type": "conductor", "metal": "Cr"}),
    ("red plastic", {"type": "plastic", "albedo": [0.56, 0.035, 0.03]}),
    ("teal plastic", {"type": "plastic", "albedo": [0.02, 0.27, 0.29]}),
    ("green glass", {"type": "dielectric", "eta": 1.5, "sigma_a": [2.1, 0.45, 1.5]}),
)
OWN_BALL, OWN_GLASS_BALL = "shader_ball.glb", "glass_ball.glb"
GLASS_FACTOR = 4  # light focused by glass is the hardest part of the picture
HDR_MAPS = (  # file, exposure in stops
    ("studio_small_03_1k.hdr", -1.0),
    ("potsdamer_platz_1k.hdr", 0.3),
    ("kloppenheim_05_1k.hdr", 0.0),
    ("blender_city.exr", 0.0),
    ("blender_courtyard.exr", 0.3),
    ("irradiance_table_mountain_256.hdr", 0.0),
    ("irradiance_san_giuseppe_bridge_256.hdr", 0.0),
)


@dataclass(frozen=True)
class Study:
    """One sweep: its base scene, the folder of the scene's files, and what to call it."""

    name: str
    title: str
    base: dict[str, Any]
    folder: Path
    glass_file: str | None = None


def axes(spp: int, glass_file: str | None = None) -> list[dict[str, Any]]:
    """Return the axes of the zip: the ball's material, samples per pixel, and the ball's file.

    `glass_file`, if given, is the mesh that glass takes instead of the first shape's.
    """
    cells = [(name, material, alpha) for alpha in ROUGHNESS for name, material in MATERIALS]
    counts = [spp * (GLASS_FACTOR if m["type"] == "dielectric" else 1) for _, m, _ in cells]
    made: list[dict[str, Any]] = [
        {
            "pointer": "/materials/ball",
            "label": "material",
            "values": [{**material, "alpha": alpha} for _, material, alpha in cells],
            "labels": [f"{name}, alpha {alpha:g}" for name, _, alpha in cells],
        },
        {
            "pointer": "/render/spp",
            "label": "samples",
            "values": counts,
            "labels": [""] * len(counts),
        },
    ]
    if glass_file is not None:
        files = [glass_file if m["type"] == "dielectric" else OWN_BALL for _, m, _ in cells]
        nameless = [""] * len(files)
        made.append(
            {"pointer": "/shapes/0/file", "label": "file", "values": files, "labels": nameless}
        )
    return made


def own_study(folder: Path, size: int, spp: int) -> Study:
    """Make the project's own ball, stage and light, and the scene that shows them."""
    make_shader_ball.write(folder, level=3)
    make_studio_light.write(folder / "studio.exr", make_studio_light.studio_light())
    camera = {"origin": [0.0, 2.35, 7.2], "target": [0.0, 1.02, 0.0], "vfov_deg": 22.0}
    ball = {"file": OWN_BALL, "materials": {"Shell": "ball", "Base": "base", "*": "core"}}
    shapes = [ball, {"file": "stage.glb", "materials": {"Ground": "ground", "Tile": "tile"}}]
    title = "Shader ball under the studio light"
    base = scene(camera, shapes, ("studio.exr", 0.3), size, spp)
    return Study("studio", title, base, folder, OWN_GLASS_BALL)


def asset_studies(assets: Path, folder: Path, size: int, spp: int) -> list[Study]:
    """Return the same sweep on two well-known balls under each real HDR map.

    Raises:
        FileNotFoundError: if the folder lacks one of the files.
    """
    meshes = assets / "meshes"
    standard = meshes / "standard_shader_ball"
    copy(
        [
            meshes / "materialx_shaderball.glb",
            standard / "openpbr_objects.glb",
            standard / "neutral_objects.glb",
            *(assets / "hdri" / name for name, _ in HDR_MAPS),
        ],
        folder,
    )
    make_shader_ball.write_glb(folder / "floor.glb", make_shader_ball.floor())
    studies = []
    for name, exposure in HDR_MAPS:
        light = name.split(".")[0].removesuffix("_1k")
        for ball, title, camera, shapes in real_balls():
            base = scene(camera, shapes, (name, exposure), size, spp)
            studies.append(Study(f"{ball}-{light}", f"{title} under {light}", base, folder))
    return studies


def real_balls() -> list[tuple[str, str, dict[str, Any], list[dict[str, Any]]]]:
    """Return name, title, camera and shapes of the balls in the shared assets."""
    floor = {"file": "floor.glb", "materials": {"Ground": "ground", "Tile": "tile"}}
    materialx = {
        "file": "materialx_shaderball.glb",
        "materials": {"Preview_Mesh": "ball", "Calibration_Mesh": "base"},
    }
    small = [{"scale": 0.13}, {"translate": [0.0, 0.095, 0.0]}]
    aswf = [
        {"file": "openpbr_objects.glb", "material": "ball", "transform": small},
        {"file": "neutral_objects.glb", "material": "base", "transform": small},
    ]
    near = {"origin": [0.0, 1.9, 6.6], "target": [-0.05, 0.98, 0.0], "vfov_deg": 23.0}
    high = {"origin": [0.85, 2.6, 2.35], "target": [0.0, 0.42, 0.0], "vfov_deg": 27.0}
    return [
        ("materialx", "MaterialX shader ball", near, [materialx, floor]),
        ("aswf", "ASWF Standard Shader Ball", high, [*aswf, floor]),
    ]


def copy(files: Sequence[Path], folder: Path) -> None:
    """Copy the files into the study's folder (its asset root)."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in files:
        shutil.copyfile(path, folder / path.name)


def scene(
    camera: dict[str, Any],
    shapes: list[dict[str, Any]],
    light: tuple[str, float],
    size: int,
    spp: int,
) -> dict[str, Any]:
    """Return the base scene for a light (file, exposure in stops); every cell replaces its ball."""
    file, exposure = light
    return {
        "version": 1,
        "camera": {"type": "pinhole", **camera},
        "film": {"width": size, "height": size},
        "render": {"spp": spp, "seed": 0},
        "materials": {
            "ball": {"type": "conductor", "metal": "Au", "alpha": 0.1},
            "core": {"type": "lambert", "albedo": [0.4, 0.4, 0.4]},
            "base": {"type": "lambert", "albedo": [0.13, 0.13, 0.135]},
            "ground": {"type": "lambert", "albedo": [0.33, 0.33, 0.33]},
            "tile": {"type": "lambert", "albedo": [0.23, 0.23, 0.235]},
        },
        "shapes": [{"type": "mesh", **shape} for shape in shapes],
        "environment": {"file": file},
        "output": {"exposure": exposure, "despeckle": True},
    }


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Write a document as indented JSON."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
