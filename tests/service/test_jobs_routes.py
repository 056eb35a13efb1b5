"""Jobs over HTTP: submission, idempotency, lists, cancellation, files."""

from __future__ import annotations

import hashlib
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import datetime

import httpx
import pytest
from fake_engine import FakeEngine
from fastapi import FastAPI

from matiere.jobs.job import JobState

BODY = {"scene": {"version": 1}}


def submit(client: httpx.Client, **more: object) -> dict[str, object]:
    """Submit one job."""
    answer = client.post("/v1/jobs", json={**BODY, **more})
    assert answer.status_code == 202, answer.text
    job: dict[str, object] = answer.json()
    return job


def test_submission_is_202_with_location(client: httpx.Client) -> None:
    answer = client.post(
        "/v1/jobs", json={**BODY, "stop": {"spp": 4}, "priority": 70, "label": "gold"}
    )
    assert answer.status_code == 202
    job = answer.json()
    assert answer.headers["location"] == f"/v1/jobs/{job['id']}" == job["links"]["self"]
    assert int(answer.headers["retry-after"]) >= 1
    assert (job["state"], job["stop"], job["priority"], job["label"]) == (
        "queued",
        {"spp": 4},
        70,
        "gold",
    )
    assert datetime.fromisoformat(job["created"]).utcoffset().total_seconds() == 0  # type: ignore[union-attr]
    assert client.get(answer.headers["location"]).json() == job


def test_same_key_and_body_give_the_same_job(client: httpx.Client, engine: FakeEngine) -> None:
    headers = {"Idempotency-Key": "night-7 cell 3"}
    first = client.post("/v1/jobs", json=BODY, headers=headers)
    again = client.post("/v1/jobs", json=BODY, headers=headers)
    assert (first.status_code, again.status_code) == (202, 202)
    assert first.json() == again.json()
    assert first.headers["location"] == again.headers["location"]
    assert engine.submissions == 1


def test_same_key_with_another_body_is_422(client: httpx.Client, engine: FakeEngine) -> None:
    headers = {"Idempotency-Key": "k"}
    client.post("/v1/jobs", json=BODY, headers=headers)
    answer = client.post("/v1/jobs", json={**BODY, "label": "other"}, headers=headers)
    assert (answer.status_code, answer.json()["code"]) == (422, "idempotency_conflict")
    assert engine.submissions == 1


def test_key_in_flight_is_409(client: httpx.Client, engine: FakeEngine, app: FastAPI) -> None:
    engine.gate = threading.Event()
    headers = {"Idempotency-Key": "k"}
    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(client.post, "/v1/jobs", json=BODY, headers=headers)
        while not app.state.in_flight._keys:
            time.sleep(0.01)
        second = client.post("/v1/jobs", json=BODY, headers=headers)
        engine.gate.set()
    assert (second.status_code, second.json()["code"]) == (409, "idempotency_in_flight")
    assert "retry-after" in second.headers
    assert first.result().status_code == 202
    assert client.post("/v1/jobs", json=BODY, headers=headers).status_code == 202


@pytest.mark.parametrize("key", ["", "x" * 201])
def test_unusable_key_is_400(client: httpx.Client, key: str) -> None:
    answer = client.post("/v1/jobs", json=BODY, headers={"Idempotency-Key": key})
    assert (answer.status_code, answer.json()["code"]) == (400, "invalid_idempotency_key")


@pytest.mark.parametrize(
    ("change", "pointer"),
    [
        ({"scene": None}, "/scene"),
        ({"scene": [1]}, "/scene"),
        ({"scene": {"version": 2}}, "/scene/version"),
        ({"stop": {"spp": 0}}, "/stop/spp"),
        ({"stop": {"spp": "4"}}, "/stop/spp"),
        ({"stop": {"target_error": {"relmse": -1}}}, "/stop/target_error/relmse"),
        ({"stop": {"spps": 4}}, "/stop/spps"),
        ({"priority": 101}, "/priority"),
        ({"priority": True}, "/priority"),
        ({"labl": "x"}, "/labl"),
        ({"cache": "off"}, "/cache"),
        ({"assets": {"a/b~c.glb": "123"}}, "/assets/a~1b~0c.glb"),
        ({"assets": ["x"]}, "/assets"),
    ],
)
def test_a_bad_field_is_422_with_its_pointer(
    client: httpx.Client, engine: FakeEngine, change: dict[str, object], pointer: str
) -> None:
    answer = client.post("/v1/jobs", json={**BODY, **change})
    assert answer.status_code == 422, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    problem = answer.json()
    assert [error["pointer"] for error in problem["errors"]] == [pointer]
    assert pointer in problem["detail"]
    assert engine.submissions == 0


def test_missing_assets_are_listed_and_can_be_uploaded(
    client: httpx.Client, engine: FakeEngine
) -> None:
    digests = {f"{n}.glb": hashlib.sha256(n.encode()).hexdigest() for n in "ab"}
    engine.put_asset(digests["a.glb"], [b"a"])
    body = {**BODY, "assets": {"a.glb": digests["a.glb"], "b.glb": "sha256:" + digests["b.glb"]}}
    refused = client.post("/v1/jobs", json=body)
    problem = refused.json()
    assert (refused.status_code, problem["code"]) == (422, "asset_missing")
    assert problem["missing"] == [{"name": "b.glb", "sha256": digests["b.glb"]}]
    assert problem["errors"][0]["pointer"] == "/assets/b.glb"
    put = client.put(
        f"/v1/assets/{digests['b.glb']}",
        content=b"b",
        headers={"Content-Type": "application/octet-stream"},
    )
    assert (put.status_code, put.json()["created"]) == (201, True)
    assert client.post("/v1/jobs", json=body).status_code == 202


def test_pages_meet_every_job_once(client: httpx.Client) -> None:
    ids = [submit(client)["id"] for _ in range(7)]
    seen: list[object] = []
    cursor: str | None = None
    while True:
        params: dict[str, str | int] = {"limit": 3} | ({"cursor": cursor} if cursor else {})
        page = client.get("/v1/jobs", params=params).json()
        seen += [job["id"] for job in page["jobs"]]
        cursor = page["next_cursor"]
        if cursor is None:
            break
    assert seen == ids[::-1]


def test_the_state_filter_belongs_to_the_cursor(client: httpx.Client, engine: FakeEngine) -> None:
    ids = [str(submit(client)["id"]) for _ in range(4)]
    engine.finish(ids[0])
    page = client.get("/v1/jobs", params={"state": "queued", "limit": 2}).json()
    assert [job["id"] for job in page["jobs"]] == [ids[3], ids[2]]
    wrong = client.get("/v1/jobs", params={"cursor": page["next_cursor"]})
    assert (wrong.status_code, wrong.json()["code"]) == (400, "invalid_cursor")
    done = client.get("/v1/jobs", params={"state": "succeeded"}).json()
    assert [job["id"] for job in done["jobs"]] == [ids[0]]


@pytest.mark.parametrize("cursor", ["x", "%%%", "é", "WzEsICJqb2JzOjoiLCAiXHVkODAwIl0", "W10"])
def test_a_damaged_cursor_is_400(client: httpx.Client, cursor: str) -> None:
    answer = client.get("/v1/jobs", params={"cursor": cursor})
    assert (answer.status_code, answer.json()["code"]) == (400, "invalid_cursor")


def test_cancel_ends_a_live_job_and_leaves_an_ended_one(
    client: httpx.Client, engine: FakeEngine
) -> None:
    live, done = str(submit(client)["id"]), str(submit(client)["id"])
    engine.finish(done)
    assert client.post(f"/v1/jobs/{live}:cancel").json()["state"] == "cancelled"
    assert client.post(f"/v1/jobs/{live}:cancel", json={}).json()["state"] == "cancelled"
    assert client.post(f"/v1/jobs/{done}:cancel").json()["state"] == "succeeded"


@pytest.mark.parametrize(
    ("last", "media_type"),
    [
        ("image.png", "image/png"),
        ("image.exr", "image/x-exr"),
        ("report", "application/json"),
        ("error-plot.svg", "image/svg+xml"),
    ],
)
def test_files_of_a_job(
    client: httpx.Client, engine: FakeEngine, last: str, media_type: str
) -> None:
    job_id = str(submit(client)["id"])
    early = client.get(f"/v1/jobs/{job_id}/{last}")
    assert (early.status_code, early.json()["code"]) == (409, "job_not_finished")
    assert early.json()["links"]["job"] == f"/v1/jobs/{job_id}"
    assert "retry-after" in early.headers
    engine.finish(job_id)
    answer = client.get(f"/v1/jobs/{job_id}/{last}")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith(media_type)
    assert job_id in answer.text
    fresh = client.get(
        f"/v1/jobs/{job_id}/{last}", headers={"If-None-Match": answer.headers["etag"]}
    )
    assert (fresh.status_code, fresh.content) == (304, b"")
    head = client.head(f"/v1/jobs/{job_id}/{last}")
    assert (head.status_code, head.content) == (200, b"")
    part = client.get(f"/v1/jobs/{job_id}/{last}", headers={"Range": "bytes=0-3"})
    assert (part.status_code, part.content) == (206, answer.content[:4])
    links = client.get(f"/v1/jobs/{job_id}").json()["links"]
    assert f"/v1/jobs/{job_id}/{last}" in links.values()


def test_files_of_a_failed_job_say_why(client: httpx.Client, engine: FakeEngine) -> None:
    job_id = str(submit(client)["id"])
    engine.finish(job_id, JobState.FAILED)
    answer = client.get(f"/v1/jobs/{job_id}/image.png")
    assert (answer.status_code, answer.json()["code"]) == (409, "job_not_succeeded")
    assert "crashed" in answer.json()["detail"]


def test_draining_refuses_new_work_with_503(client: httpx.Client, engine: FakeEngine) -> None:
    engine.is_draining = True
    answer = client.post("/v1/jobs", json=BODY)
    assert (answer.status_code, answer.json()["code"]) == (503, "draining")
    assert "retry-after" in answer.headers
    ready = client.get("/readyz")
    assert (ready.status_code, ready.json()["code"]) == (503, "not_ready")
    assert client.get("/healthz").status_code == 200


def test_log_and_attempts(client: httpx.Client) -> None:
    job = client.post("/v1/jobs", json={"scene": {"version": 1}}).json()
    log = client.get(job["links"]["log"])
    assert log.text == "one\ntwo\n" and log.headers["content-type"] == "text/plain; charset=utf-8"
    assert client.get(job["links"]["log"], params={"bytes": 4}).text == "two\n"
    first = client.get(job["links"]["attempts"], params={"limit": 2}).json()
    assert [one["token"] for one in first["attempts"]] == [1, 2]
    more = {"limit": 2, "cursor": first["next_cursor"]}
    last = client.get(job["links"]["attempts"], params=more).json()
    assert last["next_cursor"] is None
    (failed,) = last["attempts"]
    assert (failed["error_class"], failed["printed"]) == ("signal", "oh")
    assert failed["started"] == "1970-01-01T00:00:03Z"
    for what in ("log", "attempts"):
        answer = client.get(f"/v1/jobs/nobody/{what}")
        assert (answer.status_code, answer.json()["code"]) == (404, "job_not_found")
        assert client.get(job["links"][what], params={"bytes": 0, "limit": 0}).status_code == 422


def test_an_unfinished_job_leads_to_what_there_is(client: httpx.Client, engine: FakeEngine) -> None:
    job = client.post("/v1/jobs", json={"scene": {"version": 1}}).json()
    url = job["links"]["self"]
    for name in ("image.png", "image.jpg", "image.exr", "report", "error-plot.svg",
                 "thumbnail.jpg", "image.png?exposure=1", "preview"):  # fmt: skip
        answer = client.get(f"{url}/{name}")
        problem = answer.json()
        assert (answer.status_code, problem["code"]) == (409, "job_not_finished"), name
        assert answer.headers["retry-after"] and (problem["state"], problem["progress"]) == (
            "queued", 0.0,
        )  # fmt: skip
        assert problem["links"] == {"job": url, "events": f"{url}/events", "log": f"{url}/log"}
    engine.jobs[job["id"]] = replace(engine.jobs[job["id"]], state=JobState.RUNNING, spp=8)
    links = client.get(f"{url}/image.png").json()["links"]
    assert client.get(links["preview"]).status_code == 200
    assert client.get(links["job"]).status_code == 200


def test_lists_take_an_order_and_a_label(client: httpx.Client) -> None:
    ids = [submit(client, label=label)["id"] for label in ("a", "b", "a", "a")]
    page = client.get("/v1/jobs", params={"order": "created", "label": "a", "limit": 2}).json()
    assert [job["id"] for job in page["jobs"]] == [ids[0], ids[2]]
    rest = {"order": "created", "label": "a", "limit": 2, "cursor": page["next_cursor"]}
    last = client.get("/v1/jobs", params=rest).json()
    assert [job["id"] for job in last["jobs"]] == [ids[3]] and last["next_cursor"] is None
    for other in ({"order": "-created"}, {"label": "b"}):  # a cursor carries order and filters
        answer = client.get("/v1/jobs", params={**rest, **other})
        assert (answer.status_code, answer.json()["code"]) == (400, "invalid_cursor")
    for path in ("/v1/jobs", "/v1/sweeps"):
        assert client.get(path, params={"order": "name"}).status_code == 422
        assert client.get(path, params={"order": "-finished", "label": "x"}).status_code == 200
