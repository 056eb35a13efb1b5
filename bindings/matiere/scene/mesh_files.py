"""Read PLY, OBJ and GLB meshes through trimesh, without ever opening a second file.

OBJ material libraries and the images inside a GLB are not looked at: only geometry and names are
wanted, and a mesh from a stranger must not make us decode pictures or follow paths. Names are
replaced by numbered tokens before trimesh sees them, so that its own renaming cannot confuse them.
"""

from __future__ import annotations

import io
import json
import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Doubles = NDArray[np.float64]


class MeshFileError(Exception):
    """A mesh file that cannot be used; the text says why."""


@dataclass(frozen=True, slots=True)
class Part:
    """A piece of a mesh with one material: arrays, and every name it goes by (closest first)."""

    positions: Doubles
    triangles: NDArray[np.int64]
    normals: Doubles | None
    uv: Doubles | None
    names: tuple[str, ...]
    material: str | None
    uv1: Doubles | None = None  # the second set of texture coordinates


def read_parts(name: str, data: bytes) -> list[Part]:
    """Return the parts of a mesh file; `name` gives the format by its ending."""
    suffix = name.lower().rsplit(".", 1)[-1]
    readers = {"ply": _read_ply, "obj": _read_obj, "glb": _read_glb}
    try:
        parts = list(readers[suffix](data))
    except MeshFileError:
        raise
    except MemoryError:
        raise MeshFileError("it needs more memory than there is") from None
    except Exception as error:  # parsers of files from strangers fail in many ways
        why = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise MeshFileError(f"not a readable {suffix.upper()} file: {why}") from None
    if not any(len(part.triangles) for part in parts):
        raise MeshFileError("the file holds no triangles")
    return parts


def _part(raw: Mapping[str, Any], names: tuple[str, ...], material: str | None) -> Part:
    positions = np.asarray(raw["vertices"], np.float64).reshape(-1, 3)
    triangles = np.asarray(raw["faces"])
    if triangles.ndim == 2 and triangles.shape[1] == 4:
        triangles = np.concatenate([triangles[:, [0, 1, 2]], triangles[:, [0, 2, 3]]])
    triangles = triangles.reshape(-1, 3).astype(np.int64)
    if len(triangles) and not (triangles.min() >= 0 and triangles.max() < len(positions)):
        raise MeshFileError("a triangle refers to a vertex that does not exist")
    if not np.isfinite(positions[np.unique(triangles)]).all():
        raise MeshFileError("a vertex position is NaN or infinite")
    uv = _rows(getattr(raw.get("visual"), "uv", None), len(positions), 2)
    uv1 = _rows((raw.get("vertex_attributes") or {}).get(_SECOND_UV), len(positions), 2)
    if not all(t is None or np.isfinite(t).all() for t in (uv, uv1)):
        raise MeshFileError("a texture coordinate is NaN or infinite")
    if uv1 is not None:  # trimesh turns only the first set around
        uv1 = np.stack([uv1[:, 0], 1.0 - uv1[:, 1]], axis=1)
    normals = _rows(raw.get("vertex_normals"), len(positions), 3)
    return Part(positions, triangles, normals, uv, names, material, uv1)


def _rows(value: Any, count: int, columns: int) -> Doubles | None:
    if value is None or np.shape(value) != (count, columns):
        return None
    return np.asarray(value, np.float64)


# PLY


def _read_ply(data: bytes) -> Iterator[Part]:
    from trimesh.exchange.ply import load_ply

    raw = dict(load_ply(io.BytesIO(data), fix_texture=False, skip_materials=True))
    if "faces" not in raw:
        raise MeshFileError("the file holds no triangles")
    yield _part(raw, (), None)


# OBJ

_OBJ_NAME = re.compile(rb"^[ \t]*(usemtl|o|g)(?:[ \t]+(.*?))?[ \t\r]*$", re.MULTILINE)


def _read_obj(data: bytes) -> Iterator[Part]:
    from trimesh.exchange.obj import load_obj

    materials: dict[str, int] = {"": 0}
    objects: dict[str, int] = {"": 0}

    def token(match: re.Match[bytes]) -> bytes:
        name = (match[2] or b"").decode("utf-8", "replace")
        table, word = (materials, "usemtl m") if match[1] == b"usemtl" else (objects, "o o")
        return f"{word}{table.setdefault(name, len(table))}".encode()

    text = data.replace(b"\r\n", b"\n").replace(b"\\\n", b" ")
    if _UNUSUAL_FACE.search(text):
        text = _usual_faces(text)
    text = re.sub(rb"^[ \t]*mtllib.*$", b"", text, flags=re.MULTILINE)
    text = b"mtllib all.mtl\no o0\nusemtl m0\n" + _OBJ_NAME.sub(token, text)
    library = "".join(f"newmtl m{i}\n" for i in range(len(materials) + 1)).encode()
    raw = load_obj(io.BytesIO(text), resolver=_OneFile({"all.mtl": library}), split_objects=True)  # type: ignore[arg-type]
    by_object, by_material = list(objects), list(materials)
    for key, geometry in raw.get("geometry", {}).items():
        match = re.match(r"o(\d+)_m(\d+)", key)
        if match is None:
            raise MeshFileError("its groups could not be told apart")
        name, material = by_object[int(match[1])], by_material[int(match[2])]
        yield _part(geometry, (name,) if name else (), material or None)


# Relative (negative) and zero indices, and faces of five or more corners.
_UNUSUAL_FACE = re.compile(rb"^f[^\n]*[ \t/](?:-|0[/ \t\n])|^f(?:[ \t]+[^ \t\n]+){5}", re.MULTILINE)


def _usual_faces(text: bytes) -> bytes:
    """Rewrite faces as triangles with absolute indices; trimesh counts relative ones from the end.

    Relative indices count back from the vertices read so far (OBJ specification); polygons become
    fans.
    """
    read = {b"v": 0, b"vt": 0, b"vn": 0}
    lines = []
    for line in text.split(b"\n"):
        words = line.split()
        if words and words[0] in read:
            read[words[0]] += 1
        if not words or words[0] != b"f":
            lines.append(line)
            continue
        corners = [_absolute(word, tuple(read.values())) for word in words[1:]]
        for second, third in pairwise(corners[1:]):
            lines.append(b" ".join((b"f", corners[0], second, third)))
    return b"\n".join(lines)


def _absolute(corner: bytes, read: tuple[int, ...]) -> bytes:
    parts = []
    for part, count in zip(corner.split(b"/"), read, strict=False):
        index = int(part) if part else None
        if index is not None:
            index = index if index > 0 else count + 1 + index
            if index < 1 or part == b"0":
                raise MeshFileError("a triangle refers to a vertex that does not exist")
        parts.append(b"" if index is None else b"%d" % index)
    return b"/".join(parts)


class _OneFile:
    """A trimesh resolver that knows only what it was given, and no file system."""

    def __init__(self, known: Mapping[str, bytes]) -> None:
        self.known = known

    def __getitem__(self, name: str) -> bytes:
        return self.known[name]

    def get(self, name: str) -> bytes:
        return self.known[name]


# GLB

_KNOWN_EXTENSIONS = ("KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_", "EXT_lights_")


def _read_glb(data: bytes) -> Iterator[Part]:
    from trimesh.exchange.gltf import load_glb
    from trimesh.scene.transforms import SceneGraph

    from matiere.scene.transform import apply_normals, apply_points, mirrors

    header, rest = _glb_header(data)
    parts = _one_mesh_per_primitive(header)
    raw = load_glb(io.BytesIO(_glb_bytes(header, rest)), resolver=None)
    graph = SceneGraph(base_frame=raw["base_frame"])
    for edge in raw["graph"]:
        graph.update(**edge)  # type: ignore[no-untyped-call]
    for node in graph.nodes_geometry:
        matrix, key = graph[node]
        names, material = parts[str(node)]
        part = _part(raw["geometry"][key], names, material)
        triangles = part.triangles[:, ::-1] if mirrors(matrix) else part.triangles
        normals = None if part.normals is None else apply_normals(matrix, part.normals)
        positions = apply_points(matrix, part.positions)
        yield Part(positions, triangles, normals, part.uv, names, material, part.uv1)


def _glb_header(data: bytes) -> tuple[dict[str, Any], bytes]:
    if len(data) < 20 or data[:4] != b"glTF":
        raise MeshFileError("not a GLB file (it does not begin with 'glTF')")
    version, _, length, kind = struct.unpack("<IIII", data[4:20])
    if version != 2 or kind != 0x4E4F534A:
        raise MeshFileError(f"glTF version {version} is not supported; export as glTF 2.0")
    header = json.loads(data[20 : 20 + length])
    required = header.get("extensionsRequired", [])
    if bad := [e for e in required if not str(e).startswith(_KNOWN_EXTENSIONS)]:
        why = f"needs the glTF extension {', '.join(bad)}; export without mesh compression"
        raise MeshFileError(why)
    if any("uri" in buffer for buffer in header.get("buffers", [])):
        raise MeshFileError("refers to another file; export as one self-contained GLB")
    if any(accessor.get("count", 0) > len(data) for accessor in header.get("accessors", [])):
        raise MeshFileError("claims more vertices than the file has bytes")
    return header, data[20 + length :]


def _glb_bytes(header: Mapping[str, Any], rest: bytes) -> bytes:
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + len(rest)
    return struct.pack("<4sIIII", b"glTF", 2, total, len(text), 0x4E4F534A) + text + rest


_SECOND_UV = "_UV1"
Labels = dict[str, tuple[tuple[str, ...], str | None]]  # a node -> its names, its material


def _one_mesh_per_primitive(header: dict[str, Any]) -> Labels:
    """Rewrite a glTF header so that every node with geometry has one primitive and a unique name.

    Returns that name -> the names the part goes by (node, mesh), and its material's name.
    """
    called = [_called(m, "material", i) for i, m in enumerate(header.get("materials", []))]
    for key in ("images", "textures", "samplers", "cameras", "animations", "skins", "extensions"):
        header.pop(key, None)
    nodes, meshes = header.get("nodes", []), header.get("meshes", [])
    header["materials"] = [{"name": "any"}]
    header["meshes"] = []
    parts: Labels = {}
    for index, node in enumerate(list(nodes)):
        own = _called(node, "node", index)
        node["name"] = f"n{index}"
        for key in ("camera", "skin", "extensions", "extras", "weights"):
            node.pop(key, None)
        if (mesh := node.pop("mesh", None)) is None:
            continue
        names = (own, _called(meshes[mesh], "mesh", mesh))
        for number, primitive in enumerate(meshes[mesh]["primitives"]):
            if primitive.get("mode", 4) not in (4, 5):
                continue
            material = primitive.get("material")
            label = f"n{index}p{number}"
            clean = {k: v for k, v in primitive.items() if k in ("attributes", "indices", "mode")}
            if "TEXCOORD_1" in clean["attributes"]:  # under a name that trimesh keeps
                second = {_SECOND_UV: clean["attributes"]["TEXCOORD_1"]}
                clean["attributes"] = {**clean["attributes"], **second}
            header["meshes"].append({"name": label, "primitives": [{**clean, "material": 0}]})
            nodes.append({"name": label, "mesh": len(header["meshes"]) - 1})
            node.setdefault("children", []).append(len(nodes) - 1)
            parts[label] = (names, None if material is None else called[material])
    return parts


def _called(item: Mapping[str, Any], kind: str, index: int) -> str:
    return str(item.get("name") or f"{kind}{index}")
