"""Streams of events: nothing missing, nothing twice, whoever is killed; JSON pages say the same."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from serving import JOBS_TESTS, Serving, command, serve
from sse_clients import Listener, faults, truth

from matiere.jobs import open_engine
from matiere.jobs.rules import Rules
from matiere.service.app import create_app
from matiere.service.client import Client
from matiere.service.server import BackgroundServer, bind, url_of
from matiere.service.settings import Settings

SCENE: dict[str, Any] = {"width": 16, "height": 16, "value": 1.0, "render": {"spp": 8}}
JSON = {"Accept": "application/json"}


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    """A served queue of the stand-in renderer."""
    with serve(tmp_path_factory.mktemp("events"), "--children", 1) as (_, client):
        yield client


def events(answer: httpx.Response, last: str) -> Iterator[dict[str, Any]]:
    """Yield the events of an open stream up to the first of kind `last`."""
    event: dict[str, Any] = {}
    for line in answer.iter_lines():
        name, _, value = line.partition(": ")
        if line and name:
            event[name] = json.loads(value) if name == "data" else value
        elif not line and "data" in event:
            yield event
            if event["data"].get("kind") == last:
                return
            event = {}


def test_a_job_is_followed_from_its_snapshot_to_its_end(service: Client) -> None:
    job = service.submit(SCENE)
    address = f"{service.url}{job.links['events']}"
    with httpx.stream("GET", address, timeout=30) as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        assert answer.headers["cache-control"] == "no-store"
        first, *others = events(answer, "succeeded")
    assert first["event"] == "snapshot" and first["data"]["id"] == job.id
    assert all("event" not in other for other in others), "these reach onmessage"
    numbers = [int(other["id"]) for other in others]
    assert numbers == [other["data"]["seq"] for other in others] == sorted(set(numbers))
    assert numbers[0] > int(first["id"])
    told = httpx.get(address, headers=JSON).json()
    assert [e["kind"] for e in told["events"]][:1] == ["queued"]
    assert [e["seq"] for e in told["events"]][-len(numbers) :] == numbers
    assert told["reset"] is False
    assert httpx.get(address, headers=JSON, params={"after": told["last"]}).json()["events"] == []
    second = {"Last-Event-ID": str(told["events"][0]["seq"])}
    with httpx.stream("GET", address, timeout=30, headers=second) as answer:
        again = list(events(answer, "succeeded"))
    assert [e["data"] for e in again] == told["events"][1:], "what was received does not come twice"


def test_a_sweep_tells_of_its_cells_and_all_of_everything(service: Client) -> None:
    axes = [{"pointer": "/value", "values": [1.0, 2.0]}]
    sweep = service.submit_sweep(SCENE, axes)
    address = f"{service.url}{sweep.links['events']}"
    with httpx.stream("GET", address, params={"after": 0}, timeout=30) as answer:
        seen = [event["data"] for event in events(answer, "sweep_finished")]
    assert {event["sweep_id"] for event in seen} == {sweep.id}
    assert sum(event["kind"] == "succeeded" for event in seen) == 2
    with httpx.stream("GET", f"{service.url}/v1/events", params={"after": 0}, timeout=30) as answer:
        whole = [event["data"] for event in events(answer, "sweep_finished")]
    assert [event for event in whole if event["sweep_id"] == sweep.id] == seen


@pytest.mark.parametrize(
    ("address", "headers", "status", "code"),
    [
        ("/v1/jobs/nothing/events", {}, 404, "job_not_found"),
        ("/v1/jobs/%20/events", {}, 404, "job_not_found"),
        ("/v1/sweeps/nothing/events", {}, 404, "sweep_not_found"),
        ("/v1/events", {"Last-Event-ID": "x"}, 400, "invalid_cursor"),
        ("/v1/events", {"Last-Event-ID": "9" * 40}, 400, "invalid_cursor"),
        ("/v1/events?after=-1", {}, 422, "invalid_request"),
        ("/v1/events?limit=100000", {}, 422, "invalid_request"),
    ],
)
def test_what_cannot_be_followed(
    service: Client, address: str, headers: dict[str, str], status: int, code: str
) -> None:
    answer = httpx.get(service.url + address, headers=headers)
    assert (answer.status_code, answer.json()["code"]) == (status, code)


def first_event(address: str, last: int | None) -> dict[str, Any]:
    """Return the first event of a stream."""
    headers = {} if last is None else {"Last-Event-ID": str(last)}
    with httpx.stream("GET", address, headers=headers, timeout=30) as answer:
        return next(events(answer, ""))


def test_an_id_outside_the_history_gets_a_reset_with_a_snapshot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(JOBS_TESTS))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))
    sock = bind("127.0.0.1", 0)
    rules = Rules(events_kept=5)
    options: dict[str, Any] = {"work": "fake_work", "min_free_bytes": 0, "rules": rules}
    with (
        open_engine(tmp_path / "d", children=1, **options) as e,
        BackgroundServer(create_app(e, Settings(data=tmp_path)), sock),
    ):
        jobs = [e.wait_job(e.submit_job(SCENE).id, 30) for _ in range(4)]
        time.sleep(0.2)
        newest = e.event_range()[1]
        e.storage.collect()
        assert e.event_range() == (newest - 4, newest)
        address = f"{url_of(sock)}/v1/jobs/{jobs[-1].id}/events"
        for last in (1, newest + 1000):
            event = first_event(address, last)
            assert (event["event"], event["id"]) == ("reset", str(newest)), last
            assert event["data"]["id"] == jobs[-1].id and event["data"]["state"] == "succeeded"
        everything = f"{url_of(sock)}/v1/events"
        assert first_event(everything, 1)["data"]["jobs"]["succeeded"] == 4
        assert int(first_event(everything, newest - 5)["id"]) == newest - 4, "the oldest kept"
        page = httpx.get(everything, headers=JSON, params={"after": 1}).json()
        assert page == {"events": [], "last": newest, "reset": True}


def test_the_end_of_the_service_ends_streams_quickly(tmp_path: Path) -> None:
    with serve(tmp_path / "d", "--children", 1) as (serving, client):
        with httpx.stream("GET", f"{client.url}/v1/events", timeout=30) as answer:
            begin = time.monotonic()
            serving.process.send_signal(signal.SIGTERM)
            text = "".join(answer.iter_text())
        assert "retry: " in text and "event: snapshot" in text
        assert serving.process.wait(30) == 0
        assert time.monotonic() - begin < 15


# -- listeners and kills -------------------------------------------------------------------------
def start(data: Path, port: int) -> tuple[Any, Serving]:
    """Start a service on a port; return its context and itself, ready."""
    context = command("serve", "--data", data, "--port", port, "--children", 1)
    serving = context.__enter__()
    url = serving.url
    with Client(url, patience_s=10) as client:
        end = time.monotonic() + 60
        while not client.ready():
            assert time.monotonic() < end
            time.sleep(0.05)
    return context, serving


async def follow(
    data: Path, clients: int, kills: int
) -> tuple[list[Listener], dict[str, list[int]]]:
    """Let listeners follow a service that is killed again and again while jobs run.

    Return them, and the numbers of the events that the history holds for each address.
    """
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    url, over = f"http://127.0.0.1:{port}", asyncio.Event()
    context, serving = await asyncio.to_thread(start, data, port)
    sweep = await asyncio.to_thread(_submit, url)
    topics = ["/v1/events", f"/v1/sweeps/{sweep.id}/events", f"{sweep.links['jobs']}"]
    cells = httpx.get(url + topics.pop(), timeout=30).json()["jobs"]
    topics += [f"/v1/jobs/{cells[0]['id']}/events", f"/v1/jobs/{cells[-1]['id']}/events"]
    listeners = [Listener(topics[i % len(topics)]) for i in range(clients)]
    tasks = [asyncio.create_task(one.listen(url, over)) for one in listeners]
    for _ in range(kills):
        await asyncio.sleep(0.7)
        await asyncio.to_thread(_submit, url)
        serving.process.kill()
        await asyncio.to_thread(context.__exit__, None, None, None)
        context, serving = await asyncio.to_thread(start, data, port)
    try:
        await asyncio.to_thread(_submit, url, 20)
        expected = await asyncio.to_thread(_settle, url, listeners)
        over.set()
        serving.process.terminate()
        await asyncio.gather(*tasks)
    finally:
        await asyncio.to_thread(context.__exit__, None, None, None)
    return listeners, expected


def _submit(url: str, cells: int = 30) -> Any:
    axes = [{"pointer": "/value", "linspace": [1.0, 2.0, cells]}]
    with Client(url, patience_s=20) as client:
        return client.submit_sweep(SCENE | {"chunk_s": 0.02, "seed": time.time()}, axes)


def _settle(url: str, listeners: list[Listener]) -> dict[str, list[int]]:
    """Wait until nothing happens any more and the listeners have it, or time is over."""
    end = time.monotonic() + 120
    while True:
        counts = httpx.get(f"{url}/v1/status", timeout=30).json()["jobs"]
        if not counts["queued"] and not counts["running"]:
            break
        assert time.monotonic() < end, counts
        time.sleep(0.1)
    time.sleep(1.0)
    expected = {address: truth(url, address) for address in {one.address for one in listeners}}
    while time.monotonic() < end and any(faults(o, expected[o.address]) for o in listeners):
        time.sleep(0.2)
    return expected


@pytest.mark.slow
def test_no_listener_misses_or_repeats_when_the_service_is_killed(tmp_path: Path) -> None:
    listeners, expected = asyncio.run(follow(tmp_path / "d", clients=24, kills=2))
    assert len(expected["/v1/events"]) > 100
    for one in listeners:
        assert not faults(one, expected[one.address])
        assert one.connections > 2
