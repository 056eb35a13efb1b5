"""`matiere.Client.watch`: nothing missing, nothing twice, by stream or pages, over restarts."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from serving import serve
from sse_clients import truth

import matiere as mt
from matiere.service import client_watch
from matiere.service.client import Client

SCENE: dict[str, Any] = {"width": 16, "height": 16, "value": 1.0, "render": {"spp": 8}}
AXES = [{"pointer": "/value", "values": [1.0, 2.0]}]


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    """A served queue of the stand-in renderer."""
    with serve(tmp_path_factory.mktemp("watch") / "d", "--children", 1) as (_, client):
        yield client


def slow(**more: Any) -> dict[str, Any]:
    """Return a scene of some seconds that no other test has."""
    render = {"spp": 64, "seed": time.time_ns() % 2**31}
    return SCENE | {"chunk_s": 0.02, "render": render | more.pop("render", {})} | more


def watched(client: Client, steering: Client, name: str) -> list[mt.ServiceEvent]:
    """Watch what is paused, and let it go on when the first event has come."""
    events = client.watch(name)
    first = next(events)
    assert first.kind == "snapshot" and first.status is not None and not first.status.ended
    if isinstance(first.status, mt.SweepStatus):
        steering.steer_sweep(name, "resume")
    else:
        steering.steer(name, "resume")
    return [first, *events]


def test_a_job_is_watched_to_its_end(service: Client) -> None:
    job = service.steer(service.submit(slow()).id, "pause")
    first, *others = watched(service, service, job.id)
    assert isinstance(first.status, mt.JobStatus)
    assert first.status.id == first.job_id == job.id
    assert [event.seq for event in others] == [
        seq for seq in truth(service.url, job.links["events"]) if seq > first.seq
    ]
    assert others[-1].kind == "succeeded" and others[-1].time is not None
    looks = [event.data for event in others if event.kind == "look"]
    assert looks and all(look["lower"] < look["relmse"] < look["upper"] for look in looks)
    (alone,) = service.watch(service.job(job.id))
    assert alone.kind == "snapshot" and alone.status == service.job(job.id)
    since = others[0].seq
    assert list(service.watch(job.id, after=since)) == others[1:], "also of one that has ended"


def test_a_sweep_is_watched_to_its_end(service: Client) -> None:
    sweep = service.steer_sweep(service.submit_sweep(slow(), AXES).id, "pause")
    first, *others = watched(service, service, sweep.id)
    assert isinstance(first.status, mt.SweepStatus) and first.status.cells == 2
    assert others[-1].kind == "sweep_finished"
    assert sum(event.kind == "succeeded" for event in others) == 2
    assert service.wait_sweep(sweep.id, timeout_s=10).ended


def test_what_is_not_there_is_told(service: Client) -> None:
    with pytest.raises(mt.ServiceError, match="no job or sweep has the id nothing") as caught:
        next(service.watch("nothing"))
    assert caught.value.code == "not_found"


def test_who_leaves_the_loop_leaves_the_job(service: Client) -> None:
    job = service.submit(slow())
    for event in service.watch(job.id):
        assert event.kind == "snapshot"
        break
    assert service.wait(job.id, timeout_s=120).state == "succeeded"


@pytest.mark.parametrize("why", ["busy", "another type", "silence"])
def test_without_a_stream_the_same_comes_by_pages(
    service: Client, monkeypatch: pytest.MonkeyPatch, why: str
) -> None:
    """What stands between lets no stream through."""
    monkeypatch.setattr(client_watch, "SILENCE_S", 0.3)
    tried = 0

    def no_stream(request: httpx.Request) -> httpx.Response:
        nonlocal tried
        if "event-stream" in request.headers["accept"]:
            tried += 1
            if why == "silence":
                raise httpx.ReadTimeout("nothing came", request=request)
            if why == "busy":
                return httpx.Response(503, json={"code": "busy", "detail": "Too many streams."})
            return httpx.Response(200, html="<p>hello</p>")
        with httpx.Client() as through:
            body = request.read()
            kept = {k: v for k, v in request.headers.items() if k in ("accept", "content-type")}
            return through.request(request.method, request.url, content=body, headers=kept)

    with Client(service.url) as client:
        client._http = httpx.Client(base_url=client.url, transport=httpx.MockTransport(no_stream))
        job = service.steer(service.submit(slow()).id, "pause")
        first, *others = watched(client, service, job.id)
    assert tried == 1
    assert isinstance(first.status, mt.JobStatus)
    assert [event.seq for event in others] == [
        seq for seq in truth(service.url, job.links["events"]) if seq > first.seq
    ]
    assert others[-1].kind == "succeeded"


def test_texts_with_other_line_ends_stay_whole() -> None:
    """U+2028 and the like end no line of the protocol; a piece may end anywhere."""
    text = 'retry: 2000\n\n: hello\n\nid: 7\ndata: {"a": "x\u2028y\x85z"}\n\n'.encode()
    for size in (1, 2, 3, len(text)):
        pieces = (text[at : at + size] for at in range(0, len(text), size))
        found = [fields for fields in client_watch.parsed(pieces) if "data" in fields]
        assert found == [{"id": "7", "data": '{"a": "x\u2028y\x85z"}'}]


def free_port() -> int:
    """Return a port that nobody listens on now."""
    with socket.create_server(("127.0.0.1", 0)) as sock:
        return int(sock.getsockname()[1])


@pytest.mark.slow
def test_a_restart_in_the_middle_makes_no_gap_and_no_repeat(tmp_path: Path) -> None:
    port = free_port()
    data, seen, lost = tmp_path / "d", [], []
    begun = threading.Event()

    def watch(url: str, name: str) -> None:
        with Client(url, patience_s=60) as client:
            for event in client.watch(name, on_lost=lost.append):
                seen.append(event)
                if event.kind == "look":
                    begun.set()

    with serve(data, "--port", port, "--children", 1) as (first, client):
        url = client.url
        job = client.submit(slow(chunk_s=0.05, render={"spp": 128}))
        watcher = threading.Thread(target=watch, args=(url, job.id))
        watcher.start()
        assert begun.wait(120)
        first.process.kill()
        first.process.wait(10)
    before = len(seen)
    time.sleep(0.3)
    with serve(data, "--port", port, "--children", 1) as (_, client):
        watcher.join(120)
        assert not watcher.is_alive()
        expected = [seq for seq in truth(url, job.links["events"]) if seq > seen[0].seq]
    assert [event.seq for event in seen[1:]] == expected
    assert seen[-1].kind == "succeeded" and 1 < before < len(seen)
    assert len(lost) == 1, lost


def test_patience_ends(tmp_path: Path) -> None:
    with serve(tmp_path / "d", "--children", 1) as (serving, client):
        job = client.submit(slow(chunk_s=0.05, render={"spp": 1024}))
        client.patience_s = 0.5
        events = client.watch(job.id)
        assert next(events).kind == "snapshot"
        serving.process.kill()
        serving.process.wait(10)
        with pytest.raises(mt.Unreachable, match="no service answers"):
            list(events)
