"""Pause, resume, requeue, priority, `after` and deadlines over HTTP and on the command line."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from fake_engine import FakeEngine
from serving import command, serve

from matiere.jobs.job import JobState
from matiere.service.client import Client

SCENE: dict[str, Any] = {"width": 16, "height": 16, "value": 1.0, "render": {"spp": 8}}
ENDLESS = SCENE | {"chunk_s": 1000.0}


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, Client]]:
    """A served queue of the stand-in renderer."""
    data = tmp_path_factory.mktemp("steering")
    with serve(data, "--children", 1) as (_, client):
        yield data, client


def say(data: Path, *words: object) -> str:
    """Run a command against the data directory and return what it printed."""
    with command(*words, "--data", data) as run:
        return run.output()


def test_every_step_has_its_route_and_its_link(client: httpx.Client, engine: FakeEngine) -> None:
    job = client.post("/v1/jobs", json={"scene": {"version": 1}}).json()
    assert {"cancel", "pause"} <= set(job["links"])
    paused = client.post(job["links"]["pause"]).json()
    assert paused["state"] == "paused" and "resume" in paused["links"]
    assert client.post(paused["links"]["resume"]).json()["state"] == "queued"
    changed = client.patch(job["links"]["self"], json={"priority": 80}).json()
    assert changed["priority"] == 80
    engine.finish(job["id"], JobState.FAILED)
    failed = client.get(job["links"]["self"]).json()
    assert "requeue" in failed["links"] and "cancel" not in failed["links"]
    assert client.post(failed["links"]["requeue"]).json()["state"] == "queued"
    engine.finish(job["id"])
    refused = client.post(f"/v1/jobs/{job['id']}:requeue")
    assert (refused.status_code, refused.json()["code"]) == (409, "illegal_transition")
    wrong = client.patch(job["links"]["self"], json={"priority": 101})
    assert (wrong.status_code, wrong.json()["errors"][0]["pointer"]) == (422, "/priority")


def test_jobs_are_steered_on_the_command_line(service: tuple[Path, Client]) -> None:
    data, client = service
    job = client.submit(ENDLESS | {"value": 2.0})
    assert "paused" in say(data, "pause", job.id)
    assert client.job(job.id).state == "paused"
    assert "priority 77" in say(data, "priority", job.id, 77)
    assert "queued" in say(data, "resume", job.id)
    assert "cancelled" in say(data, "cancel", job.id)
    assert "queued" in say(data, "requeue", job.id)
    again = client.job(job.id)
    assert (again.attempt, again.history[0]["state"], again.priority) == (2, "cancelled", 77)
    client.cancel(job.id)
    assert "no job or sweep has the id nobody" in say(data, "pause", "nobody")


def test_sweeps_are_steered_as_a_whole(service: tuple[Path, Client]) -> None:
    data, client = service
    axes = [{"pointer": "/value", "values": [3, 4, 5]}]
    sweep = client.submit_sweep(ENDLESS, axes)
    assert "3 paused" in say(data, "pause", sweep.id)
    assert client.sweep(sweep.id).state == "paused"
    assert client.set_sweep_priority(sweep.id, 5).counts["paused"] == 3
    assert {job.priority for job in client.jobs(sweep=sweep.id)} == {5}
    assert client.steer_sweep(sweep.id, "resume").counts["paused"] == 0
    assert client.cancel_sweep(sweep.id).counts["cancelled"] == 3
    assert "3 queued" in say(data, "requeue", sweep.id)
    assert client.cancel_sweep(sweep.id).ended


def test_what_is_deleted_is_gone_whatever_it_was_doing(
    service: tuple[Path, Client], tmp_path: Path
) -> None:
    data, client = service
    job = client.submit(ENDLESS | {"value": 20.0})
    sweep = client.submit_sweep(ENDLESS, [{"pointer": "/value", "values": [21, 22]}])
    cell = next(client.jobs(sweep=sweep.id))
    refused = httpx.delete(f"{client.url}/v1/jobs/{cell.id}")
    assert (refused.status_code, refused.json()["code"]) == (409, "part_of_sweep")
    httpx.post(f"{client.url}/v1/jobs/{job.id}:pin")
    refused = httpx.delete(f"{client.url}/v1/jobs/{job.id}")
    assert (refused.status_code, refused.json()["code"]) == (409, "pinned")
    assert refused.json()["remedy"]
    httpx.post(f"{client.url}/v1/jobs/{job.id}:unpin")
    json = {"Accept": "application/json"}
    begun = httpx.get(f"{client.url}/v1/events", headers=json)
    said = say(data, "delete", job.id, sweep.id)
    assert f"job {job.id}  deleted" in said and f"sweep {sweep.id}  deleted" in said
    for path in (f"/v1/jobs/{job.id}", f"/v1/sweeps/{sweep.id}", f"/v1/jobs/{cell.id}"):
        assert httpx.get(client.url + path).status_code == 404
    for path in (f"/v1/jobs/{job.id}", f"/v1/sweeps/{sweep.id}", f"/v1/sweeps/{sweep.id}/night"):
        again = httpx.delete(client.url + path)
        assert (again.status_code, again.content) == (204, b""), "sent twice it is answered alike"
    after = {"after": begun.json()["last"]}
    told = httpx.get(f"{client.url}/v1/events", params=after, headers=json)
    kinds = [(e["kind"], e["job_id"], e["sweep_id"]) for e in told.json()["events"]]
    assert ("deleted", job.id, None) in kinds and ("sweep_deleted", None, sweep.id) in kinds
    assert "no job or sweep has the id nobody" in say(data, "delete", "nobody")
    for path in ("/v1/jobs/nobody", "/v1/sweeps/..", "/v1/sweeps/nobody/night"):
        assert httpx.delete(client.url + path).status_code == 404


def test_after_and_deadline_travel(service: tuple[Path, Client]) -> None:
    _, client = service
    first = client.submit(ENDLESS | {"value": 6.0})
    then = client.submit(SCENE | {"value": 7.0}, after=[first.id], deadline=3600)
    assert (then.after, then.waiting_for, then.state) == ([first.id], 1, "queued")
    assert then.deadline is not None
    client.cancel(first.id)
    ended = client.job(then.id)
    assert (ended.state, ended.error and ended.error["code"]) == ("cancelled", "dependency_failed")
    for pointer, more in (
        ("/after/0", {"after": ["nobody"]}),
        ("/deadline", {"deadline": "tomorrow"}),
        ("/deadline", {"deadline": 0}),
    ):
        answer = httpx.post(f"{client.url}/v1/jobs", json={"scene": SCENE, **more})
        assert answer.status_code == 422, answer.text
        assert answer.json()["errors"][0]["pointer"] == pointer


def test_submit_keeps_what_there_was_at_the_deadline(
    service: tuple[Path, Client], tmp_path: Path
) -> None:
    data, _ = service
    scene = tmp_path / "scene.json"
    scene.write_text(str(SCENE | {"value": 8.0, "chunk_s": 0.004}).replace("'", '"'))
    words = ("submit", scene, "--spp", 2**20, "--deadline", 5, "-o", tmp_path / "out.png")
    with command(*words, "--data", data) as run:
        printed = run.output()
        assert run.process.wait(30) == 1, "it did not succeed"
    assert "expired" in printed
    assert (tmp_path / "out.png").read_bytes().startswith(b"png ")
