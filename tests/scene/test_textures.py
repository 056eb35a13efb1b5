"""Texture files: as narrow in memory as on disk, channels, uv sets and transforms."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import matiere as mt
from matiere import _core
from matiere.imageio import Stored, read_texture, write_stored
from matiere.scene.lights import TextureTransform

ASSETS = Path(__file__).resolve().parents[3] / "shared" / "assets" / "gltf"
needs_assets = pytest.mark.skipif(not ASSETS.is_dir(), reason="../shared/assets is not here")
CAMERA = {"type": "orthographic", "origin": [0, 0, 5], "target": [0, 0, 0], "height": 2}
QUAD = {
    "type": "mesh", "material": "m",
    "positions": [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]],
    "triangles": [[0, 1, 2], [0, 2, 3]], "uv": [[0, 0], [1, 0], [1, 1], [0, 1]],
}  # fmt: skip


def scene(size: int = 4, **texture: Any) -> dict[str, Any]:
    return {
        "version": 1, "camera": CAMERA,
        "film": {"width": size, "height": size, "filter": "box"},
        "render": {"max_depth": 1},
        "textures": {"t": texture},
        "materials": {"m": {"type": "lambert", "albedo": {"texture": "t"}}},
        "shapes": [QUAD], "environment": {"radiance": 1},
    }  # fmt: skip


def picture(document: dict[str, Any], folder: Path | None = None, spp: int = 16) -> np.ndarray:
    return mt.render(mt.load(document, asset_root=folder), spp=spp, threads=2).mean


@pytest.mark.parametrize(
    ("pixel_type", "suffix", "dtype"),
    [
        ("uint8", ".png", np.uint8),
        ("uint16", ".png", np.uint16),
        ("half", ".exr", np.float16),
        ("float", ".exr", np.float32),
    ],
)
def test_files_keep_their_format(tmp_path: Path, pixel_type: str, suffix: str, dtype: Any) -> None:
    values = np.random.default_rng(1).random((3, 5, 3))
    stored = values.astype(dtype) if suffix == ".exr" else (values * 250).astype(dtype)
    path = tmp_path / f"a{suffix}"
    write_stored(path, Stored(stored, "RGB", {}), pixel_type)
    read = read_texture(path)
    assert read.pixels.dtype == dtype
    assert np.array_equal(read.pixels, stored)
    only = read_texture(path, "g").pixels
    assert only.shape == (3, 5, 1) and np.array_equal(only[..., 0], stored[..., 1])


def test_grey_files_take_one_channel(tmp_path: Path) -> None:
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4, 1)
    write_stored(tmp_path / "a.png", Stored(grey, "Y", {}), "uint8")
    assert read_texture(tmp_path / "a.png").pixels.shape == (3, 4, 1)
    with pytest.raises(mt.ImageError, match="no channel 'a'"):
        read_texture(tmp_path / "a.png", "a")


def rgba(folder: Path) -> None:
    pixels = np.zeros((1, 2, 4), np.uint8)
    pixels[0] = [(255, 128, 0, 51), (255, 128, 0, 255)]
    write_stored(folder / "a.png", Stored(pixels, "RGBA", {}), "uint8")


def test_alpha_of_an_image_is_opacity(tmp_path: Path) -> None:
    rgba(tmp_path)
    document = scene(2, file="a.png")
    document["textures"]["holes"] = {"file": "a.png", "channel": "a", "filter": "nearest"}
    document["materials"]["m"] = {
        "type": "lambert", "albedo": 0.0, "opacity": {"texture": "holes"},
    }  # fmt: skip
    got = picture(document, tmp_path, 1024)[:, :, 0]
    assert got == pytest.approx(np.array([[0.8, 0.0]] * 2), abs=0.03)


@pytest.mark.parametrize(
    ("texture", "at", "code"),
    [
        ({"pixels": [[1.0]], "channel": "a"}, "/textures/t/channel", "unknown_choice"),
        ({"pixels": [[1.0]], "wrap": "tile"}, "/textures/t/wrap", "unknown_choice"),
        ({"pixels": [[1.0]], "filter": "mip"}, "/textures/t/filter", "unknown_choice"),
        ({"pixels": [[1.0]], "uv_set": 2}, "/textures/t/uv_set", "unknown_choice"),
        (
            {"pixels": [[1.0]], "transform": {"scale": [0, 1]}},
            "/textures/t/transform/scale",
            "degenerate",
        ),
        (
            {"pixels": [[1.0]], "transform": {"offset": 1}},
            "/textures/t/transform/offset",
            "wrong_type",
        ),
        (
            {"file": "a.png", "channel": "a", "color_space": "sRGB"},
            "/textures/t/color_space",
            "unknown_choice",
        ),
    ],
)
def test_faults_have_their_place(
    texture: dict[str, Any], at: str, code: str, tmp_path: Path
) -> None:
    rgba(tmp_path)
    with pytest.raises(mt.SceneValidationError) as caught:
        mt.load(scene(**texture), asset_root=tmp_path)
    assert [(f.pointer, f.code) for f in caught.value.faults] == [(at, code)]


def test_transforms_are_those_of_gltf() -> None:
    """A point of the plane by the matrices of the extension, v downwards."""
    t = TextureTransform.model_validate(
        {"scale": [1.5, 0.7], "rotation_deg": 20, "offset": [0.2, -0.1]}
    )
    cos, sin = np.cos(np.radians(20)), np.sin(np.radians(20))
    gltf = np.array([[cos, sin], [-sin, cos]]) @ np.diag([1.5, 0.7])
    a, b, c, d, x, y = t.matrix
    for u, v in np.random.default_rng(2).random((5, 2)):
        want = gltf @ (u, v) + (0.2, -0.1)
        got = (a * u + b * (1 - v) + x, 1 - (c * u + d * (1 - v) + y))
        assert got == pytest.approx(want)


def glb(header: dict[str, Any], data: bytes) -> bytes:
    text = json.dumps({**header, "buffers": [{"byteLength": len(data)}]}).encode()
    text += b" " * (-len(text) % 4)
    data += b"\0" * (-len(data) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(data), 0x004E4942) + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def test_the_second_uv_set_of_a_glb(tmp_path: Path) -> None:
    positions = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], np.float32)
    uv, uv1 = np.array([[0, 0], [1, 0], [0.5, 1]], np.float32), np.full((3, 2), 0.9, np.float32)
    uv1[:, 1] = 0.25
    data = b"".join(a.tobytes() for a in (positions, uv, uv1))
    views = [(0, 36), (36, 24), (60, 24)]
    header = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [
            {"attributes": {"POSITION": 0, "TEXCOORD_0": 1, "TEXCOORD_1": 2}}]}],
        "bufferViews": [{"buffer": 0, "byteOffset": o, "byteLength": n} for o, n in views],
        "accessors": [
            {"bufferView": i, "componentType": 5126, "count": 3, "type": kind,
             "min": [-1, -1, 0], "max": [1, 1, 0]} if i == 0 else
            {"bufferView": i, "componentType": 5126, "count": 3, "type": kind}
            for i, kind in enumerate(("VEC3", "VEC2", "VEC2"))
        ],
    }  # fmt: skip
    (tmp_path / "a.glb").write_bytes(glb(header, data))
    from matiere.scene.mesh_files import read_parts

    (part,) = read_parts("a.glb", (tmp_path / "a.glb").read_bytes())
    assert part.uv is not None and part.uv1 is not None
    assert part.uv == pytest.approx(np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1))
    assert part.uv1 == pytest.approx(np.array([[0.9, 0.75]] * 3))


PEAK = """
import resource, sys, numpy as np
import matiere as mt
from matiere.imageio import Stored, write_stored
document = {document}
document["textures"]["t"] = {{"file": sys.argv[1], "filter": "trilinear"}}
scene = mt.load(document, asset_root=sys.argv[2])
import OpenImageIO, matiere.scene.flatten
def peak():
    text = open("/proc/self/status").read()
    return int(text.split("VmHWM:")[1].split()[0]) * 1024
mt.render(mt.load({document}, asset_root=sys.argv[2]), spp=4, threads=1)
before = peak()
built = scene.build(1)
print(built.stats()["bytes"], peak() - before)
"""


def test_an_8_bit_texture_costs_its_bytes_and_no_floats(tmp_path: Path) -> None:
    """5 bytes a texel with its mip levels, where floats would be 16, and little more meanwhile."""
    edge = 2048
    pixels = np.zeros((edge, edge, 3), np.uint8)
    pixels[::2] = 200
    write_stored(tmp_path / "big.png", Stored(pixels, "RGB", {}), "uint8")
    document = scene(pixels=[[0.5]])
    code = PEAK.format(document=repr(document))
    done = subprocess.run(
        [sys.executable, "-c", code, "big.png", str(tmp_path)],
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    held, grown = map(int, done.stdout.split())
    texels = edge * edge
    assert 5 * texels <= held < 5.01 * texels + 2000
    assert grown < 13 * texels, grown / texels  # numpy's copy and the decoder's besides


@needs_assets
def test_the_gltf_transform_test_points_to_the_green_markers() -> None:
    """Each arrow of TextureTransformTest must point where the file's own marker says."""
    folder = ASSETS / "TextureTransformTest" / "glTF"
    told = json.loads((folder / "TextureTransformTest.gltf").read_text())
    arrow = read_texture(folder / "Arrow.png").pixels
    markers = {n["name"]: n for n in told["nodes"]}
    for name in ("Rotation", "Scale", "All"):
        (given,) = (m for m in told["materials"] if m["name"] == name)
        info = given["pbrMetallicRoughness"]["baseColorTexture"]["extensions"]
        info = info["KHR_texture_transform"]
        move = TextureTransform.model_validate(
            {
                "scale": info.get("scale", [1, 1]),
                "rotation_deg": float(np.degrees(info.get("rotation", 0))),
                "offset": info.get("offset", [0, 0]),
            }
        )
        texture = _core.probe.Texture(arrow, "clamp", srgb=True, transform=move.matrix)
        x, y, _ = markers[f"{name} - Correct"]["translation"]
        a, b, c, d, dx, dy = move.matrix
        back = np.linalg.inv(np.array([[a, b], [c, d]]))
        # Of the arrow in its image: it runs along the diagonal, v upwards.
        tail, tip = (back @ (np.array([t, 1 - t]) - (dx, dy)) for t in (0.15, 0.62))
        for point in (tail, tip):
            assert texture.lookup(*point)[0] < 0.05
        along = (tip - tail) / np.linalg.norm(tip - tail)
        gap = np.array([x, y]) - (tip - 0.5)
        assert abs(along[0] * gap[1] - along[1] * gap[0]) < 0.03, (name, gap, along)
        assert 0 < along @ gap < 0.35, (name, gap, along)
