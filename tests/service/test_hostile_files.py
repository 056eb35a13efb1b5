"""Files and numbers no honest client sends, against a real service whose renders are paused.

Each is answered by a problem with a pointer, or accepted where it is in order; never by 5xx. The
service process itself decodes nothing: its memory hardly grows, and no child dies.
"""

from __future__ import annotations

import copy
import hashlib
import json
import struct
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import psutil
import pytest

pytest.importorskip("matiere._core", reason="needs the built core")
pytest.importorskip("schemathesis", reason="needs the dev group")

from api_fuzz import GROWTH_BYTES, paused_service
from malformed import GOOD

OCTETS = {"Content-Type": "application/octet-stream"}
HUGE = 2**31 - 1
Json = dict[str, Any]


class Target:
    """A paused service and what was measured of it."""

    def __init__(self, url: str, pid: int) -> None:
        self.http = httpx.Client(base_url=url, timeout=120, trust_env=False)
        self.process = psutil.Process(pid)
        self.begun = 0

    def upload(self, data: bytes) -> str:
        """Upload bytes and return their digest."""
        digest = hashlib.sha256(data).hexdigest()
        put = self.http.put(f"/v1/assets/{digest}", content=data, headers=OCTETS)
        assert put.status_code in (200, 201), put.text
        return digest

    def submit(self, body: Json) -> httpx.Response:
        """Submit, judge the answer, and delete what was accepted."""
        text = json.dumps(body)
        answer = self.http.post(
            "/v1/jobs", content=text, headers={"Content-Type": "application/json"}
        )
        told = (answer.status_code, answer.text[:400])
        assert answer.status_code < 500, told
        if answer.status_code >= 400:
            assert answer.headers["content-type"] == "application/problem+json", told
            assert len(answer.content) < 50_000
        else:
            gone = self.http.delete(f"/v1/jobs/{answer.json()['id']}")
            assert gone.status_code == 204, gone.text
        if not self.begun:
            self.begun = self.process.memory_info().rss
        return answer

    def check(self) -> None:
        """Tell that it works as before."""
        assert self.http.get("/healthz").status_code == 200
        lost = self.http.get("/v1/status").json()["counters"].get("children_lost", 0)
        assert lost == 0, "a child was killed by a file"
        grown = self.process.memory_info().rss - self.begun
        assert grown < GROWTH_BYTES, f"{grown / 2**20:.0f} MiB more"


@pytest.fixture(scope="module")
def target(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Target]:
    """Serve without rendering."""
    with paused_service(tmp_path_factory.mktemp("files")) as (serving, url):
        found = Target(url, serving.pid)
        end = time.monotonic() + 240
        while found.http.get("/readyz").status_code != 200:
            assert time.monotonic() < end, "not ready"
            time.sleep(0.1)
        found.submit({"scene": GOOD})
        yield found
        found.http.close()


def exr(x1: int, y1: int, rest: bytes = b"", x0: int = 0, y0: int = 0, comp: int = 0) -> bytes:
    """Return the begin of an OpenEXR file whose data window is as given."""

    def attribute(name: str, kind: str, value: bytes) -> bytes:
        head = name.encode() + b"\0" + kind.encode() + b"\0"
        return head + struct.pack("<i", len(value)) + value

    channel = b"".join(
        name + b"\0" + struct.pack("<iBBBBii", 1, 0, 0, 0, 0, 1, 1) for name in (b"B", b"G", b"R")
    )
    window = struct.pack("<4i", x0, y0, x1, y1)
    attributes = [
        attribute("channels", "chlist", channel + b"\0"),
        attribute("compression", "compression", bytes([comp])),
        attribute("dataWindow", "box2i", window),
        attribute("displayWindow", "box2i", window),
        attribute("lineOrder", "lineOrder", b"\0"),
        attribute("pixelAspectRatio", "float", struct.pack("<f", 1.0)),
        attribute("screenWindowCenter", "v2f", struct.pack("<2f", 0.0, 0.0)),
        attribute("screenWindowWidth", "float", struct.pack("<f", 1.0)),
    ]
    return struct.pack("<ii", 20000630, 2) + b"".join(attributes) + b"\0" + rest


def png(width: int, height: int, rows: bytes, depth: int = 8, colour: int = 2) -> bytes:
    """Return a PNG whose header may promise more than `rows` hold."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        sum_ = zlib.crc32(kind + data)
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", sum_)

    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0)
    begin = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header)
    return begin + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


IMAGES = {
    "huge.exr": exr(HUGE - 1, HUGE - 1),
    "wide.exr": exr(HUGE - 1, 0),
    "turned.exr": exr(-5, -5),
    "far.exr": exr(HUGE, HUGE, x0=-HUGE, y0=-HUGE),
    "compression.exr": exr(7, 7, comp=200),
    "offsets.exr": exr(7, 7, struct.pack("<8Q", *[2**63] * 8)),
    "zip.exr": exr(4095, 4095, struct.pack("<256Q", *range(256)) + bytes(4096), comp=3),
    "cut.exr": exr(7, 7)[:40],
    "multipart.exr": struct.pack("<ii", 20000630, 2 | 0x1800) + b"\0" * 64,
    "huge.png": png(HUGE, HUGE, b""),
    "none.png": png(0, 0, b""),
    "depth.png": png(8, 8, zlib.compress(bytes(400)), depth=77),
    "bomb.png": png(16_000, 16_000, zlib.compress(bytes(20_000_000), 9)),
    "junk.png": b"\x89PNG\r\n\x1a\n" + b"\xff" * 1000,
    "huge.hdr": b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2147483647 +X 2147483647\n\x02\x02\xff",
    "minus.hdr": b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y -8 +X -8\n",
    "empty.exr": b"",
    "text.jpg": b"not an image" * 100,
    "archive.zip": b"PK\x03\x04" + bytes(100),
}


@pytest.mark.parametrize("name", IMAGES)
def test_an_absurd_image_is_refused_by_its_header(target: Target, name: str) -> None:
    digest = target.upload(IMAGES[name])
    for part, at in (
        ({"environment": {"file": name}}, "/scene/environment/file"),
        ({"textures": {"wood": {"file": name}}}, "/scene/textures/wood/file"),
    ):
        scene = copy.deepcopy(GOOD) | part
        if "textures" in part:
            scene["materials"]["floor"]["albedo"] = {"texture": "wood"}
        answer = target.submit({"scene": scene, "assets": {name: digest}})
        if answer.status_code == 422:
            pointers = [error["pointer"] for error in answer.json()["errors"]]
            assert any(p.startswith(at) or p == "/scene" for p in pointers), answer.text[:400]
        else:  # what only decoding finds fails the job, in a render process
            assert answer.status_code == 202, answer.text[:400]
    target.check()


def glb(header: Json, binary: bytes = b"") -> bytes:
    """Return a binary glTF."""
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    chunks += struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def gltf(**changes: Any) -> Json:
    """Return a glTF of one triangle, changed."""
    made: Json = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "buffers": [{"byteLength": 36}], "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
    }  # fmt: skip
    return {**made, **changes}


def accessor(**changes: Any) -> Json:
    return {"accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
                           **changes}]}  # fmt: skip


TRIANGLE = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
DEEP_NODES = {"nodes": [{"children": [n + 1]} for n in range(20_000)] + [{"mesh": 0}]}
MESHES = {
    "count.glb": glb(gltf(**accessor(count=2**40)), TRIANGLE),
    "count53.glb": glb(gltf(**accessor(count=2**53)), TRIANGLE),
    "negative.glb": glb(gltf(**accessor(count=-1)), TRIANGLE),
    "fraction.glb": glb(gltf(**accessor(count=1.5)), TRIANGLE),
    "offset.glb": glb(gltf(**accessor(byteOffset=2**62)), TRIANGLE),
    "minus.glb": glb(gltf(**accessor(byteOffset=-36)), TRIANGLE),
    "no_view.glb": glb(gltf(accessors=[{"componentType": 5126, "count": 10**9, "type": "VEC3"}])),
    "stride.glb": glb(gltf(bufferViews=[{"buffer": 0, "byteLength": 36, "byteStride": 2**31}]),
                      TRIANGLE),
    "view.glb": glb(gltf(bufferViews=[{"buffer": 0, "byteOffset": 2**60, "byteLength": 2**60}]),
                    TRIANGLE),
    "buffer.glb": glb(gltf(buffers=[{"byteLength": 2**60}]), TRIANGLE),
    "nodes.glb": glb(gltf(nodes=[{"children": [0], "mesh": 0}]), TRIANGLE),
    "deep_nodes.glb": glb(gltf(**DEEP_NODES), TRIANGLE),
    "many.glb": glb(gltf(nodes=[{"mesh": 0}], scenes=[{"nodes": [0] * 100_000}]), TRIANGLE),
    "matrix.glb": glb(gltf(nodes=[{"mesh": 0, "matrix": [1e308] * 16}]), TRIANGLE),
    "nan.glb": glb(gltf(), struct.pack("<9f", *[float("nan")] * 9)),
    "far.glb": glb(gltf(), struct.pack("<9f", *[3e38] * 9)),
    "climbs.gltf": json.dumps(gltf(buffers=[{"uri": "../../../etc/passwd", "byteLength": 36}]))
    .encode(),
    "absolute.gltf": json.dumps(gltf(buffers=[{"uri": "/etc/passwd", "byteLength": 36}])).encode(),
    "remote.gltf": json.dumps(gltf(buffers=[{"uri": "http://127.0.0.1:1/x", "byteLength": 36}]))
    .encode(),
    "data.gltf": json.dumps(gltf(buffers=[{"uri": "data:;base64,!", "byteLength": 36}])).encode(),
    "deep.gltf": b'{"asset": ' + b"[" * 100_000 + b"]" * 100_000 + b"}",
    "chunk.glb": struct.pack("<4sIIII", b"glTF", 2, 2**32 - 1, 2**32 - 1, 0x4E4F534A) + b"{}",
    "vertices.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\n"
    b"property float x\nproperty float y\nproperty float z\nelement face 4000000000\n"
    b"property list uchar int vertex_indices\nend_header\n" + TRIANGLE,
    "minus.ply": b"ply\nformat ascii 1.0\nelement vertex -3\nproperty float x\nend_header\n",
    "list.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 1\n"
    b"property list uint float x\nend_header\n" + b"\xff" * 64,
    "indices.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999999999999\n",
    "numbers.obj": b"v 1e999 nan -inf\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
    "zero.glb": b"",
}  # fmt: skip


@pytest.mark.parametrize("name", MESHES)
def test_an_absurd_mesh_is_refused_with_its_place(target: Target, name: str) -> None:
    scene = copy.deepcopy(GOOD)
    scene["shapes"][1] = {"type": "mesh", "file": name, "material": "floor"}
    answer = target.submit({"scene": scene, "assets": {name: target.upload(MESHES[name])}})
    if name in FINE:
        assert answer.status_code == 202, answer.text[:400]
    else:
        assert answer.status_code == 422, answer.text[:400]
        assert answer.json()["errors"][0]["pointer"].startswith("/scene"), answer.text[:400]
    target.check()


# Many triangles, a length that nobody reads, a long chain of nodes: all can be done.
FINE = ("many.glb", "buffer.glb", "deep_nodes.glb")


def leaves(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the paths of all values that hold no others."""
    if isinstance(value, dict | list) and value:
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, inner in items:
            yield from leaves(inner, (*path, key))
    else:
        yield path


STRANGE = [1e308, -1e308, 5e-324, 2**64, "..", "\u0000", "/etc/passwd", [], {}, None, True, 1e999]


@pytest.mark.parametrize("value", STRANGE, ids=lambda value: repr(value)[:12])
def test_every_value_of_a_scene_may_be_anything(target: Target, value: Any) -> None:
    """One at a time; what is in range is accepted, the rest has its pointer."""
    accepted = 0
    for path in leaves(GOOD):
        scene = copy.deepcopy(GOOD)
        place: Any = scene
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = value
        answer = target.submit({"scene": scene})
        accepted += answer.status_code == 202
        if answer.status_code >= 400:
            assert answer.status_code in (400, 413, 422), (path, answer.text[:300])
            assert answer.json()["errors"], (path, answer.text[:300])
    print(f"{accepted} accepted")
    target.check()


def test_names_that_lead_out_are_refused(target: Target, tmp_path: Path) -> None:
    secret = tmp_path / "secret.ply"
    secret.write_text("ply\n")
    names = ["../secret.ply", str(secret), "a/../../secret.ply", "\\\\host\\share", "file:///x",
             "con\u0000", "a" * 5000, ".sha256/" + "0" * 64, ".uploads/" + "0" * 64]  # fmt: skip
    for name in names:
        scene = copy.deepcopy(GOOD)
        scene["shapes"][1] = {"type": "mesh", "file": name, "material": "floor"}
        for assets in ({}, {name: "0" * 64}):
            answer = target.submit({"scene": scene, "assets": assets})
            assert answer.status_code == 422, (name, answer.text[:300])
    target.check()
