"""Scenes that differ in their materials alone share geometry, textures and maps."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import matiere as mt
from matiere import _core, chunks

SCENE: dict[str, Any] = {
    "version": 1,
    "camera": {"type": "pinhole", "origin": [0, 1.6, 5], "target": [0, 0.85, 0], "vfov_deg": 32},
    "film": {"width": 16, "height": 16},
    "render": {"spp": 4, "seed": 1},
    "materials": {
        "ball": {"type": "conductor", "metal": "Au", "alpha": 0.1},
        "floor": {"type": "lambert", "albedo": [0.35, 0.36, 0.38]},
        "lamp": {"type": "lambert", "albedo": [0, 0, 0], "emission": [5, 5, 5]},
    },
    "shapes": [
        {"type": "sphere", "center": [0, 1, 0], "radius": 1, "material": "ball"},
        {"type": "sphere", "center": [2, 3, 0], "radius": 0.3, "material": "lamp"},
        {"type": "mesh", "positions": [[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]],
         "triangles": [[0, 2, 1], [0, 3, 2]], "material": "floor"},
    ],
    "lights": [{"type": "rectangle", "corner": [-3.5, 4.8, 0.5], "edge_u": [2.5, 0, 0],
                "edge_v": [0, -0.8, 2.2], "radiance": [17, 16, 14.5]}],
    "environment": {"radiance": [0.6, 0.63, 0.7]},
}  # fmt: skip


def changed(**materials: Any) -> dict[str, Any]:
    document = copy.deepcopy(SCENE)
    for name, parameters in materials.items():
        document["materials"][name] |= parameters
    return document


def sums(scene: mt.Scene) -> NDArray[np.float64]:
    parts = (chunks.settings(scene.model), chunks.plan(scene.model))
    part = _core.render_chunk(scene.build(1), *parts, 0, None)
    assert part is not None
    return part.sums


def shares(scene: mt.Scene, like: mt.Scene) -> bool:
    scene.build(1, like=like)
    return scene._parts is like._parts


@pytest.fixture(scope="module")
def first() -> mt.Scene:
    scene = mt.load(SCENE)
    scene.build(1)
    return scene


@pytest.mark.parametrize(
    "materials",
    [
        {"ball": {"alpha": 0.3}},
        {"ball": {"alpha": 0.0}},
        {"floor": {"albedo": [0.8, 0.1, 0.1]}},
        {"ball": {"alpha": 0.2}, "floor": {"albedo": [0, 0, 0]}},
    ],
)
def test_shared_geometry_gives_the_same_pixels(first: mt.Scene, materials: dict[str, Any]) -> None:
    document = changed(**materials)
    scene = mt.load(document)
    assert shares(scene, first)
    assert np.array_equal(sums(scene), sums(mt.load(document)))


def test_another_type_of_material_shares_too(first: mt.Scene) -> None:
    document = copy.deepcopy(SCENE)
    document["materials"]["ball"] = {"type": "dielectric", "eta": 1.5, "sigma_a": [1, 2, 3]}
    scene = mt.load(document)
    assert shares(scene, first)
    assert np.array_equal(sums(scene), sums(mt.load(document)))


def test_the_camera_and_the_film_may_differ(first: mt.Scene) -> None:
    document = changed()
    document["camera"]["origin"] = [1, 2, 4]
    document["film"] = {"width": 9, "height": 7}
    scene = mt.load(document)
    assert shares(scene, first)
    assert np.array_equal(sums(scene), sums(mt.load(document)))


def test_what_shapes_or_lights_the_scene_is_not_shared(first: mt.Scene) -> None:
    moved, dimmer, sky, dark = (changed() for _ in range(4))
    moved["shapes"][0]["radius"] = 0.9
    dimmer["lights"][0]["radiance"] = [1, 1, 1]
    sky["environment"] = {"radiance": [0.1, 0.1, 0.1]}
    dark["materials"]["lamp"]["emission"] = [0, 0, 0]
    lit = changed(floor={"emission": [1, 1, 1]})
    for document in (moved, dimmer, sky, dark, lit):
        scene = mt.load(document)
        assert not shares(scene, first)
        assert np.array_equal(sums(scene), sums(mt.load(document)))


def test_a_mesh_file_is_shared_while_it_is_the_same(tmp_path: Path) -> None:
    def write(height: float) -> None:
        (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 {height} 0\nf 1 2 3\n")

    document = changed()
    document["shapes"].append({"type": "mesh", "file": "a.obj", "material": "floor"})
    write(1.0)
    first = mt.load(document, asset_root=tmp_path)
    first.build(1)
    document["materials"]["ball"]["alpha"] = 0.4
    assert shares(mt.load(document, asset_root=tmp_path), first)
    write(2.5)
    later = mt.load(document, asset_root=tmp_path)
    assert not shares(later, first)
