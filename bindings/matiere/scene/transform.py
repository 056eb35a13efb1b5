"""Compose a shape's transform steps, in double precision."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from matiere.scene.shapes import MatrixStep, RotateStep, ScaleStep, TranslateStep

Matrix = NDArray[np.float64]


def compose(steps: Sequence[Any]) -> Matrix:
    """Return the 4 x 4 matrix (for column vectors) that applies `steps` in list order."""
    result: Matrix = np.eye(4)
    for step in steps:
        result = step_matrix(step) @ result
    return result


def step_matrix(step: ScaleStep | RotateStep | TranslateStep | MatrixStep) -> Matrix:
    """Return the 4 x 4 matrix of one step."""
    result: Matrix = np.eye(4)
    if isinstance(step, ScaleStep):
        result[:3, :3] = np.diag(step.scale)
    elif isinstance(step, TranslateStep):
        result[:3, 3] = step.translate
    elif isinstance(step, MatrixStep):
        result = np.array(step.matrix, dtype=np.float64).reshape(4, 4)
    else:
        result[:3, :3] = rotation(step.rotate_deg, step.axis)
    return result


def rotation(angle_deg: float, axis: Sequence[float]) -> Matrix:
    """Return the 3 x 3 rotation by `angle_deg` about `axis` (Rodrigues' formula).

    Quarter turns are exact: cos and sin come from the angle reduced to [-45, 45] degrees.
    """
    x, y, z = np.asarray(axis, dtype=np.float64) / np.linalg.norm(axis)
    c, s = _cos_sin_deg(angle_deg)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=np.float64)
    outer = np.outer([x, y, z], [x, y, z])
    return np.asarray(c * np.eye(3) + s * cross + (1 - c) * outer, dtype=np.float64)


def _cos_sin_deg(angle: float) -> tuple[float, float]:
    quarter = round(angle / 90.0)
    rest = np.deg2rad(angle - 90.0 * quarter)
    c, s = float(np.cos(rest)), float(np.sin(rest))
    return [(c, s), (-s, c), (-c, -s), (s, -c)][int(quarter) % 4]


def apply_points(matrix: Matrix, points: NDArray[Any]) -> Matrix:
    """Return the transformed points, (N, 3) double."""
    moved = np.asarray(points, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    return np.asarray(moved, dtype=np.float64)


def apply_normals(matrix: Matrix, normals: NDArray[Any]) -> Matrix:
    """Return the normals moved by the inverse transpose and unit length; zero stays zero.

    The cofactor matrix is the inverse transpose times the determinant; it needs no division, and
    its sign is that of the determinant, which is put back so that normals stay on their side.
    """
    m = matrix[:3, :3] / np.abs(matrix[:3, :3]).max()
    cofactor = np.stack([np.cross(m[1], m[2]), np.cross(m[2], m[0]), np.cross(m[0], m[1])])
    sign = -1.0 if np.linalg.det(m) < 0 else 1.0
    moved = sign * (np.asarray(normals, np.float64) @ cofactor.T)
    length = np.linalg.norm(moved, axis=1, keepdims=True)
    return np.asarray(moved / np.where(length > 0, length, 1.0), dtype=np.float64)


def mirrors(matrix: Matrix) -> bool:
    """Say whether the transform turns a right hand into a left hand."""
    return bool(np.linalg.det(matrix[:3, :3]) < 0)


def singular(matrix: Matrix) -> bool:
    """Say whether the transform flattens space: its smallest singular value is lost in rounding."""
    values = np.linalg.svd(matrix[:3, :3], compute_uv=False)
    return not bool(values[-1] > 1e-14 * values[0])


def uniform_scale(matrix: Matrix) -> float | None:
    """Return the factor of a similarity transform, or None if lengths change unequally."""
    values = np.linalg.svd(matrix[:3, :3], compute_uv=False)
    return float(values.mean()) if values[0] - values[-1] <= 1e-9 * values[0] else None
