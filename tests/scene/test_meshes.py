"""Mesh files: PLY, OBJ, GLB; normals, uv, names, node transforms, degenerate triangles."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from malformed import good

import matiere as mt
from matiere.scene.mesh_files import MeshFileError, read_parts

OBJ = """mtllib ../../etc/secret.mtl
o Body
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
v 0 0 2
vt 0 0
vt 1 0
vt 1 1
vn 0 0 1
usemtl Shell
f 1/1/1 2/2/1 3/3/1
f 1/1/1 3/3/1 4/1/1
o Foot
usemtl Stand
f 1 2 5
usemtl Shell
f 2 3 5
"""


def make_glb(header: dict[str, Any], binary: bytes) -> bytes:
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def two_primitive_glb(**changes: Any) -> bytes:
    """Return a GLB: a mesh of two primitives used by two nodes, the second moved and mirrored."""
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4").tobytes()
    normals = np.array([[0, 0, 1]] * 3, "<f4").tobytes()
    uv = np.array([[0, 0], [1, 0], [0, 1]], "<f4").tobytes()
    indices = np.array([0, 1, 2], "<u2").tobytes()
    binary, views = b"", []
    for blob in (positions, normals, uv, indices):
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(blob)})
        binary += blob + b"\0" * (-len(blob) % 4)
    attributes = {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}
    header: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0, 2]}],
        "nodes": [
            {"name": "Left", "mesh": 0},
            {"name": "Right", "mesh": 0, "translation": [10, 0, 0], "scale": [1, 1, -2]},
            {"name": "Group", "children": [1], "translation": [0, 5, 0]},
        ],
        "meshes": [
            {
                "name": "Tri",
                "primitives": [
                    {"attributes": attributes, "indices": 3, "material": 0},
                    {"attributes": attributes, "indices": 3},
                ],
            }
        ],
        "materials": [
            {"name": "Shell", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
        ],
        "textures": [{"source": 0}],
        "images": [{"uri": "../../../etc/passwd"}],
        "buffers": [{"byteLength": len(binary)}],
        "bufferViews": views,
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 2, "componentType": 5126, "count": 3, "type": "VEC2"},
            {"bufferView": 3, "componentType": 5123, "count": 3, "type": "SCALAR"},
        ],
        **changes,
    }
    return make_glb(header, binary)


def ply_text(extra: str = "", row: str = "{} {} {}", faces: str = "3 0 1 2\n") -> bytes:
    points = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)]
    body = "".join(row.format(*p) + "\n" for p in points)
    head = (
        "ply\nformat ascii 1.0\nelement vertex 4\n"
        "property double x\nproperty double y\nproperty double z\n" + extra
    )
    count = faces.count("\n")
    head += f"element face {count}\nproperty list uchar int vertex_indices\nend_header\n"
    return (head + body + faces).encode()


def mesh_scene(folder: Path, name: str, data: bytes, **keys: Any) -> mt.Scene:
    (folder / name).write_bytes(data)
    scene = good()
    scene["shapes"] = [{"type": "mesh", "file": name, **(keys or {"material": "floor"})}]
    return mt.load(scene, asset_root=folder)


def test_obj_parts_have_names_normals_and_uv() -> None:
    parts = {(p.names, p.material): p for p in read_parts("a.obj", OBJ.encode())}
    assert set(parts) == {
        (("Body",), "Shell"),
        (("Foot",), "Stand"),
        (("Foot",), "Shell"),
    }
    body = parts[("Body",), "Shell"]
    assert len(body.triangles) == 2
    assert body.normals is not None and np.allclose(body.normals, [0, 0, 1])
    assert body.uv is not None
    corner = body.positions[:, :2].tolist().index([1.0, 1.0])
    assert body.uv[corner].tolist() == [1, 1]
    assert parts[("Foot",), "Stand"].normals is None


def test_obj_without_names_is_one_part() -> None:
    (part,) = read_parts("a.obj", b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    assert (part.names, part.material, len(part.triangles)) == ((), None, 2)


FIVE = "v 0 0 0\nv 1 0 0\nv 1.5 1 0\nv .5 2 0\nv -.5 1 0\n"
MORE = "v 9 9 9\nv 8 8 8\nv 7 7 8\n"


def corners_of(text: str) -> list[list[list[float]]]:
    (part,) = read_parts("a.obj", text.encode())
    corners: list[list[list[float]]] = part.positions[part.triangles].tolist()
    return corners


@pytest.mark.parametrize(
    ("relative", "absolute"),
    [
        ("f -5 -4 -3\n", "f 1 2 3\n"),
        ("f -5 -4 -3\n" + MORE + "f -3 -2 -1\n", "f 1 2 3\n" + MORE + "f 6 7 8\n"),
        ("f 1 -4 3\n" + MORE, "f 1 2 3\n" + MORE),
        ("f 1 2 3 4 5\n", "f 1 2 3\nf 1 3 4\nf 1 4 5\n"),
        ("f 1 2 \\\n3\r\n", "f 1 2 3\n"),
    ],
)
def test_obj_indices_and_polygons_follow_the_specification(relative: str, absolute: str) -> None:
    assert corners_of(FIVE + relative) == corners_of(FIVE + absolute)


def test_obj_relative_normals_and_uv_count_their_own_kind() -> None:
    text = FIVE + "vt 0 0\nvt 1 0\nvn 0 0 1\nf -5/-2/-1 -4/-1/-1 -3/-2/-1\nvt 9 9\nvn 1 0 0\n"
    (part,) = read_parts("a.obj", text.encode())
    assert part.normals is not None and part.uv is not None
    assert np.allclose(part.normals, [0, 0, 1])
    assert sorted(part.uv.tolist()) == [[0, 0], [0, 0], [1, 0]]


@pytest.mark.parametrize("face", ["f 0 1 2", "f 1 2 6", "f -6 1 2", "f 1 2 -0"])
def test_obj_indices_that_lead_nowhere_are_refused(face: str) -> None:
    with pytest.raises(MeshFileError):
        read_parts("a.obj", (FIVE + face + "\n").encode())


def test_obj_positions_are_double() -> None:
    (part,) = read_parts("a.obj", b"v 1000000.0000001 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert part.positions.max() == 1000000.0000001


def test_ply_keeps_normals_and_uv_together() -> None:
    extra = "".join(f"property float {n}\n" for n in ("nx", "ny", "nz", "u", "v"))
    row = "{0} {1} {2} 0 0 1 {0} {1}"
    (part,) = read_parts("a.ply", ply_text(extra, row, "3 0 1 2\n3 1 3 2\n"))
    assert part.normals is not None and part.uv is not None
    assert np.allclose(part.normals, [0, 0, 1])
    assert np.allclose(part.uv, part.positions[:, :2])


def test_ply_quads_become_triangles() -> None:
    (part,) = read_parts("a.ply", ply_text(faces="4 0 1 3 2\n"))
    corners = part.positions[part.triangles]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    assert np.allclose(area.sum(axis=0), [0, 0, 1])


def test_glb_nodes_are_placed_and_named() -> None:
    parts = {(p.names[0], p.material): p for p in read_parts("a.glb", two_primitive_glb())}
    assert set(parts) == {(n, m) for n in ("Left", "Right") for m in ("Shell", None)}
    for (node, _), part in parts.items():
        a, b, c = part.positions[part.triangles[0]]
        front = np.cross(b - a, c - a)
        assert part.normals is not None and part.uv is not None
        assert front @ part.normals[0] > 0
        wanted = [0, 0, 1] if node == "Left" else [0, 0, -1]
        assert np.allclose(part.normals, wanted)
        origin = [0, 0, 0] if node == "Left" else [10, 5, 0]
        assert np.allclose(part.positions.min(axis=0), origin)
        # glTF counts v downwards, we count it upwards
        assert part.uv[part.positions[:, 1].argmax()].tolist() == [0, 0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"buffers": [{"byteLength": 8, "uri": "../x.bin"}]}, "another file"),
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "KHR_draco"),
        ({"meshes": [{"primitives": [{"attributes": {"POSITION": 99}}]}]}, "not a readable GLB"),
        ({"scenes": [{"nodes": []}]}, "no triangles"),
        ({"accessors": [{"componentType": 5126, "count": 10**12, "type": "VEC3"}] * 4}, "claims"),
    ],
)
def test_glb_that_cannot_be_used_says_why(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(MeshFileError, match=words):
        read_parts("a.glb", two_primitive_glb(**changes))


def test_glb_whose_nodes_run_in_a_circle_ends() -> None:
    nodes = [
        {"name": "A", "mesh": 0, "children": [1]},
        {"name": "B", "children": [0]},
    ]
    data = two_primitive_glb(nodes=nodes, scenes=[{"nodes": [0]}])
    try:
        parts = read_parts("a.glb", data)
    except MeshFileError:
        return
    assert len(parts) == 2


@pytest.mark.parametrize("name", ["a.ply", "a.obj", "a.glb"])
@pytest.mark.parametrize(
    "data", [b"", b"\0" * 64, b"ply\nformat ascii 1.0\nend_header\n", b"glTF" + b"\xff" * 60]
)
def test_garbage_is_an_error_in_words(name: str, data: bytes, tmp_path: Path) -> None:
    scene = mesh_scene(tmp_path, name, data)
    with pytest.raises(mt.SceneValidationError) as caught:
        scene.flatten()
    (error,) = caught.value.errors
    assert (error["pointer"], error["code"]) == ("/shapes/0/file", "asset_unreadable")
    assert name in error["message"]


def test_truncated_files_never_crash(tmp_path: Path) -> None:
    whole = {"a.glb": two_primitive_glb(), "a.obj": OBJ.encode(), "a.ply": ply_text()}
    for name, data in whole.items():
        for cut in range(0, len(data), 37):
            try:
                read_parts(name, data[:cut])
            except MeshFileError:
                continue


@pytest.mark.filterwarnings("ignore")  # numpy warns of numbers that came out odd
def test_damaged_files_never_crash() -> None:
    rng = np.random.default_rng(7)
    extra = "".join(f"property float {n}\n" for n in ("nx", "ny", "nz", "u", "v"))
    ply = ply_text(extra, "{0} {1} {2} 0 0 1 {0} {1}", "3 0 1 2\n3 1 3 2\n")
    whole = {"a.glb": two_primitive_glb(), "a.obj": OBJ.encode(), "a.ply": ply}
    for name, data in whole.items():
        for _ in range(150):
            damaged = np.frombuffer(data, np.uint8).copy()
            spots = rng.integers(len(damaged), size=int(rng.integers(1, 6)))
            damaged[spots] = rng.integers(256, size=len(spots))
            try:
                parts = read_parts(name, damaged.tobytes())
            except MeshFileError:
                continue
            for part in parts:
                assert part.triangles.max(initial=0) < max(len(part.positions), 1)


def test_wrong_names_list_those_present(tmp_path: Path) -> None:
    scene = mesh_scene(
        tmp_path, "a.glb", two_primitive_glb(), materials={"Shel": "ball", "Left": "floor"}
    )
    with pytest.raises(mt.SceneValidationError) as caught:
        scene.flatten()
    first, *others = caught.value.errors
    assert (first["pointer"], first["code"]) == ("/shapes/0/materials/Shel", "unknown_name")
    assert first["suggestion"] == "Shell"
    assert all(name in first["message"] for name in ("Left", "Right", "Shell", "Tri"))
    assert {e["pointer"] for e in others} == {"/shapes/0/materials"}


def test_node_names_win_over_material_names(tmp_path: Path, recorded: None) -> None:
    scene = mesh_scene(
        tmp_path,
        "a.glb",
        two_primitive_glb(),
        materials={"Shell": "ball", "Right": "floor", "*": "floor"},
    )
    description: Any = scene.flatten().description
    used = sorted((m[0][:, 0].max() > 2, m[4]) for m in description.of("add_mesh"))
    # node Left: Shell -> ball (0), the nameless rest -> floor (1); node Right: all floor (1)
    assert used == [(False, 0), (False, 1), (True, 1), (True, 1)]


def test_degenerate_triangles_are_counted(tmp_path: Path, recorded: None) -> None:
    data = b"v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nf 1 2 4\nf 1 2 3\nf 1 1 4\n"
    scene = mesh_scene(tmp_path, "a.obj", data)
    flattened = scene.flatten()
    description: Any = flattened.description
    assert description.of("add_mesh")[0][1].shape == (1, 3)
    (note,) = flattened.notes
    assert (note["code"], note["count"]) == ("degenerate_triangles", 2)
    assert scene.notes == flattened.notes


def test_a_mesh_without_any_area_is_refused(tmp_path: Path) -> None:
    scene = mesh_scene(tmp_path, "a.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    with pytest.raises(mt.SceneValidationError) as caught:
        scene.flatten()
    assert caught.value.errors[0]["code"] == "degenerate"


def test_normals_without_length_are_made_anew(tmp_path: Path, recorded: None) -> None:
    data = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 0\nvn 0 0 2\nf 1//1 2//2 3//2\n"
    flattened = mesh_scene(tmp_path, "a.obj", data).flatten()
    description: Any = flattened.description
    assert np.allclose(description.of("add_mesh")[0][2], [0, 0, 1])
    assert [n["code"] for n in flattened.notes] == ["repaired_normals"]


def test_nan_in_a_file_is_refused(tmp_path: Path) -> None:
    scene = mesh_scene(tmp_path, "a.obj", b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(mt.SceneValidationError, match="NaN"):
        scene.flatten()


def test_sample_assets_load(shared_assets: Path, recorded: None) -> None:
    counts = {
        "meshes/materialx_shaderball.glb": 88264,
        "meshes/standard_shader_ball/openpbr_objects.glb": 46704,
        "meshes/stanford/bunny.ply": 69451,
        "meshes/materialx_teapot.obj": 25200,
        "gltf/BoxTextured/glTF-Binary/BoxTextured.glb": 12,
    }
    for name, triangles in counts.items():
        scene = good()
        scene["shapes"] = [{"type": "mesh", "file": name, "material": "floor"}]
        description: Any = mt.load(scene, asset_root=shared_assets).flatten().description
        assert sum(len(call[1]) for call in description.of("add_mesh")) == triangles, name
