"""Bring a mesh shape to what the core takes: transformed, split by material, cleaned, counted."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from matiere.errors import Fault, SceneValidationError, pointed, pointer
from matiere.scene.assets import AssetRoot
from matiere.scene.checks import MAX_COORDINATE, choose
from matiere.scene.mesh_files import Doubles, MeshFileError, Part, read_parts
from matiere.scene.shapes import MeshShape
from matiere.scene.transform import apply_normals, apply_points, compose, mirrors, singular

EVERY_OTHER = "*"


@dataclass(frozen=True, slots=True)
class PlacedMesh:
    """Triangles of one material in world space, double precision."""

    positions: Doubles
    triangles: NDArray[np.int64]
    normals: Doubles | None
    uv: Doubles | None
    material: str
    uv1: Doubles | None = None


@dataclass(frozen=True, slots=True)
class MeshCounts:
    """What was found while reading a mesh."""

    degenerate_triangles: int = 0
    repaired_normals: int = 0


Files = dict[str, list[Part]]  # what was read already: shapes may share a file


def load_mesh(shape: MeshShape, assets: AssetRoot, files: Files) -> list[PlacedMesh]:
    """Return the shape's pieces; raise SceneValidationError (pointers below the shape)."""
    matrix = compose(shape.transform)
    if singular(matrix):
        why = "the transform flattens the mesh: its matrix cannot be inverted"
        raise SceneValidationError([Fault("/transform", "degenerate", why)])
    placed = []
    for part, material in _assigned(_parts(shape, assets, files), shape):
        positions = apply_points(matrix, part.positions)
        if not bool((np.abs(positions) <= MAX_COORDINATE).all()):
            why = f"a vertex lies further than {MAX_COORDINATE:g} m from the origin"
            raise SceneValidationError([Fault("", "out_of_range", why)])
        triangles = part.triangles[:, ::-1] if mirrors(matrix) else part.triangles
        normals = None if part.normals is None else apply_normals(matrix, part.normals)
        placed.append(PlacedMesh(positions, triangles, normals, part.uv, material, part.uv1))
    return placed


def count_triangles(shape: MeshShape, assets: AssetRoot, files: Files) -> int:
    """Return how many triangles a shape has; raise as `load_mesh` for a file that is not right."""
    return sum(len(part.triangles) for part in _parts(shape, assets, files))


def _parts(shape: MeshShape, assets: AssetRoot, files: Files) -> list[Part]:
    if shape.file is None:
        assert shape.positions is not None and shape.triangles is not None
        arrays = shape.positions, shape.triangles, shape.normals, shape.uv
        return [Part(*arrays, (), None, shape.uv1)]
    with pointed("/file"):
        try:
            if shape.file not in files:
                files[shape.file] = read_parts(shape.file, assets.read(shape.file))
            return files[shape.file]
        except MeshFileError as error:
            why = f"{shape.file!r}: {error}"
            raise SceneValidationError([Fault("", "asset_unreadable", why)]) from None


def _assigned(parts: Iterable[Part], shape: MeshShape) -> list[tuple[Part, str]]:
    """Give every part its material; complain about names that are not in the file."""
    parts = list(parts)
    if shape.materials is None:
        assert shape.material is not None
        return [(part, shape.material) for part in parts]
    present = sorted({n for part in parts for n in (*part.names, part.material) if n})
    found: list[Fault] = []
    for key in shape.materials:
        if key not in present and key != EVERY_OTHER:
            message, near = choose(f"in {shape.file!r} the material or node", key, present)
            found.append(Fault(pointer("materials", key), "unknown_name", message, near))
    result = []
    for part in parts:
        keys = [n for n in (*part.names, part.material, EVERY_OTHER) if n in shape.materials]
        if keys:
            result.append((part, shape.materials[str(keys[0])]))
            continue
        said = f"material {part.material!r}" if part.material else "no material"
        node = f" of node {part.names[0]!r}" if part.names else ""
        why = f"the part{node} with {said} of {shape.file!r} has no entry; add one, or '*' for all"
        found.append(Fault("/materials", "missing_key", why))
    if found:
        unique = {(f.pointer, f.message): f for f in found}
        raise SceneValidationError(unique.values())
    return result


def clean(mesh: PlacedMesh, center: Doubles) -> tuple[PlacedMesh, MeshCounts]:
    """Recentre a mesh, round it to single precision, and drop what has no area there.

    Vertices that no triangle uses are left out; shading normals of no length are replaced by the
    mean of the triangles around.
    """
    rounded = (mesh.positions - center).astype(np.float32).astype(np.float64)
    area2 = np.linalg.norm(_cross(rounded, mesh.triangles), axis=1)
    kept = mesh.triangles[area2 > 0]
    used, inverse = np.unique(kept, return_inverse=True)
    triangles = inverse.reshape(-1, 3).astype(np.int64)
    positions = rounded[used]
    normals = None if mesh.normals is None else mesh.normals[used]
    repaired = 0
    if normals is not None:
        normals, repaired = _repair(normals, positions, triangles)
    uv, uv1 = (None if t is None else t[used] for t in (mesh.uv, mesh.uv1))
    counts = MeshCounts(len(mesh.triangles) - len(kept), repaired)
    return PlacedMesh(positions, triangles, normals, uv, mesh.material, uv1), counts


def _cross(positions: Doubles, triangles: NDArray[np.int64]) -> Doubles:
    a, b, c = (positions[triangles[:, i]] for i in range(3))
    return np.asarray(np.cross(b - a, c - a), np.float64)


def _repair(
    normals: Doubles, positions: Doubles, triangles: NDArray[np.int64]
) -> tuple[Doubles, int]:
    length = np.linalg.norm(normals, axis=1)
    bad = ~(np.isfinite(length) & (length > 1e-6))
    if not bad.any():
        return normals / length[:, None], 0
    total = np.zeros_like(positions)
    face = _cross(positions, triangles)
    for corner in range(3):
        np.add.at(total, triangles[:, corner], face)
    normals = np.where(bad[:, None], total, normals)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    lost = length[:, 0] == 0  # sheets folded onto themselves: take any one of the triangles
    if lost.any():
        any_face = np.zeros_like(positions)
        any_face[triangles.ravel()] = np.repeat(face, 3, axis=0)
        normals = np.where(lost[:, None], any_face, normals)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / length, int(bad.sum())
