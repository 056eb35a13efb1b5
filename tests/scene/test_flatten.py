"""flatten: names, defaults, metals, textures, recentring."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from malformed import good

import matiere as mt
from matiere import _core
from matiere.imageio import Stored, write_stored
from matiere.scene.textures import REC709, convert_to_rec709, rec709_from


def described(scene: dict[str, Any], folder: Path | None = None) -> Any:
    return mt.load(scene, asset_root=folder or ".").flatten().description


def test_everything_reaches_the_core(recorded: None) -> None:
    scene = good()
    scene["camera"] = {
        "type": "thin_lens", "origin": [0, 1, 5], "target": [0, 1, 0], "up": [0, 2, 1],
        "vfov_deg": 50, "aperture_radius": 0.1, "focus_distance": 4,
    }  # fmt: skip
    scene["film"] = {"width": 64, "height": 32, "filter": "tent", "crop": [8, 4, 16, 12]}
    scene["materials"]["floor"] |= {"emission": 3, "two_sided": False, "priority": 2}
    scene["lights"] += [
        {"type": "point", "position": [2, 3, 2], "intensity": [5, 6, 7]},
        {"type": "directional", "direction": [0, -1, 0], "irradiance": 2},
    ]
    scene["environment"] = {"radiance": [1, 2, 3], "scale": 0.5}
    made = described(scene)
    assert made.of("set_film") == [(64, 32, "tent", 1.0, (8, 4, 16, 12))]
    origin, target, up = (0.0, 1.0, 5.0), (0.0, 1.0, 0.0), (0.0, 2.0, 1.0)
    lens = {
        "vfov_deg": 50.0, "aperture_radius": 0.1, "focus_distance": 4.0,
        "blades": 0, "blade_rotation_deg": 0.0, "aperture_ratio": 1.0,
    }  # fmt: skip
    assert made.calls_of("set_camera") == [(("thin_lens", origin, target, up), lens)]
    assert made.of("add_sphere") == [((0.0, 1.0, 0.0), 1.0, 0)]
    assert made.of("add_point_light") == [((2.0, 3.0, 2.0), (5.0, 6.0, 7.0))]
    assert made.of("add_directional_light") == [((0.0, -1.0, 0.0), (2.0, 2.0, 2.0))]
    assert made.of("set_constant_environment") == [((0.5, 1.0, 1.5),)]
    named = [keys for name, _, keys in made.calls if name == "add_material"]
    assert named[1] == {
        "emission": (3.0, 3.0, 3.0), "opacity": 1.0, "two_sided": False, "priority": 2,
        "name": "floor", "pointer": "/materials/floor",
    }  # fmt: skip


def test_metals_become_eta_and_k(recorded: None) -> None:
    ((kind, params), *_) = described(good()).of("add_material")
    gold = mt.metals()["Au"]
    assert kind == "conductor"
    assert params["eta"] == tuple(gold["eta"]) and params["k"] == tuple(gold["k"])
    assert "metal" not in params


def test_only_given_parameters_are_passed_on(recorded: None) -> None:
    """The core fills in defaults; a default passed on would look like a contradiction."""
    ((_, params), *_) = described(good()).of("add_material")
    assert set(params) == {"eta", "k", "alpha"}


def test_near_scenes_keep_their_numbers(recorded: None) -> None:
    flattened = mt.load(good()).flatten()
    assert flattened.center == (0.0, 0.0, 0.0)


def moved_by(offset: np.ndarray[Any, Any], *point: float) -> list[float]:
    moved: list[float] = np.add(offset, point).tolist()
    return moved


def test_far_scenes_are_recentred_in_double(recorded: None) -> None:
    """A scene 10^7 m away reaches the core as if it stood at the origin, to the last bit."""
    near, far = good(), good()
    offset = np.array([1e7, -2e7, 3e7])
    moved = {"translate": offset.tolist()}
    far["camera"]["origin"] = moved_by(offset, 0, 1, 5)
    far["camera"]["target"] = moved_by(offset, 0, 1, 0)
    far["shapes"][0]["center"] = moved_by(offset, 0, 1, 0)
    far["shapes"][1]["transform"] = [moved]
    far["lights"][0]["corner"] = moved_by(offset, -1, 4, -1)
    for scene, light in ((near, np.zeros(3)), (far, offset)):
        at = moved_by(light, 2, 3, 2)
        scene["lights"].append({"type": "point", "position": at, "intensity": 1})
    flattened = mt.load(far).flatten()
    made: Any = flattened.description
    base = np.asarray(flattened.center) - offset
    assert np.abs(base).max() < 10
    reference = described(near)
    got, wanted = made.of("add_mesh")[0][0], reference.of("add_mesh")[0][0]
    assert got.dtype == np.float32
    assert np.array_equal(got.astype(np.float64) + base, wanted)
    for name in ("add_sphere", "add_point_light", "add_rectangle_light"):
        assert np.array_equal(np.add(made.of(name)[0][0], base), reference.of(name)[0][0]), name
    assert np.array_equal(np.add(made.of("set_camera")[0][1], base), (0, 1, 5))


def test_directions_are_not_moved(recorded: None) -> None:
    scene = good()
    scene["shapes"] = [{"type": "sphere", "center": [1e6, 0, 0], "radius": 1, "material": "floor"}]
    scene["lights"] = [
        {"type": "directional", "direction": [0, -1, 0], "irradiance": 1},
        {
            "type": "rectangle", "corner": [1e6, 4, 0], "edge_u": [2, 0, 0], "edge_v": [0, 0, 2],
            "radiance": 1,
        },
    ]  # fmt: skip
    made = described(scene)
    assert made.of("add_sphere")[0][0] == pytest.approx((-1, -1.5, -0.5), abs=2)
    assert made.of("add_directional_light")[0][0] == (0.0, -1.0, 0.0)
    assert made.of("add_rectangle_light")[0][1:3] == ((2.0, 0.0, 0.0), (0.0, 0.0, 2.0))


@pytest.mark.parametrize(
    ("change", "pointer"),
    [
        (lambda s: s["shapes"][0].update(center=[1e16, 0, 0]), "/shapes/0/center/0"),
        (lambda s: s["shapes"][0].update(radius=1e16), "/shapes/0/radius"),
        (lambda s: s["shapes"][0].update(radius=1e-30), "/shapes/0/radius"),
        (lambda s: s["camera"].update(origin=[0, 0, -1e30]), "/camera/origin/2"),
        (lambda s: s["lights"][0].update(edge_u=[1e20, 0, 0]), "/lights/0/edge_u/0"),
        (lambda s: s["shapes"][1].update(transform=[{"scale": 1e18}]), "/shapes/1"),
    ],
)
def test_shapes_beyond_single_precision_are_refused(
    change: Callable[[dict[str, Any]], object], pointer: str, recorded: None
) -> None:
    scene = good()
    change(scene)
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(scene).flatten()
    (error,) = caught.value.errors
    assert (error["pointer"], error["code"]) == (pointer, "out_of_range")


def test_a_scene_without_light_is_noted(recorded: None) -> None:
    scene = good()
    scene["lights"], scene["environment"] = [], None
    assert [n["code"] for n in mt.load(scene).flatten().notes] == ["no_light"]
    scene["materials"]["ball"]["emission"] = 1
    assert mt.load(scene).flatten().notes == ()
    scene["shapes"].pop(0)  # the glowing material is on no shape any more
    assert [n["code"] for n in mt.load(scene).flatten().notes] == ["no_light"]


def textured(folder: Path, **texture: Any) -> dict[str, Any]:
    scene = good()
    encoded = np.array([[[0, 51, 128], [255, 10, 11]]], np.uint8)
    write_stored(folder / "wood.png", Stored(encoded, "RGB", {}), "uint8")
    scene["textures"] = {"wood": {"file": "wood.png", **texture}}
    scene["materials"]["floor"]["albedo"] = {"texture": "wood"}
    return scene


def test_textures_are_decoded_by_their_colour_space(tmp_path: Path, recorded: None) -> None:
    # 51/255 = 0.2 and 128/255 in linear light, by IEC 61966-2-1
    for space in (None, "sRGB"):
        extra = {} if space is None else {"color_space": space}
        made = described(textured(tmp_path, **extra), tmp_path)
        (((pixels, wrap), keys),) = made.calls_of("add_texture")
        assert wrap == "repeat" and keys["srgb"]
        assert pixels.dtype == np.uint8 and pixels.shape == (1, 2, 3)
        decoded = _core.probe.Texture(pixels, srgb=True).level(0)
        assert np.allclose(decoded[0, 0], [0, 0.0331047666, 0.2158605001], rtol=2e-7)
    for space in ("linear", "data"):
        made = described(textured(tmp_path, color_space=space), tmp_path)
        (((pixels, _), keys),) = made.calls_of("add_texture")
        assert not keys["srgb"]
        decoded = _core.probe.Texture(pixels).level(0)
        assert np.allclose(decoded[0, 0], [0, 0.2, 128 / 255], rtol=1e-7)
    assert made.of("add_material")[1][1]["albedo"] == ("texture", 0)


AP1 = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)
# ACEScg to linear Rec.709, CAT Bradford: as in OpenColorIO's own ACES configs
ACESCG_TO_REC709 = [
    [1.70505, -0.62179, -0.08326],
    [-0.13026, 1.14080, -0.01055],
    [-0.02400, -0.12897, 1.15297],
]


def test_primaries_of_a_file_are_honoured(tmp_path: Path, recorded: None) -> None:
    assert np.allclose(rec709_from(AP1), ACESCG_TO_REC709, atol=2e-5)
    pixel = np.array([0.4, 0.5, 0.6], np.float32)
    notes: dict[str, Any] = {"chromaticities": AP1}
    write_stored(tmp_path / "sky.exr", Stored(pixel[None, None], "RGB", notes), "float")
    scene = good()
    for space, wanted in ((None, ACESCG_TO_REC709 @ pixel), ("linear", pixel)):
        scene["environment"] = {"file": "sky.exr", "color_space": space}
        made = described(scene, tmp_path)
        assert np.allclose(made.of("set_environment")[0][0][0, 0], wanted, atol=2e-5)


def test_rec709_in_other_words_is_left_alone() -> None:
    d50 = (0.64845, 0.33088, 0.32119, 0.59789, 0.15590, 0.06606, 0.34571, 0.35854)
    pixels = np.random.default_rng(0).random((4, 4, 3)).astype(np.float32)
    for chromaticities in (REC709, d50):
        assert convert_to_rec709(pixels, chromaticities) is pixels


def test_unused_textures_are_not_read(tmp_path: Path, recorded: None) -> None:
    scene = textured(tmp_path)
    (tmp_path / "broken.png").write_bytes(b"not a picture")
    scene["textures"] = {"broken": {"file": "broken.png"}, **scene["textures"]}
    made = described(scene, tmp_path)
    assert len(made.of("add_texture")) == 1
    assert made.of("add_material")[1][1]["albedo"] == ("texture", 0)


def test_broken_images_are_refused(tmp_path: Path) -> None:
    scene = textured(tmp_path)
    (tmp_path / "wood.png").write_bytes(b"not a picture")
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(scene, asset_root=tmp_path).flatten()
    (error,) = caught.value.errors
    assert (error["pointer"], error["code"]) == ("/textures/wood/file", "asset_unreadable")


def test_numbers_take_no_srgb_texture(tmp_path: Path, recorded: None) -> None:
    scene = textured(tmp_path)
    scene["materials"]["ball"]["alpha"] = {"texture": "wood"}
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(scene, asset_root=tmp_path).flatten()
    (error,) = caught.value.errors
    assert (error["pointer"], error["code"]) == (
        "/materials/ball/alpha/texture", "wrong_color_space",
    )  # fmt: skip
    scene["textures"]["wood"]["color_space"] = "data"
    described(scene, tmp_path)


def test_arrays_may_be_given_in_python(recorded: None) -> None:
    scene = good()
    sky = np.zeros((4, 8, 3), np.float16)
    sky[0] = 2
    scene["environment"] = {"pixels": sky, "rotation_deg": 90, "scale": 2}
    scene["textures"]["grey"] = {"pixels": np.full((2, 2), 0.25)}
    scene["materials"]["floor"]["albedo"] = {"texture": "grey"}
    scene["shapes"][1]["positions"] = np.asarray(scene["shapes"][1]["positions"], np.float32)
    scene["shapes"][1]["triangles"] = np.asarray(scene["shapes"][1]["triangles"], np.uint8)
    scene["film"]["width"] = np.int64(16)
    scene["camera"]["vfov_deg"] = np.float32(35)
    made = described(scene)
    ((pixels, rotation, scale),) = made.of("set_environment")
    assert np.array_equal(pixels, sky.astype(np.float32)) and (rotation, scale) == (90, 2)
    ((texture, _),) = made.of("add_texture")
    assert texture.shape == (2, 2, 3) and (texture == 0.25).all()


def test_arrays_are_not_shared_with_the_caller() -> None:
    scene = good()
    positions = np.asarray(scene["shapes"][1]["positions"], np.float64)
    scene["shapes"][1]["positions"] = positions
    loaded = mt.load(scene)
    digest = loaded.digest
    positions += 1
    assert loaded.digest == digest
    with pytest.raises(ValueError, match="read-only"):
        loaded.model.shapes[1].positions[0] = 0  # type: ignore[union-attr,index]


def test_negative_environment_pixels_are_set_to_zero_and_noted(recorded: None) -> None:
    scene = good()
    scene["environment"] = {"pixels": np.array([[[1, -1, 2], [0, 0, -3]]])}
    flattened = mt.load(scene).flatten()
    made: Any = flattened.description
    assert made.of("set_environment")[0][0].min() == 0
    assert [(n["code"], n["count"]) for n in flattened.notes] == [("negative_pixels", 2)]


def test_the_real_core_takes_it_all(tmp_path: Path) -> None:
    scene = textured(tmp_path)
    scene["lights"] += [
        {"type": "point", "position": [2, 3, 2], "intensity": [5, 6, 7]},
        {"type": "directional", "direction": [0, -1, 0], "irradiance": 2},
    ]
    scene["environment"] = {"pixels": np.ones((4, 8, 3))}
    scene["shapes"][1]["uv"] = [[0, 0], [1, 0], [1, 1], [0, 1]]
    scene["film"]["crop"] = [0, 0, 8, 8]
    loaded = mt.load(scene, asset_root=tmp_path)
    built = loaded.build(threads=1)
    stats = built.stats()
    assert stats["spheres"] == 1 and stats["materials"] == 2
    assert loaded.build() is built


def test_every_core_material_can_be_built() -> None:
    """With required parameters only; what a rule asks for is taken from its first choice."""
    sample = {"metal": "Cu", "color": 0.5, "scalar": 1.5, "material": {"type": "lambert"}}
    for row in mt.materials():
        if row["type"] == "measured":
            continue  # needs a file: tests/material/test_measured.py
        kinds = {p["name"]: p["kind"] for p in row["params"]}
        names = [p["name"] for p in row["params"] if p["required"]]
        names += [choices[0] for choices in row["one_of"]]
        scene = good()
        chosen = {name: sample[kinds[name]] for name in names}
        scene["materials"]["ball"] = {"type": row["type"], **chosen}
        assert mt.load(scene).build(threads=1).stats()["materials"] == 2, row["type"]
