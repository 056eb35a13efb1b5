"""The sample scenes load, render and are what their builders make."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import matiere as mt

ROOT = Path(__file__).resolve().parents[2]
SCENES = sorted((ROOT / "examples" / "scenes").glob("*.json"))


def small(path: Path, spp: int = 4) -> dict[str, Any]:
    """Return the scene at a tiny size."""
    scene: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    film = scene["film"]
    scene["film"] = {"width": 32, "height": max(1, round(32 * film["height"] / film["width"]))}
    scene["render"] = {"spp": spp}
    return scene


def test_there_are_scenes() -> None:
    assert {"cornell", "first", "glass_sphere", "rough_metals", "subsurface"} <= {
        p.stem for p in SCENES
    }


@pytest.mark.parametrize("path", SCENES, ids=lambda p: p.stem)
def test_scene_renders(path: Path) -> None:
    film = mt.render(mt.load(small(path)), seed=1)
    image = np.asarray(film.mean)[..., :3]
    assert np.isfinite(image).all() and image.min() >= 0.0
    assert image.mean() > 0.01, image.mean()
    assert film.spp >= 4


def test_cornell_box_is_the_builder_s(example: Callable[[str], ModuleType]) -> None:
    builder = example("make_cornell_box.py")
    text = (ROOT / "examples" / "scenes" / "cornell.json").read_text(encoding="utf-8")
    assert text == builder.to_text(builder.cornell_box())


def test_the_scattering_media_are_the_builder_s(example: Callable[[str], ModuleType]) -> None:
    builder = example("make_subsurface.py")
    text = (ROOT / "examples" / "scenes" / "subsurface.json").read_text(encoding="utf-8")
    assert text == builder.to_text(builder.subsurface())
    positions, triangles, _ = builder.candle()
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert 1.0 < volume < 1.5  # closed, and turned outwards
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]],
                                    triangles[:, [2, 0]]]), axis=1)  # fmt: skip
    assert np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2)


def test_cornell_box_is_red_on_the_left_and_lit_from_above() -> None:
    scene = small(ROOT / "examples" / "scenes" / "cornell.json", spp=16)
    image = np.asarray(mt.render(mt.load(scene), seed=1).mean)[..., :3]
    left, right = image[8:24, 2:5].mean(axis=(0, 1)), image[8:24, -5:-2].mean(axis=(0, 1))
    assert left[0] > 3.0 * left[1], left
    assert right[1] > 1.5 * right[0], right
    assert image[3:6, 13:19].mean() > 3.0 * image.mean()


def test_a_glass_sphere_turns_the_view_upside_down() -> None:
    scene = small(ROOT / "examples" / "scenes" / "glass_sphere.json", spp=64)
    scene["film"] = {"width": 96, "height": 60}
    image = np.asarray(mt.render(mt.load(scene), seed=1).mean)[..., :3]
    blueness = image[..., 2] / image[..., 0]
    wall_high, wall_low = blueness[4, 4], blueness[30, 4]
    column = blueness[12:44, 48]  # down the middle of the large sphere
    assert wall_high > 1.5 > 0.8 > wall_low, (wall_high, wall_low)
    assert column[24:29].mean() > 1.5 * column[14:19].mean(), column


def test_more_glass_is_a_deeper_tint() -> None:
    scene = small(ROOT / "examples" / "scenes" / "glass_sphere.json", spp=64)
    scene["film"] = {"width": 96, "height": 60}
    scene["shapes"] = scene["shapes"][:3]  # no walls: white light through glass alone
    scene["lights"] = []
    scene["environment"] = {"radiance": 1.0}
    image = np.asarray(mt.render(mt.load(scene), seed=1).mean)[..., :3]
    blue = [image[row, column, 2] for row, column in ((51, 15), (42, 78), (32, 48))]
    assert blue[0] > 1.15 * blue[1] > 1.3 * blue[2], blue
