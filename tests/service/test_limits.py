"""What is too large is refused at submission, with a pointer; a full queue asks to wait."""

from __future__ import annotations

import copy
import struct
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

pytest.importorskip("matiere._core", reason="needs the built core")

from matiere.jobs.engine import open_engine
from matiere.jobs.limits import Limits
from matiere.service.app import create_app
from matiere.service.openapi_examples import SMALLEST
from matiere.service.server import BackgroundServer, bind, url_of
from matiere.service.settings import Settings

LIMITS = {
    "max_pixels": 10_000, "max_spp": 1000, "max_depth": 50, "max_seconds": 60.0,
    "max_triangles": 100, "max_texture_bytes": 2**20, "max_job_bytes": 8 * 2**20,
    "max_queued_jobs": 6,
}  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the data directory."""
    return tmp_path_factory.mktemp("limits") / "data"


@pytest.fixture(scope="module")
def small(folder: Path) -> Iterator[httpx.Client]:
    """Serve a queue that takes little and renders nothing, for want of disk."""
    settings = Settings(data=folder, **LIMITS)  # type: ignore[arg-type]
    sock = bind("127.0.0.1", 0)
    with (
        open_engine(folder, children=1, limits=settings.limits(), min_free_bytes=2**62) as engine,
        BackgroundServer(create_app(engine, settings), sock),
        httpx.Client(base_url=url_of(sock), timeout=60, trust_env=False) as client,
    ):
        end = time.monotonic() + 120
        while not client.get("/v1/status").json()["children"][-1]["ready"]:
            assert time.monotonic() < end
            time.sleep(0.05)
        yield client


def scene(**parts: Any) -> dict[str, Any]:
    """Return a scene with other parts."""
    return copy.deepcopy(SMALLEST) | {"film": {"width": 8, "height": 8}} | parts


def png(width: int, height: int, rows: bytes) -> bytes:
    """Return an 8-bit RGB PNG whose header may promise more than `rows` hold."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
    )


def textured(name: str) -> dict[str, Any]:
    """Return a scene whose ball has an image."""
    made = scene(textures={"wood": {"file": name}})
    made["materials"]["ball"]["albedo"] = {"texture": "wood"}
    return made


TOO_LARGE = [
    ("pixels", {"scene": scene(film={"width": 101, "height": 100})}, "/scene/film"),
    ("spp", {"scene": scene(render={"spp": 1001})}, "/scene/render/spp"),
    ("stop spp", {"scene": scene(), "stop": {"spp": 1001}}, "/stop/spp"),
    ("seconds", {"scene": scene(), "stop": {"seconds": 61}}, "/stop/seconds"),
    ("depth", {"scene": scene(render={"max_depth": 51})}, "/scene/render/max_depth"),
    ("triangles", {"scene": scene(shapes=[{
        "type": "mesh", "material": "ball", "positions": [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
        "triangles": [[0, 1, 2]] * 101}])}, "/scene/shapes/0"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("body", "at"), [case[1:] for case in TOO_LARGE], ids=[case[0] for case in TOO_LARGE]
)
def test_what_is_too_large_is_422_with_its_place(
    small: httpx.Client, body: dict[str, Any], at: str
) -> None:
    answer = small.post("/v1/jobs", json=body)
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (422, "limit_exceeded"), answer.text
    assert [error["pointer"] for error in problem["errors"]] == [at]
    assert "this service allows" in problem["errors"][0]["message"]


def test_a_sweep_is_judged_cell_by_cell(small: httpx.Client) -> None:
    base = scene()
    axes = [{"pointer": "/film/width", "values": [8, 16, 20_000]}]
    problem = small.post("/v1/sweeps", json={"base": base, "axes": axes}).json()
    assert problem["code"] == "limit_exceeded"
    assert problem["errors"][0]["pointer"].startswith(("/axes/0/values/2", "/base/film"))


def test_a_decompression_bomb_is_refused_by_its_header(small: httpx.Client, folder: Path) -> None:
    """432 MB of texels in 10 kB, and two that promise more than any file can hold."""
    bombs = {
        "bomb.png": png(12_000, 12_000, zlib.compress(bytes(10_000_000), 9)),
        "huge.png": png(2**31 - 1, 2**31 - 1, b""),
        "wide.png": png(60_000, 40_000, b""),
    }
    for name, data in bombs.items():
        (folder / "assets").mkdir(exist_ok=True)
        (folder / "assets" / name).write_bytes(data)
        answer = small.post("/v1/jobs", json={"scene": textured(name)})
        problem = answer.json()
        assert answer.status_code == 422, answer.text
        assert problem["errors"][0]["pointer"] == "/scene/textures/wood/file"
        assert problem["errors"][0]["code"] in ("limit_exceeded", "asset_unreadable")
    children = small.get("/v1/status").json()
    assert children["counters"].get("children_lost", 0) == 0, children
    limit = small.post("/v1/jobs", json={"scene": textured("bomb.png")}).json()
    assert limit["code"] == "limit_exceeded"


def test_memory_is_estimated_for_the_whole_job(small: httpx.Client) -> None:
    """80 x 80 x 56 B x 64 replicates is 22 MiB; the film alone has no limit here."""
    big = scene(film={"width": 80, "height": 80}, render={"replicates": 64, "spp": 64})
    answer = small.post("/v1/jobs", json={"scene": big})
    assert (answer.status_code, answer.json()["code"]) == (422, "memory_limit"), answer.text
    assert answer.json()["errors"][0]["pointer"] == "/scene"


def test_a_full_queue_is_429_until_there_is_room(small: httpx.Client) -> None:
    base = scene(render={"spp": 4})
    axes = [{"pointer": "/materials/ball/alpha", "linspace": [0.1, 0.5, 7]}]
    never = small.post("/v1/sweeps", json={"base": base, "axes": axes})
    assert (never.status_code, never.json()["code"]) == (422, "limit_exceeded")
    assert never.json()["errors"][0]["pointer"] == "/axes"
    axes[0]["linspace"][2] = 4  # type: ignore[index]
    sweep = small.post("/v1/sweeps", json={"base": base, "axes": axes})
    assert sweep.status_code == 202, sweep.text
    headers = {"Idempotency-Key": "last"}
    jobs = [small.post("/v1/jobs", json={"scene": base}, headers=headers if n else {})
            for n in range(2)]  # fmt: skip
    assert [job.status_code for job in jobs] == [202, 202]
    for path, body in (("jobs", {"scene": base}), ("sweeps", {"base": base, "axes": axes})):
        full = small.post(f"/v1/{path}", json=body)
        assert (full.status_code, full.json()["code"]) == (429, "queue_full")
        assert int(full.headers["retry-after"]) > 0
    again = small.post("/v1/jobs", json={"scene": base}, headers=headers)
    assert (again.status_code, again.json()["id"]) == (202, jobs[1].json()["id"])
    assert small.post(f"/v1/jobs/{again.json()['id']}:cancel").status_code == 200
    assert small.post("/v1/jobs", json={"scene": base}).status_code == 202


def test_a_sweep_of_an_older_store_keeps_the_limit_it_had() -> None:
    assert Limits.of({"max_film_bytes": 123}).film_bytes == 123
    assert Limits.of({"limits": Limits(film_bytes=5).to_dict()}).film_bytes == 5
