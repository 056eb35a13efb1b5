"""The whole road over HTTP: submission, assets, render, files, sweep, contact sheet."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

pytest.importorskip("matiere._core", reason="needs the built core")

from malformed import GOOD
from real_queue import served_queue

from matiere.jobs.engine import Engine
from matiere.service.client import Client

PLY = b"""ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
-9 0 -9
9 0 -9
9 0 9
-9 0 9
3 0 2 1
3 0 3 2
"""
OCTETS = {"Content-Type": "application/octet-stream"}


@pytest.fixture(scope="module")
def queue(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Engine, str]]:
    """Serve a queue that renders for real."""
    with served_queue(tmp_path_factory.mktemp("real") / "data") as served:
        yield served


@pytest.fixture
def api(queue: tuple[Engine, str]) -> Iterator[Client]:
    """Return a client."""
    with Client(queue[1]) as client:
        yield client


def with_floor(name: str) -> dict[str, Any]:
    """Return the good scene with its floor in a file."""
    scene: dict[str, Any] = json.loads(json.dumps(GOOD))
    scene["shapes"][1] = {"type": "mesh", "file": name, "material": "floor"}
    return scene


def test_a_scene_becomes_files(api: Client, tmp_path: Path) -> None:
    job = api.wait(api.submit(GOOD).id, timeout_s=60)
    assert job.state == "succeeded", job.error
    assert job.relmse is not None and job.relmse_interval is not None
    low, high = job.relmse_interval
    assert low < job.relmse < high
    png = api.fetch(job.id, "image.png", tmp_path / "out.png").read_bytes()
    assert png.startswith(b"\x89PNG\r\n\x1a\n")
    exr = api.fetch(job.id, "image.exr", tmp_path / "out.exr").read_bytes()
    assert exr.startswith(b"\x76\x2f\x31\x01")
    assert b"<svg" in api.fetch(job.id, "error.svg", tmp_path / "out.svg").read_bytes()
    report = api.report(job.id)
    assert report["spp"] == job.spp and report["error"]["relmse"] == job.relmse
    assert [row["spp"] for row in report["log"]][-1] == job.spp


def test_submit_uploads_a_mesh_and_a_second_time_nothing(api: Client, tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "floor.ply").write_bytes(PLY)
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(with_floor("parts/floor.ply")))
    uploads: list[str] = []
    job = api.submit(path, on_upload=lambda name, *_: uploads.append(name))
    job = api.wait(job.id, timeout_s=60)
    assert job.state == "succeeded", job.error
    assert api.report(job.id)["assets"] == {"parts/floor.ply": hashlib.sha256(PLY).hexdigest()}
    again = api.submit(path, on_upload=lambda name, *_: uploads.append(name))
    again = api.wait(again.id, timeout_s=60)
    assert uploads == ["parts/floor.ply"]
    assert again.cached and again.relmse == job.relmse


def test_other_bytes_under_the_same_name_are_another_film(api: Client, tmp_path: Path) -> None:
    seen = set()
    for content in (PLY, PLY.replace(b"9 0 9\n", b"8 0 8\n")):
        (tmp_path / "floor.ply").write_bytes(content)
        job = api.wait(api.submit(with_floor("floor.ply"), asset_root=tmp_path).id, timeout_s=60)
        assert job.state == "succeeded", job.error
        seen.add(api.report(job.id)["film_key"])
    assert len(seen) == 2


def test_missing_upload_then_retry(queue: tuple[Engine, str], api: Client) -> None:
    content = PLY + b"\n"
    digest = hashlib.sha256(content).hexdigest()
    body = {"scene": with_floor("floor.ply"), "assets": {"floor.ply": f"sha256:{digest}"}}
    with httpx.Client(base_url=queue[1], timeout=30) as http:
        refused = http.post("/v1/jobs", json=body)
        assert refused.status_code == 422
        assert refused.json()["missing"] == [{"name": "floor.ply", "sha256": digest}]
        put = http.put(f"/v1/assets/{digest}", content=content, headers=OCTETS)
        assert put.status_code == 201
        accepted = http.post("/v1/jobs", json=body)
    assert accepted.status_code == 202
    assert api.wait(accepted.json()["id"], timeout_s=60).state == "succeeded"


def test_files_of_the_asset_folder_are_found_by_name(
    queue: tuple[Engine, str], api: Client, tmp_path: Path
) -> None:
    assets = queue[0].data_dir / "assets"
    (assets / "studio").mkdir()
    (assets / "studio" / "floor.ply").write_bytes(PLY)
    job = api.submit(with_floor("studio/floor.ply"), asset_root=tmp_path)
    assert api.wait(job.id, timeout_s=60).state == "succeeded"
    outside = tmp_path / "outside.ply"
    outside.write_bytes(PLY)
    (assets / "leads_out.ply").symlink_to(outside)
    answer = httpx.post(queue[1] + "/v1/jobs", json={"scene": with_floor("leads_out.ply")})
    assert answer.status_code == 422
    (error,) = answer.json()["errors"]
    assert (error["pointer"], error["code"]) == ("/scene/shapes/1/file", "asset_outside_root")


def test_an_upload_that_is_no_mesh_is_refused_or_fails_with_a_pointer(
    queue: tuple[Engine, str], api: Client
) -> None:
    content = b"\x00\x01 this is not a mesh" * 1000
    digest = hashlib.sha256(content).hexdigest()
    httpx.put(queue[1] + f"/v1/assets/{digest}", content=content, headers=OCTETS)
    body = {"scene": with_floor("floor.ply"), "assets": {"floor.ply": digest}}
    answer = httpx.post(queue[1] + "/v1/jobs", json=body, timeout=30)
    if answer.status_code == 422:
        assert answer.json()["errors"][0]["pointer"] == "/scene/shapes/1/file"
        return
    job = api.wait(answer.json()["id"], timeout_s=60)
    assert job.state == "failed" and job.error is not None
    assert job.error["pointer"] == "/shapes/1/file", job.error


def test_a_sweep_becomes_a_contact_sheet(api: Client, tmp_path: Path) -> None:
    axes = [
        {"pointer": "/materials/ball/alpha", "logspace": [0.05, 0.5, 2], "label": "alpha"},
        {"pointer": "/materials/ball/metal", "values": ["Au", "Cu"], "label": "metal"},
    ]
    sweep = api.submit_sweep(GOOD, axes)
    sheet = api.fetch_contact_sheet(sweep.id, tmp_path / "sheet.png").read_bytes()
    assert sheet.startswith(b"\x89PNG\r\n\x1a\n")
    jobs = list(api.jobs(sweep=sweep.id))
    assert [job.state for job in jobs] == ["succeeded"] * 4
    assert [(job.parameters["alpha"], job.parameters["metal"]) for job in jobs] == [
        (0.05, "Au"),
        (0.05, "Cu"),
        (0.5, "Au"),
        (0.5, "Cu"),
    ]
    assert len({api.report(job.id)["film_key"] for job in jobs}) == 4


def test_materials_and_schema_are_those_of_the_package(queue: tuple[Engine, str]) -> None:
    import matiere

    with httpx.Client(base_url=queue[1]) as http:
        names = [row["type"] for row in http.get("/v1/materials").json()["materials"]]
        assert names == [row["type"] for row in matiere.materials()]
        assert http.get("/v1/schema").json() == matiere.schema()
