"""The shader ball: closed solids, outward faces, exact normals, nothing touches."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import trimesh


def merged(part: Any) -> trimesh.Trimesh:
    """Return the part with its seam closed by position."""
    mesh = trimesh.Trimesh(part.positions, part.triangles, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    return mesh


@pytest.mark.parametrize("level", [0, 1, 2, 3])
def test_parts_are_closed_solids_that_face_outward(shader_ball: ModuleType, level: int) -> None:
    for part in [*shader_ball.shader_ball(level), shader_ball.glass_ball(level)[1]]:
        mesh = merged(part)
        assert mesh.is_watertight and mesh.is_winding_consistent, part.name
        assert mesh.euler_number == 2, f"{part.name}: {mesh.euler_number}"
        assert mesh.volume > 0.0, f"{part.name}: inside out, volume {mesh.volume}"
        assert mesh.area_faces.min() > 0.0, f"{part.name}: collapsed triangle"


def test_normals_are_unit_and_agree_with_the_faces(shader_ball: ModuleType) -> None:
    for part in [*shader_ball.shader_ball(2), *shader_ball.stage()]:
        corners = part.positions[part.triangles]
        face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        face /= np.linalg.norm(face, axis=1, keepdims=True)
        lengths = np.linalg.norm(part.normals, axis=1)
        agreement = np.einsum("mi,mji->mj", face, part.normals[part.triangles])
        assert np.abs(lengths - 1.0).max() < 1e-12, part.name
        assert agreement.min() > 0.97, f"{part.name}: {agreement.min()}"


def test_finer_levels_approach_the_sphere(shader_ball: ModuleType) -> None:
    exact = 4.0 / 3.0 * np.pi * shader_ball.INNER_RADIUS**3
    errors = [
        abs(merged(p).volume / exact - 1.0)
        for level in (0, 1, 2, 3)
        for p in shader_ball.shader_ball(level)
        if p.name == "Inner"
    ]
    ratios = [a / b for a, b in pairwise(errors)]
    assert all(3.7 < r < 4.3 for r in ratios), f"not second order: {errors}"


def test_solids_do_not_touch(shader_ball: ModuleType) -> None:
    shell, inner, base = (p.positions for p in shader_ball.shader_ball(2))
    center = np.array([0.0, shader_ball.ball_height(), 0.0])
    outside = np.linalg.norm(base - center, axis=1).min()
    assert outside > shader_ball.SHELL_RADIUS + 0.9 * shader_ball.DISH_GAP, outside
    wall = np.linalg.norm(shell - center, axis=1)
    assert wall.min() > np.linalg.norm(inner - center, axis=1).max() + 0.02
    assert wall.max() <= shader_ball.SHELL_RADIUS + 1e-9
    assert base[:, 1].min() == 0.0


def test_opening_faces_the_camera(shader_ball: ModuleType) -> None:
    axis = shader_ball.tilt() @ np.array([0.0, 1.0, 0.0])
    assert axis[2] > 0.5 and axis[1] > 0.3, axis


def test_files_are_written_alike_twice_and_carry_names(
    shader_ball: ModuleType, tmp_path: Path
) -> None:
    first = [p.read_bytes() for p in shader_ball.write(tmp_path / "a", 1)]
    paths = shader_ball.write(tmp_path / "b", 1)
    assert [p.read_bytes() for p in paths] == first
    names: dict[str, tuple[str, ...]] = {}
    for path in paths:
        loaded: Any = trimesh.load(path)
        names[path.name] = tuple(sorted(loaded.geometry))
        for name, mesh in loaded.geometry.items():
            assert mesh.visual.material.name == ("Shell" if name == "Pearl" else name)
            assert mesh.visual.uv.shape == (len(mesh.vertices), 2)
    assert names == {
        "shader_ball.glb": ("Base", "Inner", "Shell"),
        "glass_ball.glb": ("Base", "Pearl", "Shell"),
        "stage.glb": ("Ground", "Tile"),
    }


def test_an_unknown_level_is_refused(shader_ball: ModuleType) -> None:
    with pytest.raises(ValueError, match="level must be 0 to 4, got 7"):
        shader_ball.shader_ball(7)
