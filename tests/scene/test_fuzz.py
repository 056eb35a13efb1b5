"""Whatever is put into a scene, the answer is a scene or a SceneValidationError with pointers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from malformed import good

import matiere as mt

JUNK: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 1, 2**31, 2**63, 10**30, 10**400, -(10**400), 0.0, -0.0, 1e-320),
    *(1e-30, 1e15, 1e20, 1e38, 1e39, 1e308, math.nan, math.inf),
    *("", "x", "Au", "ggx", "ball", "\0", "é" * 300, "../x", "/etc/passwd", "nan"),
    *([], {}, [[]], [{}], [0], [0, 0, 0], [1, 1, 1], [1e38] * 3, [math.nan] * 3),
    *([[0, 0, 0]], [[0, 1, 2]], [["a"]], {"texture": "t"}, {"texture": 3}, {"type": "sphere"}),
    *({"file": "a.png"}, {"radiance": 1}, {"relmse": 0.1}, (1, 2, 3), b"x", {1}, object(), 1j),
    *(np.zeros(3), np.zeros((0, 3)), np.zeros((4, 3)), np.full((4, 3), np.nan)),
    *(np.array("a"), np.array(1), np.int8(3), np.float64("nan")),
)


def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the path of every value of a document."""
    yield at
    if isinstance(value, dict):
        for key in value:
            yield from places(value[key], (*at, key))
    elif isinstance(value, list):
        for index in range(len(value)):
            yield from places(value[index], (*at, index))


def put(document: Any, at: tuple[Any, ...], value: Any) -> None:
    for key in at[:-1]:
        document = document[key]
    document[at[-1]] = value


def base() -> dict[str, Any]:
    scene = good()
    scene["film"] = {"width": 8, "height": 8, "filter": "tent", "crop": [0, 0, 4, 4]}
    scene["render"] |= {"seed": 0, "max_depth": 3, "seconds": 1.0, "target_error": {"relmse": 1.0}}
    scene["textures"] = {"t": {"pixels": [[0.5, 0.25]], "wrap": "clamp"}}
    scene["materials"]["floor"] = {"type": "plastic", "albedo": {"texture": "t"}, "eta": 1.5}
    scene["materials"]["glass"] = {"type": "dielectric", "sigma_a": [1, 2, 3], "priority": 1}
    scene["shapes"][1] |= {
        "normals": [[0, 1, 0]] * 4,
        "uv": [[0, 0], [1, 0], [1, 1], [0, 1]],
        "transform": [
            {"scale": [1, 2, 3]}, {"rotate_deg": 30, "axis": [0, 1, 0]}, {"translate": [0, 1, 0]},
            {"matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]},
        ],
    }  # fmt: skip
    scene["lights"] += [
        {"type": "point", "position": [2, 3, 2], "intensity": [5, 5, 5]},
        {"type": "directional", "direction": [0, -1, 0], "irradiance": 2},
    ]
    scene["output"] = {"exposure": 1, "files": ["a.png"], "bit_depth": {"png": 8}}
    return scene


def attempt(scene: Any) -> str:
    try:
        mt.load(scene).build(threads=1)
    except mt.SceneValidationError as error:
        for fault in error.errors:
            assert fault["pointer"] == "" or fault["pointer"].startswith("/")
            assert fault["code"] and fault["message"]
        return "refused"
    return "built"


def test_the_base_is_good() -> None:
    assert attempt(base()) == "built"


@pytest.mark.parametrize("count", [150, pytest.param(600, marks=pytest.mark.slow)])
def test_junk_anywhere_is_refused_or_built(count: int) -> None:
    rng = np.random.default_rng([20261123, count])
    seen = {"refused": 0, "built": 0}
    for _ in range(count):
        scene = base()
        for _ in range(int(rng.integers(1, 4))):
            spots = [p for p in places(scene) if p]
            at = spots[int(rng.integers(len(spots)))]
            put(scene, at, JUNK[int(rng.integers(len(JUNK)))])
        seen[attempt(scene)] += 1
    assert seen["refused"] > count / 2, seen
    assert seen["built"] > count / 60, seen


@pytest.mark.slow
@pytest.mark.parametrize("junk", range(len(JUNK)))
def test_every_kind_of_junk_at_every_place(junk: int) -> None:
    for at in places(base()):
        scene = base()
        if at:
            put(scene, at, JUNK[junk])
            attempt(scene)


@pytest.mark.parametrize("junk", [None, 3, "x", [], (), b"", np.zeros(3)])
def test_what_is_no_object_is_refused(junk: Any) -> None:
    with pytest.raises((mt.SceneValidationError, TypeError)):
        mt.load(junk)
