"""What the camera sees behind the shapes, apart from what lights them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import matiere as mt
from matiere.imageio import Stored, write_stored


def scene(background: Any, **more: Any) -> dict[str, Any]:
    """A ball that fills the middle of the picture; the corners look past it."""
    return {
        "version": 1,
        "camera": {"type": "pinhole", "origin": [0, 0, 4], "target": [0, 0, 0], "vfov_deg": 40},
        "film": {"width": 12, "height": 12, "filter": "box"},
        "materials": {"m": {"type": "lambert", "albedo": 0.5}},
        "shapes": [{"type": "sphere", "center": [0, 0, 0], "radius": 1, "material": "m"}],
        "environment": {"radiance": [0.2, 0.4, 0.8]},
        "background": background,
        **more,
    }  # fmt: skip


def film(document: dict[str, Any], folder: Path | None = None, spp: int = 16) -> mt.Film:
    return mt.render(mt.load(document, asset_root=folder), spp=spp, threads=2)


CORNER, MIDDLE = (0, 0), (6, 6)


def test_it_is_seen_and_gives_no_light() -> None:
    plain = film(scene("environment"))
    own = film(scene({"radiance": [3, 2, 1], "scale": 0.5}))
    assert own.mean[CORNER] == pytest.approx([1.5, 1, 0.5])
    assert plain.mean[CORNER] == pytest.approx([0.2, 0.4, 0.8])
    hit = slice(4, 8)
    assert np.array_equal(own.mean[hit, hit], plain.mean[hit, hit])  # the very same samples
    assert (own.alpha == 1).all() and not own.transparent


def test_a_dark_scene_keeps_its_background() -> None:
    document = scene({"radiance": 1})
    document["environment"] = None
    got = film(document)
    assert (got.mean[CORNER] == 1).all() and (got.mean[MIDDLE] == 0).all()


def test_mirrors_and_glass_show_the_environment() -> None:
    for material in ({"type": "mirror"}, {"type": "dielectric", "eta": 1.0001}):
        got = film(scene({"radiance": 9}, materials={"m": material}))
        assert got.mean[MIDDLE] == pytest.approx([0.2, 0.4, 0.8], rel=1e-2)


def test_it_is_seen_through_opacity() -> None:
    hole = {"m": {"type": "lambert", "albedo": 0.0, "opacity": 0.25}}
    got = film(scene({"radiance": 1}, materials=hole), spp=1024)
    # Two sheets of a ball: 0.75^2 of what lies behind.
    assert got.mean[MIDDLE][0] == pytest.approx(0.5625, abs=0.05)


def test_a_map_of_its_own(tmp_path: Path) -> None:
    """The centre column of a map is seen looking along -z, its upper half above the horizon."""
    sky = np.zeros((2, 4, 3), np.float32)
    sky[0], sky[1] = (1, 0, 0), (0, 0, 1)
    write_stored(tmp_path / "sky.exr", Stored(sky, "RGB", {}), "float")
    got = film(scene({"file": "sky.exr"}), tmp_path)
    assert got.mean[0, 0][0] > 0.6 and got.mean[-1, 0][2] > 0.6
    assert got.mean[0, 0] == pytest.approx(got.mean[0, -1], abs=0.02)  # other samples
    loaded = mt.load(scene({"file": "sky.exr"}), asset_root=tmp_path)
    assert [name for name, _ in loaded.assets] == ["sky.exr"]
    again = mt.loads(loaded.to_json(), asset_root=tmp_path)
    assert again.digest == loaded.digest


@pytest.mark.parametrize(
    ("background", "at", "code"),
    [
        ("transparant", "/background", "unknown_choice"),
        (3, "/background", "wrong_type"),
        ({"radiance": -1}, "/background/radiance", "out_of_range"),
        ({"file": "gone.exr"}, "/background/file", "asset_missing"),
        ({"color": 1}, "/background/color", "unknown_key"),
    ],
)
def test_faults_have_their_place(background: Any, at: str, code: str, tmp_path: Path) -> None:
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(scene(background), asset_root=tmp_path)
    assert (at, code) in [(f.pointer, f.code) for f in caught.value.faults]
