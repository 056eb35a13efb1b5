"""SceneModel -> `_core.RenderDescription`: names, defaults, units and files resolved.

Everything is composed in double; then the scene is moved so that its centre lies near the origin
before it is rounded to single precision, camera and lights with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from matiere.errors import AssetChanged, Fault, SceneValidationError, pointed, pointer
from matiere.materials import metal
from matiere.scene.assets import AssetRoot
from matiere.scene.ies import IesProfile, load_ies
from matiere.scene.lights import (
    DirectionalLight,
    Environment,
    PointLight,
    RectangleLight,
    SpotLight,
)
from matiere.scene.materials import FileName, MaterialModel, ParamNode, TextureRef
from matiere.scene.measured import Arrays, load_measured
from matiere.scene.meshes import Files, PlacedMesh, clean, load_mesh
from matiere.scene.model import SceneModel
from matiere.scene.shapes import MeshShape, SphereShape
from matiere.scene.textures import load_environment, load_texture

if TYPE_CHECKING:
    from matiere import _core

Vector = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Flattened:
    """The core's description of a scene, and what happened on the way."""

    description: _core.RenderDescription
    center: tuple[float, float, float]
    notes: tuple[dict[str, Any], ...] = ()
    parts: Parts | None = None


@dataclass(frozen=True, slots=True)
class Parts:
    """What a scene that differs in its materials alone need not read again."""

    spaces: dict[str, str]
    textures: dict[str, int]
    measured: dict[str, Arrays]
    profiles: dict[str, IesProfile]
    notes: tuple[dict[str, Any], ...]


@dataclass(slots=True)
class _Work:
    """What flattening gathers."""

    description: Any
    faults: list[Fault] = field(default_factory=list)
    notes: list[dict[str, Any]] = field(default_factory=list)
    spaces: dict[str, str] = field(default_factory=dict)  # texture name -> its colour space
    textures: dict[str, int] = field(default_factory=dict)
    materials: dict[str, int] = field(default_factory=dict)
    environment: NDArray[np.float32] | None = None
    backdrop: NDArray[np.float32] | None = None
    measured: dict[str, Arrays] = field(default_factory=dict)  # file name -> what it holds
    profiles: dict[str, IesProfile] = field(default_factory=dict)

    def note(self, at: str, code: str, message: str, count: int) -> None:
        self.notes.append({"pointer": at, "code": code, "message": message, "count": count})


def flatten(model: SceneModel, assets: AssetRoot) -> Flattened:
    """Return the core's description of a checked scene, reading all of its files.

    Raises SceneValidationError with every fault found in the files (missing names in a mesh,
    unreadable images, ...), and AssetChanged when a file differs from its digest.
    """
    from matiere import _core

    work = _Work(_core.RenderDescription())
    meshes = _read_meshes(model, assets, work)
    _add_textures(model, assets, work)
    _check_scalar_textures(model, work)
    _read_environment(model, assets, work)
    _read_measured(model, assets, work)
    _read_profiles(model, assets, work)
    if work.faults:
        raise SceneValidationError(work.faults)
    center = scene_center(model, [mesh for _, mesh in meshes])
    parts = Parts(work.spaces, work.textures, work.measured, work.profiles, tuple(work.notes))
    _add_film_and_camera(model, center, work)
    _add_materials(model, work)
    _add_meshes(meshes, center, work)
    _add_spheres(model, center, work)
    _add_lights(model, center, work)
    _add_environment(model, center, work)
    _add_backdrop(model, work)
    _note_darkness(model, work)
    if work.faults:
        raise SceneValidationError(work.faults)
    x, y, z = (float(c) for c in center)
    parts = replace(parts, notes=tuple(work.notes))
    return Flattened(work.description, (x, y, z), tuple(work.notes), parts)


def flatten_like(
    model: SceneModel, parts: Parts, center: tuple[float, float, float], built: _core.Scene
) -> Flattened:
    """Return the description of a scene that has everything but materials from a built one.

    The caller knows that shapes, lights, textures in use, environment, background and files are
    the same (`alike`). Nothing is read.
    """
    from matiere import _core

    work = _Work(
        _core.RenderDescription(),
        spaces=parts.spaces,
        textures=parts.textures,
        measured=parts.measured,
        profiles=parts.profiles,
    )
    _check_scalar_textures(model, work)
    if work.faults:
        raise SceneValidationError(work.faults)
    middle = np.asarray(center, np.float64)
    work.description.share(built)
    _add_film_and_camera(model, middle, work)
    _add_materials(model, work)
    _add_lights(model, middle, work)
    return Flattened(work.description, center, parts.notes, parts)


def alike(one: SceneModel, other: SceneModel) -> bool:
    """Tell whether two models differ at most in parameters, camera, film and render settings."""
    same = (
        list(one.materials) == list(other.materials)
        and _equal(one.lights, other.lights)
        and _equal(one.environment, other.environment)
        and _equal(one.background, other.background)
        and _equal(_used_textures(one), _used_textures(other))
        and _equal(one.shapes, other.shapes)
    )
    if not same:
        return False
    return all(
        one.materials[name].emission == other.materials[name].emission
        and one.materials[name].files() == other.materials[name].files()
        for name in one.materials
    )


def _equal(one: Any, other: Any) -> bool:
    """Compare models that may hold arrays."""
    if type(one) is not type(other):
        return False
    if isinstance(one, BaseModel):
        names = type(one).model_fields
        return all(_equal(getattr(one, name), getattr(other, name)) for name in names)
    if isinstance(one, np.ndarray):
        return bool(np.array_equal(one, other))
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(_equal, one, other))
    return bool(one == other)


def _used_textures(model: SceneModel) -> list[tuple[str, Any]]:
    used = {t for material in model.materials.values() for t in material.textures().values()}
    return [(name, texture) for name, texture in model.textures.items() if name in used]


def scene_center(model: SceneModel, meshes: list[PlacedMesh]) -> Vector:
    """Return the point that becomes the origin: the centre of the shapes' bounding box.

    Along an axis where the origin already lies within one box diagonal nothing is gained, and the
    numbers stay as they were written.
    """
    boxes = [(m.positions.min(axis=0), m.positions.max(axis=0)) for m in meshes]
    for shape in model.shapes:
        if isinstance(shape, SphereShape):
            center = np.asarray(shape.center)
            boxes.append((center - shape.radius, center + shape.radius))
    for light in model.lights:
        if isinstance(light, RectangleLight):
            corner, u, v = map(np.asarray, (light.corner, light.edge_u, light.edge_v))
            points = np.stack([corner, corner + u, corner + v, corner + u + v])
            boxes.append((points.min(axis=0), points.max(axis=0)))
    if not boxes:
        return np.asarray(model.camera.target, np.float64)
    low = np.min([b[0] for b in boxes], axis=0)
    high = np.max([b[1] for b in boxes], axis=0)
    middle = low + (high - low) / 2
    size = float(np.linalg.norm(high - low))
    return np.asarray(np.where(np.abs(middle) <= size, 0.0, middle), np.float64)


def _read_meshes(model: SceneModel, assets: AssetRoot, work: _Work) -> list[tuple[int, PlacedMesh]]:
    found: list[tuple[int, PlacedMesh]] = []
    files: Files = {}
    for index, shape in enumerate(model.shapes):
        if not isinstance(shape, MeshShape):
            continue
        with _collected(pointer("shapes", index), work):
            found += [(index, mesh) for mesh in load_mesh(shape, assets, files)]
    return found


@contextmanager
def _collected(at: str, work: _Work) -> Iterator[None]:
    """Keep the faults of one file and go on, unless the file was swapped under us."""
    try:
        with pointed(at):
            yield
    except AssetChanged:
        raise
    except SceneValidationError as error:
        work.faults += error.faults


def _add_textures(model: SceneModel, assets: AssetRoot, work: _Work) -> None:
    """Add the textures that a material uses; the others are not even read."""
    for name, texture in _used_textures(model):
        at = pointer("textures", name)
        with _collected(at, work):
            loaded = load_texture(texture, assets)
            work.spaces[name] = loaded.color_space
            moved = {} if texture.transform is None else {"transform": texture.transform.matrix}
            work.textures[name] = work.description.add_texture(
                loaded.pixels,
                texture.wrap,
                filter=texture.filter,
                srgb=loaded.encoded,
                uv_set=texture.uv_set,
                pointer=at,
                **moved,
            )


def _check_scalar_textures(model: SceneModel, work: _Work) -> None:
    for name, material in model.materials.items():
        for place, texture in material.textures().items():
            scalar = material.row_of(place)["kind"] == "scalar"
            if scalar and work.spaces.get(texture) == "sRGB":
                why = (
                    f"{place[-1]!r} is a number, but the texture {texture!r} is decoded as sRGB "
                    'colour; give the texture "color_space": "data"'
                )
                at = pointer("materials", name, *place, "texture")
                work.faults.append(Fault(at, "wrong_color_space", why))


def _read_environment(model: SceneModel, assets: AssetRoot, work: _Work) -> None:
    work.environment = _lat_long("environment", model.environment, assets, work)
    if isinstance(model.background, Environment):
        work.backdrop = _lat_long("background", model.background, assets, work)


def _lat_long(
    name: str, environment: Environment | None, assets: AssetRoot, work: _Work
) -> NDArray[np.float32] | None:
    """Return the pixels of a lat-long map; None where there is no map, or its file is at fault."""
    if environment is None or environment.radiance is not None:
        return None
    found: list[NDArray[np.float32]] = []
    with _collected(f"/{name}", work):
        loaded, negative = load_environment(environment, assets)
        if negative:
            why = f"{negative} negative values of the {name} were set to 0"
            work.note(f"/{name}", "negative_pixels", why, negative)
        found.append(loaded.pixels)
    return found[0] if found else None


def _read_measured(model: SceneModel, assets: AssetRoot, work: _Work) -> None:
    """Read every file of measured reflection once."""
    for name, material in model.materials.items():
        for place, file in material.files().items():
            if file not in work.measured:
                with _collected(pointer("materials", name, *place), work):
                    work.measured[file] = load_measured(file, assets)


def _read_profiles(model: SceneModel, assets: AssetRoot, work: _Work) -> None:
    """Read every photometric file once."""
    for index, light in enumerate(model.lights):
        name = light.ies if isinstance(light, PointLight | SpotLight) else None
        if name is not None and name not in work.profiles:
            with _collected(pointer("lights", index, "ies"), work):
                work.profiles[name] = load_ies(name, assets)


def _add_film_and_camera(model: SceneModel, center: Vector, work: _Work) -> None:
    film, camera = model.film, model.camera
    if "uv" in film.aovs:
        work.description.keep_uv = True
    work.description.set_film(film.width, film.height, film.filter, film.radius, film.crop)
    origin, target, up = camera.placement
    work.description.set_camera(
        camera.type, _near(origin, center), _near(target, center), up, **camera.settings()
    )


def core_params(
    material: ParamNode, textures: Mapping[str, int], files: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the parameters as the core takes them: metals resolved, textures by index.

    A nested material is a dict of its parameters and its `type`, a list is one of dicts; `files`
    has the arrays of files.
    """
    params: dict[str, Any] = {}
    for name, value in material.params().items():
        if name == "metal":
            constants = metal(value)
            params |= {"eta": tuple(constants["eta"]), "k": tuple(constants["k"])}
        elif isinstance(value, MaterialModel):
            params[name] = {"type": value.type, **core_params(value, textures, files)}
        elif isinstance(value, tuple) and value and isinstance(value[0], ParamNode):
            params[name] = [core_params(item, textures, files) for item in value]
        elif isinstance(value, FileName):
            params[name] = ("data", (files or {})[value])
        else:
            params[name] = _core_value(value, textures)
    return params


def _core_value(value: Any, textures: Mapping[str, int]) -> Any:
    return ("texture", textures[value.texture]) if isinstance(value, TextureRef) else value


def _maps(material: MaterialModel, textures: Mapping[str, int]) -> dict[str, Any]:
    """Return the argument for the normal and bump maps; none for a material without."""
    maps: dict[str, float] = {}
    if material.normal_map is not None:
        maps["normal_map"] = textures[material.normal_map.texture]
    if material.bump_map is not None:
        maps |= {"bump_map": textures[material.bump_map.texture]}
        maps |= {"bump_height": material.bump_height}
    return {"maps": maps} if maps else {}


def _add_materials(model: SceneModel, work: _Work) -> None:
    for name, material in model.materials.items():
        work.materials[name] = work.description.add_material(
            material.type,
            core_params(material, work.textures, work.measured),
            emission=_core_value(material.emission, work.textures),
            opacity=_core_value(material.opacity, work.textures),
            two_sided=material.two_sided,
            priority=material.priority,
            name=name,
            pointer=pointer("materials", name),
            **_maps(material, work.textures),
        )


def _add_meshes(meshes: list[tuple[int, PlacedMesh]], center: Vector, work: _Work) -> None:
    degenerate: dict[int, int] = {}
    kept: dict[int, int] = {}
    for index, mesh in meshes:
        at = pointer("shapes", index)
        tidy, counts = clean(mesh, center)
        degenerate[index] = degenerate.get(index, 0) + counts.degenerate_triangles
        kept[index] = kept.get(index, 0) + len(tidy.triangles)
        if counts.repaired_normals:
            why = f"{counts.repaired_normals} normals without length were made anew"
            work.note(at, "repaired_normals", why, counts.repaired_normals)
        if len(tidy.triangles):
            _add_mesh(tidy, at, work)
    for index, count in degenerate.items():
        at = pointer("shapes", index)
        if not kept[index]:
            why = "no triangle of the mesh has an area"
            work.faults.append(Fault(at, "degenerate", why))
        elif count:
            why = f"{count} triangles without area were left out"
            work.note(at, "degenerate_triangles", why, count)


def _add_mesh(mesh: PlacedMesh, at: str, work: _Work) -> None:
    work.description.add_mesh(
        mesh.positions.astype(np.float32),
        mesh.triangles.astype(np.uint32),
        None if mesh.normals is None else mesh.normals.astype(np.float32),
        None if mesh.uv is None else mesh.uv.astype(np.float32),
        work.materials[mesh.material],
        pointer=at,
        uv1=None if mesh.uv1 is None else mesh.uv1.astype(np.float32),
    )


def _add_spheres(model: SceneModel, center: Vector, work: _Work) -> None:
    for index, shape in enumerate(model.shapes):
        if not isinstance(shape, SphereShape):
            continue
        work.description.add_sphere(
            _near(shape.center, center),
            shape.radius,
            work.materials[shape.material],
            pointer=pointer("shapes", index),
        )


def _add_lights(model: SceneModel, center: Vector, work: _Work) -> None:
    for index, light in enumerate(model.lights):
        if isinstance(light, RectangleLight):
            work.description.add_rectangle_light(
                _near(light.corner, center),
                light.edge_u,
                light.edge_v,
                light.radiance,
                pointer=pointer("lights", index),
            )
        elif isinstance(light, PointLight | SpotLight) and light.ies is not None:
            _add_profile_light(light, work.profiles[light.ies], center, work)
        elif isinstance(light, PointLight):
            work.description.add_point_light(_near(light.position, center), light.intensity)
        elif isinstance(light, SpotLight):
            work.description.add_spot_light(
                _near(light.position, center),
                light.direction,
                light.intensity,
                light.inner,
                light.outer_deg,
            )
        elif isinstance(light, DirectionalLight):
            work.description.add_directional_light(light.direction, light.irradiance)


def _add_profile_light(
    light: PointLight | SpotLight, profile: IesProfile, center: Vector, work: _Work
) -> None:
    """Add a light as its file spreads it; its intensity is that of the brightest direction."""
    work.description.add_profile_light(
        _near(light.position, center),
        light.direction,
        light.intensity,
        {
            "vertical_deg": profile.vertical_deg,
            "horizontal_deg": profile.horizontal_deg,
            "values": profile.candela / profile.candela.max(),
        },
        (light.inner, light.outer_deg) if isinstance(light, SpotLight) else None,
        light.rotation_deg,
    )


def _add_environment(model: SceneModel, center: Vector, work: _Work) -> None:
    environment = model.environment
    if environment is None:
        return
    for index, portal in enumerate(environment.portals):
        at = pointer("environment", "portals", index)
        work.description.add_portal(
            _near(portal.corner, center), portal.edge_u, portal.edge_v, pointer=at
        )
    if environment.radiance is not None:
        r, g, b = (c * environment.scale for c in environment.radiance)
        work.description.set_constant_environment((r, g, b))
    else:
        assert work.environment is not None
        rotation, scale = environment.rotation_deg, environment.scale
        work.description.set_environment(work.environment, rotation, scale)


def _add_backdrop(model: SceneModel, work: _Work) -> None:
    backdrop = model.background
    if not isinstance(backdrop, Environment):
        return
    pixels = work.backdrop
    if backdrop.radiance is not None:
        pixels = np.array([[backdrop.radiance]], np.float32)
    assert pixels is not None
    work.description.set_backdrop(pixels, backdrop.rotation_deg, backdrop.scale)


def _note_darkness(model: SceneModel, work: _Work) -> None:
    emissive = {name for name, m in model.materials.items() if m.emission != (0.0, 0.0, 0.0)}
    lit = any(
        not emissive.isdisjoint([s.material, *(getattr(s, "materials", None) or {}).values()])
        for s in model.shapes
    )
    if not (model.lights or model.environment or lit):
        why = "the scene has no light; add lights, an environment or a material with emission"
        work.note("", "no_light", why, 1)


def _near(point: tuple[float, float, float], center: Vector) -> tuple[float, float, float]:
    x, y, z = (float(a) - float(c) for a, c in zip(point, center, strict=True))
    return (x, y, z)
