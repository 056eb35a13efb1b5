"""Transforms against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from malformed import good
from pydantic import TypeAdapter

import matiere as mt
from matiere.scene.shapes import Step
from matiere.scene.transform import (
    apply_normals,
    apply_points,
    compose,
    mirrors,
    rotation,
    singular,
)

STEPS = TypeAdapter(list[Step])


def matrix_of(*steps: dict[str, Any]) -> Any:
    return compose(STEPS.validate_python(list(steps)))


def test_steps_apply_in_list_order() -> None:
    # (1, 0, 0) scaled by 2, turned a quarter about y (x -> -z), moved by (0, 1, 0)
    matrix = matrix_of(
        {"scale": 2}, {"rotate_deg": 90, "axis": [0, 1, 0]}, {"translate": [0, 1, 0]}
    )
    assert apply_points(matrix, np.array([[1, 0, 0]])).tolist() == [[0, 1, -2]]
    other = matrix_of({"translate": [0, 1, 0]}, {"scale": 2})
    assert apply_points(other, np.array([[1, 0, 0]])).tolist() == [[2, 2, 0]]


@pytest.mark.parametrize("turns", range(-8, 9))
def test_quarter_turns_are_exact(turns: int) -> None:
    matrix = rotation(90.0 * turns, [0, 0, 1])
    assert set(np.abs(matrix).ravel()) <= {0.0, 1.0}
    assert matrix[1, 0] == [0, 1, 0, -1][turns % 4]


def test_rotation_keeps_axis_and_angle() -> None:
    axis = np.array([1.0, -2.0, 0.5])
    matrix = rotation(33.0, axis.tolist())
    assert np.allclose(matrix @ axis, axis, atol=1e-15)
    assert np.allclose(matrix @ matrix.T, np.eye(3), atol=1e-15)
    assert np.isclose(np.trace(matrix), 1 + 2 * np.cos(np.deg2rad(33.0)), atol=1e-15)


def test_matrix_is_row_major() -> None:
    matrix = matrix_of({"matrix": [1, 0, 0, 5, 0, 1, 0, 6, 0, 0, 1, 7, 0, 0, 0, 1]})
    assert apply_points(matrix, np.zeros((1, 3))).tolist() == [[5, 6, 7]]


def test_normals_stay_perpendicular_under_uneven_scale() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        matrix = np.eye(4)
        matrix[:3, :3] = rng.normal(size=(3, 3)) * 10.0 ** rng.uniform(-6, 6)
        edges = rng.normal(size=(2, 3))
        normal = np.cross(*edges)[None]
        moved = apply_normals(matrix, normal)[0]
        for edge in edges:
            along = matrix[:3, :3] @ edge
            assert abs(moved @ along) < 1e-12 * np.linalg.norm(along)
        # the side is kept: a point in front of the surface stays in front
        assert moved @ (matrix[:3, :3] @ normal[0]) > 0


def test_normals_survive_extreme_scale() -> None:
    for factor in (1e-160, 1e-9, 1e9, 1e160):
        matrix = np.diag([factor, factor, factor, 1.0])
        assert np.allclose(apply_normals(matrix, np.array([[0, 3, 4]])), [[0, 0.6, 0.8]])


def test_mirror_is_seen() -> None:
    assert mirrors(matrix_of({"scale": [-1, 1, 1]}))
    assert not mirrors(matrix_of({"scale": [-1, -1, 1]}))
    assert not mirrors(matrix_of({"rotate_deg": 180, "axis": [1, 1, 0]}))


def test_singular_matrix_is_refused(recorded: None) -> None:
    scene = good()
    flat = [1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    scene["shapes"][1]["transform"] = [{"matrix": flat}]
    assert singular(matrix_of({"matrix": flat}))
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(scene).flatten()
    assert caught.value.errors[0]["pointer"] == "/shapes/1/transform"


def test_mirrored_mesh_keeps_its_outside(recorded: None) -> None:
    scene = good()
    scene["shapes"] = [
        {
            "type": "mesh",
            "positions": [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
            "triangles": [[0, 1, 2]],
            "normals": [[0, 0, 1]] * 3,
            "material": "floor",
            "transform": [{"scale": [1, 1, -3]}],
        }
    ]
    description: Any = mt.load(scene).flatten().description
    positions, triangles, normals, *_ = description.of("add_mesh")[0]
    a, b, c = positions[triangles[0]]
    assert np.allclose(normals, [0, 0, -1])
    assert np.cross(b - a, c - a) @ normals[0] > 0


@pytest.mark.parametrize(
    ("step", "pointer", "code"),
    [
        ({"scal": 2}, "/0", "unknown_key"),
        ({}, "/0", "missing_key"),
        ({"scale": 2, "translate": [0, 0, 0]}, "/0", "exclusive_keys"),
        ({"scale": 2, "axis": [0, 1, 0]}, "/0/axis", "unknown_key"),
        ({"rotate_deg": 30}, "/0/axis", "missing_key"),
        ({"rotate_deg": 30, "axis": [0, 0, 0]}, "/0/axis", "degenerate"),
        ({"translate": [1, 2]}, "/0/translate", "wrong_length"),
        ({"matrix": [1] * 16}, "/0/matrix", "out_of_range"),
        (3, "/0", "wrong_type"),
    ],
)
def test_bad_steps_are_refused(step: Any, pointer: str, code: str) -> None:
    scene = good()
    scene["shapes"][1]["transform"] = [step]
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(scene)
    (error,) = caught.value.errors
    assert (error["pointer"], error["code"]) == ("/shapes/1/transform" + pointer, code)
