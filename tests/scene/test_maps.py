"""Normal and bump maps in scene JSON."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import matiere as mt

PIXELS = np.full((2, 2, 3), 0.5)


def scene(**more: Any) -> dict[str, Any]:
    return {
        "version": 1,
        "camera": {"type": "pinhole", "origin": [0, 0, 5], "target": [0, 0, 0]},
        "film": {"width": 4, "height": 4},
        "textures": {"t": {"pixels": PIXELS}},
        "materials": {"m": {"type": "lambert", **more}},
        "shapes": [{"type": "sphere", "center": [0, 0, 0], "radius": 1, "material": "m"}],
        "environment": {"radiance": 1},
    }


def test_maps_reach_the_core() -> None:
    map_ = {"texture": "t"}
    loaded = mt.load(scene(normal_map=map_, bump_map=map_, bump_height=0.1))
    assert loaded.build(threads=1).stats()["materials"] == 1
    assert mt.film_key(loaded) != mt.film_key(mt.load(scene()))


@pytest.mark.parametrize(
    ("more", "at", "code"),
    [
        ({"normal_map": 1.0}, "/materials/m/normal_map", "wrong_type"),
        ({"bump_map": {"texture": "x"}}, "/materials/m/bump_map/texture", "unknown_texture"),
        ({"bump_height": "high"}, "/materials/m/bump_height", "wrong_type"),
    ],
)
def test_faults_have_their_place(more: dict[str, Any], at: str, code: str) -> None:
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(scene(**more))
    assert [(f.pointer, f.code) for f in caught.value.faults] == [(at, code)]
