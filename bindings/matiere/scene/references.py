"""Check what a scene refers to: materials, textures, files, OCIO views.

Works on the plain document, not on the model, so that a wrong name and a wrong number elsewhere are
reported together. Whatever is not shaped as it should be is left to the model's own faults.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from matiere.errors import Fault, MatiereError, SceneValidationError, pointer
from matiere.scene.assets import AssetRoot
from matiere.scene.checks import choose
from matiere.scene.model import DEFAULT_CONFIG, DEFAULT_DISPLAY, DEFAULT_VIEW

MESH_SUFFIXES = (".ply", ".obj", ".glb")
MEASURED_SUFFIXES = (".binary", ".bsdf")
IES_SUFFIXES = (".ies",)
IMAGE_SUFFIXES = (".exr", ".hdr", ".png", ".jpg", ".jpeg", ".tif", ".tiff")

Place = tuple[str | int, ...]


def faults(document: Any, assets: AssetRoot) -> Iterator[Fault]:
    """Yield every reference of the document that leads nowhere."""
    if not isinstance(document, Mapping):
        return
    yield from _material_names(document)
    yield from _texture_names(document)
    for place, name, suffixes in files(document):
        yield from _file(place, name, suffixes, assets)
    yield from _view(document.get("output"))


def files(document: Mapping[str, Any]) -> Iterator[tuple[Place, str, tuple[str, ...]]]:
    """Yield (place, file name, allowed suffixes) of every file the document names."""
    for index, shape in enumerate(_list(document.get("shapes"))):
        if isinstance(name := shape.get("file"), str) and shape.get("type") == "mesh":
            yield ("shapes", index, "file"), name, MESH_SUFFIXES
    for key, texture in _entries(document.get("textures")):
        if isinstance(name := texture.get("file"), str):
            yield ("textures", key, "file"), name, IMAGE_SUFFIXES
    for key, material in _entries(document.get("materials")):
        for place, name in _files_in(material):
            yield ("materials", key, *place), name, MEASURED_SUFFIXES
    for index, light in enumerate(_list(document.get("lights"))):
        if isinstance(name := light.get("ies"), str):
            yield ("lights", index, "ies"), name, IES_SUFFIXES
    for key in ("environment", "background"):
        sky = document.get(key)
        if isinstance(sky, Mapping) and isinstance(name := sky.get("file"), str):
            yield (key, "file"), name, IMAGE_SUFFIXES


def _list(value: Any) -> list[Any]:
    """Return the objects of a list; what is no object keeps its place as an empty one."""
    found = value if isinstance(value, list) else []
    return [item if isinstance(item, Mapping) else {} for item in found]


def _entries(value: Any) -> list[tuple[str, Any]]:
    found = value.items() if isinstance(value, Mapping) else ()
    return [(key, item) for key, item in found if isinstance(item, Mapping)]


def _material_names(document: Mapping[str, Any]) -> Iterator[Fault]:
    table = document.get("materials", {})
    known = list(table) if isinstance(table, Mapping) else []
    for index, shape in enumerate(_list(document.get("shapes"))):
        places: list[tuple[Place, Any]] = [(("material",), shape.get("material"))]
        if isinstance(named := shape.get("materials"), Mapping):
            places += [(("materials", key), name) for key, name in named.items()]
        for place, name in places:
            if isinstance(name, str) and name not in known:
                message, near = choose("the material", name, known)
                at = pointer("shapes", index, *place)
                yield Fault(at, "unknown_material", message, near)


def _texture_names(document: Mapping[str, Any]) -> Iterator[Fault]:
    table = document.get("textures", {})
    known = list(table) if isinstance(table, Mapping) else []
    for key, material in _entries(document.get("materials")):
        for place, name in _textures_in(material):
            if name not in known:
                message, near = choose("the texture", name, known)
                at = pointer("materials", key, *place, "texture")
                yield Fault(at, "unknown_texture", message, near)


def _textures_in(material: Mapping[str, Any]) -> Iterator[tuple[Place, str]]:
    """Yield place and name of every texture of a material and of those nested in it."""
    for parameter, value in _entries(material):
        if isinstance(name := value.get("texture"), str):
            yield (parameter,), name
        elif "type" in value:
            yield from (((parameter, *place), name) for place, name in _textures_in(value))
    for parameter, value in material.items():
        for index, item in enumerate(_list(value)):
            found = _textures_in(item)
            yield from (((parameter, index, *place), name) for place, name in found)


def _files_in(material: Mapping[str, Any]) -> Iterator[tuple[Place, str]]:
    """Yield place and name of every file of a material and of those nested in it."""
    for parameter, value in material.items():
        if parameter == "file" and isinstance(value, str):
            yield (parameter,), value
        elif isinstance(value, Mapping) and "type" in value:
            yield from (((parameter, *place), name) for place, name in _files_in(value))


def _file(place: Place, name: str, suffixes: tuple[str, ...], root: AssetRoot) -> Iterator[Fault]:
    at = pointer(*place)
    try:
        root.check(name)
    except SceneValidationError as error:
        yield from (Fault(at, f.code, f.message, f.suggestion) for f in error.faults)
        return
    if not name.lower().endswith(suffixes):
        yield Fault(at, "asset_format", f"{name!r} must be one of {', '.join(suffixes)}")


def _view(output: Any) -> Iterator[Fault]:
    if not isinstance(output, Mapping):
        return
    said = tuple(
        output.get(key, usual)
        for key, usual in (
            ("config", DEFAULT_CONFIG), ("display", DEFAULT_DISPLAY), ("view", DEFAULT_VIEW)
        )
    )  # fmt: skip
    usual = (DEFAULT_CONFIG, DEFAULT_DISPLAY, DEFAULT_VIEW)
    if said == usual or not all(isinstance(word, str) for word in said):
        return  # OpenColorIO is loaded only to judge names other than the default ones
    from matiere.develop import check_view

    try:
        check_view(*said, builtin_only=True)
    except MatiereError as error:
        yield Fault("/output" + error.pointer, "unknown_view", error.message)
