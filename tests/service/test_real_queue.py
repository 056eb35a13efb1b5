"""HTTP over the real queue with quick stand-in renders: assets, sweeps, nothing left behind."""

from __future__ import annotations

import hashlib
import json
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from serving import JOBS_TESTS

from matiere.jobs.engine import Engine, open_engine
from matiere.service.app import create_app
from matiere.service.client import Client, ServiceError
from matiere.service.server import BackgroundServer, bind, url_of
from matiere.service.settings import Settings

SCENE: dict[str, Any] = {"width": 16, "height": 16, "value": 0.5, "render": {"spp": 16}}
OCTETS = {"Content-Type": "application/octet-stream"}


@pytest.fixture(scope="module")
def queue(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Engine, str]]:
    """Serve a real queue whose children run tests/jobs/fake_work.py."""
    data = tmp_path_factory.mktemp("queue") / "data"
    patch = pytest.MonkeyPatch()
    patch.syspath_prepend(str(JOBS_TESTS))
    patch.setenv("PYTHONPATH", str(JOBS_TESTS), prepend=":")
    sock = bind("127.0.0.1", 0)
    url = url_of(sock)
    with (
        open_engine(data, children=2, work="fake_work") as engine,
        BackgroundServer(create_app(engine, Settings(data=data)), sock),
    ):
        yield engine, url
    patch.undo()


@pytest.fixture
def api(queue: tuple[Engine, str]) -> Iterator[Client]:
    """Return a client of the real queue."""
    with Client(queue[1], patience_s=5) as client:
        end = time.monotonic() + 30
        while not client.ready():
            assert time.monotonic() < end
            time.sleep(0.02)
        yield client


@pytest.fixture
def http(queue: tuple[Engine, str]) -> Iterator[httpx.Client]:
    """Return a plain HTTP client of the real queue."""
    with httpx.Client(base_url=queue[1], timeout=30) as client:
        yield client


def files(folder: Path) -> set[Path]:
    """Return every file below a folder, without the database's own and those half-written."""
    found = {path for path in folder.rglob("*") if path.is_file()}
    found = {path for path in found if folder / "artifacts" / "tmp" not in path.parents}
    return {path for path in found if not path.name.startswith(("store.sqlite", "serve.log"))}


def test_a_job_gives_its_files(api: Client, http: httpx.Client, tmp_path: Path) -> None:
    job = api.submit(SCENE, stop={"spp": 20}, label="first", priority=60)
    job = api.wait(job.id, timeout_s=30)
    assert (job.state, job.label, job.stop_reason) == ("succeeded", "first", "spp")
    assert job.spp >= 20 and job.progress == 1 and job.relmse is not None
    for kind, start in (("image.png", b"png "), ("report.json", b"{"), ("error.svg", b"<svg")):
        assert api.fetch(job.id, kind, tmp_path / kind).read_bytes().startswith(start)
    answer = http.get(job.links["image_png"])
    assert answer.headers["etag"] == f'"{hashlib.sha256(answer.content).hexdigest()}"'


def test_the_same_film_is_not_rendered_twice(api: Client) -> None:
    scene = {**SCENE, "value": 0.7}
    first = api.wait(api.submit(scene).id, timeout_s=30)
    again = api.wait(api.submit(scene).id, timeout_s=30)
    assert first.id != again.id and not first.cached and again.cached


def test_idempotency_lasts_across_connections(api: Client, http: httpx.Client) -> None:
    headers = {"Idempotency-Key": "same"}
    answers = [http.post("/v1/jobs", json={"scene": SCENE}, headers=headers) for _ in range(2)]
    assert [a.status_code for a in answers] == [202, 202]
    assert len({a.json()["id"] for a in answers}) == 1
    other = http.post("/v1/jobs", json={"scene": SCENE, "label": "x"}, headers=headers)
    assert (other.status_code, other.json()["code"]) == (422, "idempotency_conflict")


def test_fifty_threads_with_one_key_make_one_job(http: httpx.Client) -> None:
    body = {"scene": {**SCENE, "value": 0.9}}
    found: list[tuple[int, str]] = []

    def submit() -> None:
        answer = http.post("/v1/jobs", json=body, headers={"Idempotency-Key": "fifty"})
        found.append((answer.status_code, answer.json().get("id") or answer.json()["code"]))

    threads = [threading.Thread(target=submit) for _ in range(50)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {status for status, _ in found} <= {202, 409}
    assert len({name for status, name in found if status == 202}) == 1
    assert {name for status, name in found if status == 409} <= {"idempotency_in_flight"}


def test_uploaded_assets_are_found_by_name_and_kept_once(
    api: Client, queue: tuple[Engine, str], tmp_path: Path
) -> None:
    (tmp_path / "sub").mkdir()
    content = b"a mesh " * 100_000
    (tmp_path / "sub" / "ball.glb").write_bytes(content)
    digest = api.upload(tmp_path / "sub" / "ball.glb")
    assert digest == hashlib.sha256(content).hexdigest()
    before = files(queue[0].data_dir / "assets")
    assert api.upload(tmp_path / "sub" / "ball.glb") == digest
    assert files(queue[0].data_dir / "assets") == before


def test_an_asset_with_another_digest_leaves_nothing(
    http: httpx.Client, queue: tuple[Engine, str]
) -> None:
    before = files(queue[0].data_dir / "assets")
    answer = http.put(f"/v1/assets/{'0' * 64}", content=b"x" * 300_000, headers=OCTETS)
    assert (answer.status_code, answer.json()["code"]) == (422, "asset_mismatch")
    assert files(queue[0].data_dir / "assets") == before
    assert http.head(f"/v1/assets/{'0' * 64}").status_code == 404


def test_concurrent_uploads_of_one_asset_agree(http: httpx.Client) -> None:
    content = b"shared " * 50_000
    digest = hashlib.sha256(content).hexdigest()
    found: list[int] = []

    def put() -> None:
        found.append(http.put(f"/v1/assets/{digest}", content=content, headers=OCTETS).status_code)

    threads = [threading.Thread(target=put) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert set(found) <= {200, 201} and 201 in found
    assert http.head(f"/v1/assets/{digest}").status_code == 200


@pytest.mark.parametrize(
    "assets",
    [
        {"a\x00b": "0" * 64},
        {"": "0" * 64},
        {"x" * 300: "0" * 64},
        {"a": "0" * 64, "./a": "0" * 64},
        {"a": "0" * 64, "a/b": "0" * 64},
    ],
)
def test_impossible_asset_names_are_refused(
    http: httpx.Client, queue: tuple[Engine, str], assets: dict[str, str]
) -> None:
    before = files(queue[0].data_dir)
    answer = http.post("/v1/jobs", json={"scene": SCENE, "assets": assets})
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_request"), answer.text
    assert answer.json()["errors"][0]["pointer"].startswith("/assets")
    assert files(queue[0].data_dir) == before


def test_a_sweep_runs_to_its_sheet(api: Client, tmp_path: Path) -> None:
    axes = [
        {"pointer": "/value", "linspace": [0.1, 0.4, 4]},
        {"pointer": "/render/spp", "values": [4, 8]},
    ]
    sweep = api.submit_sweep(SCENE, axes, columns=2, label="grid")
    assert (sweep.cells, sweep.columns) == (8, 2)
    sheet = api.fetch_contact_sheet(sweep.id, tmp_path / "sheet.png")
    assert len(json.loads(sheet.read_bytes())) == 8
    jobs = list(api.jobs(sweep=sweep.id, page=3))
    assert [job.cell for job in jobs] == list(range(8))
    assert [job.parameters["spp"] for job in jobs] == [4, 8] * 4
    assert {job.state for job in jobs} == {"succeeded"}
    assert api.sweep(sweep.id).state == "succeeded"


@pytest.mark.parametrize(
    ("axes", "pointer"),
    [
        ([{"pointer": "/value", "values": [0.5, -1]}], "/axes/0/values/1"),
        ([{"pointer": "/nowhere/x", "values": [1]}], "/axes/0/pointer"),
        ([{"pointer": "/value", "logspace": [0, 1, 3]}], "/axes/0/logspace"),
        ([{"pointer": "/value", "linspace": [0, 1, 1e9]}], "/axes/0/linspace"),
        ([{"pointer": "/value", "values": [1], "labels": ["a", "b"]}], "/axes/0/labels"),
        ([{"pointer": "/value", "values": [1]}] * 2, "/axes/1/label"),
    ],
)
def test_a_bad_axis_is_told_and_no_cell_is_queued(
    api: Client, http: httpx.Client, axes: list[dict[str, Any]], pointer: str
) -> None:
    before = len(list(api.jobs()))
    answer = http.post("/v1/sweeps", json={"base": SCENE, "axes": axes})
    assert answer.status_code == 422, answer.text
    assert answer.json()["errors"][0]["pointer"].startswith(pointer)
    assert len(list(api.jobs())) == before


def test_a_bad_base_points_into_base(http: httpx.Client) -> None:
    body = {"base": {**SCENE, "width": -1}, "axes": [{"pointer": "/value", "values": [1]}]}
    answer = http.post("/v1/sweeps", json=body)
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == "/base/width"


def test_a_running_job_is_cancelled(api: Client) -> None:
    job = api.submit({**SCENE, "value": 0.11, "chunk_s": 30.0})
    with pytest.raises(ServiceError) as caught:
        api.report(job.id)
    assert caught.value.code == "job_not_finished"
    assert api.cancel(job.id).state == "cancelled"
    with pytest.raises(ServiceError) as caught:
        api.report(job.id)
    assert caught.value.code == "job_not_succeeded"


def test_status_names_the_children(http: httpx.Client, queue: tuple[Engine, str]) -> None:
    status = http.get("/v1/status").json()
    assert len(status["children"]) == 3  # two that render and the utility child
    assert status["data_dir"] == str(queue[0].data_dir)
    assert str(sys.modules["matiere.jobs"].__file__)


def test_status_reads_stay_quick_while_children_render(api: Client, http: httpx.Client) -> None:
    """No timed assert: the numbers are printed; only an error or a hang fails."""
    jobs = [api.submit({**SCENE, "value": 0.2 + i / 100, "chunk_s": 0.01}).id for i in range(5)]
    times = []
    for i in range(200):
        begin = time.perf_counter()
        assert http.get(f"/v1/jobs/{jobs[i % 5]}").status_code == 200
        times.append(time.perf_counter() - begin)
    times.sort()
    print(f"status reads: median {1e3 * times[100]:.1f} ms, p99 {1e3 * times[197]:.1f} ms")
    for job in jobs:
        api.cancel(job)
