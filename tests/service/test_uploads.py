"""Assets: what is missing, and uploads that go on after a cut, a kill, a service that went away."""

from __future__ import annotations

import hashlib
import os
import socket
import time
from pathlib import Path
from urllib.parse import urlsplit

import httpx
import pytest
from fake_engine import MAX_ASSET_BYTES, FakeEngine
from serving import serve

from matiere.jobs.errors import AssetMismatch, DiskFull, UploadBusy, WrongOffset
from matiere.jobs.uploads import PART_DAYS_S
from matiere.service.client import Client

OCTETS = {"Content-Type": "application/octet-stream"}
DATA = os.urandom(50_000)
DIGEST = hashlib.sha256(DATA).hexdigest()
URL = f"/v1/assets/{DIGEST}"


def put(client: httpx.Client, first: int, last: int, data: bytes = DATA) -> httpx.Response:
    """Send bytes [first, last) of the asset."""
    given = {"Content-Range": f"bytes {first}-{last - 1}/{len(DATA)}"}
    return client.put(URL, content=data[first:last], headers={**OCTETS, **given})


def parts(engine: FakeEngine) -> list[Path]:
    """Return the files of unfinished uploads."""
    return list((engine.data_dir / "assets" / ".uploads").glob("*"))


def test_what_is_missing_is_asked_before_anything_is_sent(
    client: httpx.Client, engine: FakeEngine
) -> None:
    other = "0" * 64
    asked = {"sha256": [DIGEST, f"sha256:{other}", DIGEST]}
    assert client.post("/v1/assets:missing", json=asked).json() == {"missing": [DIGEST, other]}
    assert client.put(URL, content=DATA, headers=OCTETS).status_code == 201
    assert client.post("/v1/assets:missing", json=asked).json() == {"missing": [other]}
    assert client.post("/v1/assets:missing", json={"sha256": []}).json() == {"missing": []}
    for wrong in (["x"], "x", [other] * 10_001, [1]):
        answer = client.post("/v1/assets:missing", json={"sha256": wrong})
        assert (answer.status_code, answer.json()["code"]) == (422, "invalid_request")


def test_pieces_make_a_whole(client: httpx.Client, engine: FakeEngine) -> None:
    assert client.head(URL).headers["upload-offset"] == "0"
    first = put(client, 0, 20_000)
    assert (first.status_code, first.headers["upload-offset"]) == (202, "20000")
    assert client.head(URL).status_code == 404 and client.head(URL).headers["upload-offset"] == (
        "20000"
    )
    assert DIGEST not in engine.assets
    for begin in (0, 10_000, 30_000):
        wrong = put(client, begin, begin + 1000)
        assert (wrong.status_code, wrong.json()["code"]) == (409, "wrong_offset")
        assert wrong.headers["upload-offset"] == "20000"
    last = put(client, 20_000, len(DATA))
    assert (last.status_code, last.json()["created"]) == (201, True)
    assert client.head(URL).status_code == 200 and not parts(engine)
    assert put(client, 0, 10).json()["created"] is False
    path = engine.data_dir / "assets" / ".sha256" / DIGEST[:2] / DIGEST
    assert path.read_bytes() == DATA


def test_other_bytes_are_noticed_at_the_end(client: httpx.Client, engine: FakeEngine) -> None:
    assert put(client, 0, 20_000, b"x" * len(DATA)).status_code == 202
    last = put(client, 20_000, len(DATA))
    assert (last.status_code, last.json()["code"]) == (422, "asset_mismatch")
    assert not engine.assets and not parts(engine)
    assert client.put(URL, content=DATA, headers=OCTETS).status_code == 201, "a new begin"


@pytest.mark.parametrize(
    ("given", "status"),
    [("bytes 0-9/5", 400), ("bytes 9-0/100", 400), ("bytes 0-8/100", 400), ("0-9/10", 400),
     ("bytes */10", 400), ("bytes 0-9/*", 400), ("bytes -9/10", 400),
     (f"bytes 0-9/{MAX_ASSET_BYTES + 1}", 413), (f"bytes 0-9/{'9' * 400}", 400),
     ("bytes 5-14/50000", 409)],
)  # fmt: skip
def test_a_wrong_content_range_is_a_problem(
    client: httpx.Client, engine: FakeEngine, given: str, status: int
) -> None:
    answer = client.put(URL, content=b"0123456789", headers={**OCTETS, "Content-Range": given})
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    assert not engine.assets


def test_what_came_before_a_cut_is_kept(client: httpx.Client, engine: FakeEngine, url: str) -> None:
    where = urlsplit(url)
    with socket.create_connection((where.hostname, where.port)) as sock:
        head = (
            f"PUT {URL} HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/octet-stream\r\n"
        )
        sock.sendall(f"{head}Content-Length: {len(DATA)}\r\n\r\n".encode() + DATA[:30_000])
        until = time.monotonic() + 20
        while engine.uploads.offset(DIGEST) < 1 and time.monotonic() < until:
            time.sleep(0.01)
        busy = put(client, 0, 10)  # the first still writes
        assert (busy.status_code, busy.json()["code"]) == (409, "upload_busy")
        assert client.put(URL, content=b"x", headers=OCTETS).json()["code"] == "asset_mismatch"
    until = time.monotonic() + 20
    while (kept := engine.uploads.offset(DIGEST)) < 30_000 and time.monotonic() < until:
        time.sleep(0.01)
    assert kept == 30_000
    with Client(url) as by_client:
        sent: list[int] = []
        path = engine.data_dir / "file"
        path.write_bytes(DATA)
        by_client.upload(path, on_upload=lambda name, done, size: sent.append(done))
    assert sent == [len(DATA)] and DIGEST in engine.assets


def test_a_full_disk_and_strangers_are_refused(engine: FakeEngine) -> None:
    uploads = engine.uploads
    with pytest.raises(DiskFull):
        uploads.append(DIGEST, [DATA], 0, 2**50)
    with pytest.raises(WrongOffset):
        uploads.append(DIGEST, [DATA, DATA], 0, len(DATA))
    with pytest.raises(AssetMismatch):
        uploads.whole("..", [b""])
    assert uploads.offset("../../etc/passwd") == 0 and not uploads.held("..")
    with uploads._writing(DIGEST, alone=True), pytest.raises(UploadBusy):
        uploads.append(DIGEST, [DATA], 0, len(DATA))


def test_beginnings_are_swept_after_a_day(engine: FakeEngine) -> None:
    assert engine.uploads.append(DIGEST, [DATA[:9]], 0, len(DATA)) == 9
    assert engine.uploads.sweep(time.time() + PART_DAYS_S - 60) == 0
    assert engine.uploads.sweep(time.time() + PART_DAYS_S + 60) == 1
    assert not parts(engine)


def test_the_client_outlives_a_service_that_is_killed_while_it_uploads(tmp_path: Path) -> None:
    """SIGKILL in the middle, then another start on the same port: the rest is sent, not all."""
    data, path = os.urandom(24 * 2**20), tmp_path / "mesh.bin"
    path.write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    pieces: list[int] = []
    with serve(tmp_path / "data", "--children", 1) as (first, client):
        port = urlsplit(client.url).port
        client.patience_s = 60.0

        def kill(name: str, done: int, size: int) -> None:
            pieces.append(done)
            if len(pieces) == 16:
                until = time.monotonic() + 20
                kept = tmp_path / "data" / "assets" / ".uploads" / digest
                while not (kept.exists() and kept.stat().st_size > 2**20):
                    assert time.monotonic() < until
                    time.sleep(0.01)
                first.process.kill()
                first.process.wait()
                again.append(serve_on(tmp_path / "data", port))

        again: list[object] = []
        try:
            client.upload(path, on_upload=kill)
            assert client.missing([digest]) == []
        finally:
            for one in again:
                one.__exit__(None, None, None)  # type: ignore[attr-defined]
    assert len(again) == 1
    assert len(pieces) < 16 + 24, "not all of it was sent twice"
    assert pieces[-1] == len(data)


def serve_on(data: Path, port: int | None) -> object:
    """Serve a data directory again, on the port it had."""
    from serving import command

    running = command("serve", "--data", data, "--port", port, "--children", 1)
    running.__enter__()
    return running
