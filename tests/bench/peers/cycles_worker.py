"""Cycles on the CPU, through Blender's Python module, as one of the renderers.

Blender's z is up: (x, y, z) becomes (x, -z, y). Cycles counts bounces after the first scattering.
The middle of its lat-long maps is seen along +x. Its area lights are found by rays but stop none,
so each has a black rectangle behind it, as the lamps of the others are black and solid. Seconds are
those Cycles writes into the picture for its render, without synchronisation and BVH, to a hundredth
of a second.
"""

from __future__ import annotations

import math
import re
import tempfile
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from worker import Array, Image, Neutral, Render, body_albedo, rectangle, serve

BEHIND = 2e-4  # of an area light: its black back
WATTS = math.pi  # power of an area light per unit of radiance and area


def zup(vectors: Any) -> Array:
    """Return vectors in Blender's frame."""
    v = np.asarray(vectors, float)
    return np.stack([v[..., 0], -v[..., 2], v[..., 1]], axis=-1)


def rgba(value: Any) -> list[float]:
    """Return a colour with alpha."""
    return [*(float(x) for x in np.broadcast_to(value, 3)), 1.0]


def material(name: str, m: dict[str, Any]) -> Any:
    """Return a material of nodes."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    nodes, links = made.node_tree.nodes, made.node_tree.links
    nodes.clear()
    kind = m["type"]
    if kind == "dielectric":
        node = nodes.new("ShaderNodeBsdfGlass")
        node.distribution = "GGX"
        values = {"Color": rgba(1), "Roughness": 0.0, "IOR": m["eta"]}
    elif kind == "conductor":
        node = nodes.new("ShaderNodeBsdfMetallic")
        node.distribution = "GGX"
        node.fresnel_type = "PHYSICAL_CONDUCTOR"
        values = {"IOR": m["eta"], "Extinction": m["k"], "Roughness": math.sqrt(m["alpha"])}
    elif kind == "plastic":
        node = nodes.new("ShaderNodeBsdfPrincipled")
        node.distribution = "GGX"
        body = body_albedo(list(np.broadcast_to(m["albedo"], 3)), m["eta"])
        values = {"Base Color": rgba(body), "Roughness": 0.0, "IOR": m["eta"]}
    else:
        node = nodes.new("ShaderNodeBsdfDiffuse")
        values = {"Color": rgba(m["albedo"]), "Roughness": 0.0}
    for key, value in values.items():
        node.inputs[key].default_value = value
    links.new(node.outputs["BSDF"], nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return made


def add_mesh(name: str, mesh: dict[str, Any], surface: Any) -> None:
    """Add a mesh; one without normals is flat."""
    positions, triangles = zup(mesh["positions"]), np.asarray(mesh["triangles"])
    data = bpy.data.meshes.new(name)
    data.vertices.add(len(positions))
    data.vertices.foreach_set("co", positions.astype(np.float32).ravel())
    data.loops.add(triangles.size)
    data.loops.foreach_set("vertex_index", triangles.astype(np.int32).ravel())
    data.polygons.add(len(triangles))
    data.polygons.foreach_set("loop_start", np.arange(0, triangles.size, 3, dtype=np.int32))
    data.update(calc_edges=True)
    data.materials.append(surface)
    smooth = mesh["normals"] is not None
    data.polygons.foreach_set("use_smooth", np.full(len(triangles), smooth))
    if smooth:
        data.normals_split_custom_set_from_vertices(zup(mesh["normals"]).tolist())
    bpy.context.collection.objects.link(bpy.data.objects.new(name, data))


def add_lamp(name: str, light: dict[str, Any]) -> None:
    """Add a rectangle light as an area light, which shines along its own -z."""
    corners, _ = rectangle(light)
    corners = zup(corners)
    u, v = corners[1] - corners[0], corners[3] - corners[0]
    width, height = float(np.linalg.norm(u)), float(np.linalg.norm(v))
    data = bpy.data.lights.new(name, "AREA")
    data.shape, data.size, data.size_y = "RECTANGLE", width, height
    radiance = np.broadcast_to(light["radiance"], 3).astype(float)
    peak = float(radiance.max())
    data.color = (radiance / peak).tolist()
    data.energy = peak * width * height * WATTS
    frame = np.eye(4)
    back = -np.cross(u, v) / (width * height)
    frame[:3] = np.array([u / width, -v / height, back, corners.mean(axis=0)]).T
    made = bpy.data.objects.new(name, data)
    made.matrix_world = Matrix(frame.tolist())
    made.visible_camera = True
    bpy.context.collection.objects.link(made)


def add_backs(lights: list[dict[str, Any]]) -> None:
    """Add the black backs of all lamps as one mesh."""
    positions, triangles = [], []
    for number, light in enumerate(lights):
        corners, faces = rectangle(light)
        front = np.cross(corners[1] - corners[0], corners[3] - corners[0])
        positions.append(corners - BEHIND * front / np.linalg.norm(front))
        triangles.append(faces + 4 * number)
    back = {"positions": np.concatenate(positions), "triangles": np.concatenate(triangles)}
    black = material("black", {"type": "lambert", "albedo": 0.0})
    add_mesh("backs", {**back, "normals": None}, black)


def add_environment(environment: Any) -> None:
    """Set the world: black, of one radiance, or a lat-long map."""
    world = bpy.data.worlds.new("world")
    bpy.context.scene.world = world
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    nodes.clear()
    node = nodes.new("ShaderNodeBackground")
    links.new(node.outputs["Background"], nodes.new("ShaderNodeOutputWorld").inputs["Surface"])
    if not isinstance(environment, np.ndarray):
        node.inputs["Color"].default_value = rgba(environment)
        return
    height, width, _ = environment.shape
    turned = np.roll(environment, -width // 4, axis=1)[::-1]
    pixels = np.concatenate([turned, np.ones((height, width, 1))], axis=-1)
    image = bpy.data.images.new("map", width, height, alpha=False, float_buffer=True)
    image.colorspace_settings.name = "Linear Rec.709"
    image.pixels.foreach_set(pixels.astype(np.float32).ravel())
    image.update()
    image.pack()
    texture = nodes.new("ShaderNodeTexEnvironment")
    texture.image, texture.interpolation = image, "Linear"
    links.new(texture.outputs["Color"], node.inputs["Color"])


def add_camera(camera: dict[str, Any]) -> None:
    """Add the camera, which looks along its own -z."""
    data = bpy.data.cameras.new("camera")
    data.sensor_fit = "VERTICAL"
    data.angle = math.radians(camera["vfov_deg"])
    data.clip_start, data.clip_end = 1e-3, 1e4
    origin, target = zup(camera["origin"]), zup(camera["target"])
    back = (origin - target) / np.linalg.norm(origin - target)
    right = np.cross([0, 0, 1], back)
    right /= np.linalg.norm(right)
    frame = np.eye(4)
    frame[:3] = np.array([right, np.cross(back, right), back, origin]).T
    made = bpy.data.objects.new("camera", data)
    made.matrix_world = Matrix(frame.tolist())
    bpy.context.collection.objects.link(made)
    bpy.context.scene.camera = made


def set_up(neutral: Neutral, threads: int) -> None:
    """Set Cycles up: no denoiser, clamp, adaptive sampling, blur of glossy paths or light cut."""
    scene = bpy.context.scene
    render, cycles = scene.render, scene.cycles
    render.engine, cycles.device = "CYCLES", "CPU"
    render.resolution_x = render.resolution_y = neutral["size"]
    render.resolution_percentage = 100
    render.threads_mode, render.threads = "FIXED", threads
    render.use_persistent_data = True
    render.use_compositing = render.use_sequencer = False
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_depth, render.image_settings.exr_codec = "32", "NONE"
    for key in ("denoising", "adaptive_sampling", "guiding", "fast_gi"):
        setattr(cycles, f"use_{key}", False)
    cycles.use_light_tree, cycles.light_sampling_threshold = True, 0.0
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0.0
    cycles.blur_glossy = 0.0
    cycles.pixel_filter_type = "BOX"
    kinds = ("max", "diffuse", "glossy", "transmission")
    for kind in kinds:
        setattr(cycles, f"{kind}_bounces", neutral["depth"] - 1)


def picture(path: Path, size: int) -> tuple[Image, float]:
    """Return the pixels of an EXR file and the seconds Cycles wrote into it."""
    found = re.search(
        rb"(?s)cycles\.[^\0]*\.render_time\0string\0....([0-9:.]+)", path.read_bytes()
    )
    if found is None:
        raise RuntimeError("Cycles left no render time in its picture")
    seconds = 0.0
    for part in found[1].decode().split(":"):
        seconds = 60 * seconds + float(part)
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    pixels = np.empty(size * size * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(size, size, 4)[::-1, :, :3], seconds


def build(neutral: Neutral, threads: int) -> tuple[Render, str]:
    """Build the scene; its BVH is kept from the first render on."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    made = {name: material(name, m) for name, m in neutral["materials"].items()}
    for number, mesh in enumerate(neutral["meshes"]):
        add_mesh(f"mesh{number}", mesh, made[mesh["material"]])
    for number, light in enumerate(neutral["lights"]):
        add_lamp(f"lamp{number}", light)
    if neutral["lights"]:
        add_backs(neutral["lights"])
    add_environment(neutral["environment"])
    add_camera(neutral["camera"])
    set_up(neutral, threads)
    folder = Path(tempfile.mkdtemp(prefix="peers-cycles-"))

    def render(spp: int, seed: int) -> tuple[Image, dict[str, Any]]:
        scene = bpy.context.scene
        scene.cycles.samples, scene.cycles.seed = spp, seed
        path = folder / "picture.exr"
        scene.render.filepath = str(path)
        bpy.ops.render.render(write_still=True)
        image, seconds = picture(path, neutral["size"])
        path.unlink()
        return image, {"seconds": seconds, "spp": spp}

    return render, str(bpy.app.version_string)


if __name__ == "__main__":
    serve(build)
