"""What the queue takes from one API key: jobs and cells that have not ended, samples asked for."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from postgres_server import shared_server

from matiere.jobs.engine import Engine, open_engine
from matiere.jobs.limits import Limits
from matiere.service.app import create_app
from matiere.service.server import BackgroundServer, bind, url_of
from matiere.service.settings import Settings

SCENE = {"width": 10, "height": 10, "value": 0.5, "render": {"spp": 16}, "chunk_s": 1000.0}
AXES = [{"pointer": "/value", "values": [0.1, 0.2, 0.3]}]


@pytest.fixture(params=["sqlite", "postgresql"])
def queue(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[Engine, str]]:
    """Serve a queue that takes 4 jobs and 0.01 megasamples of each key."""
    folder = str(Path(__file__).resolve().parents[1] / "jobs")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", folder, prepend=os.pathsep)
    settings = Settings(
        data=tmp_path / "d", max_queued_jobs_per_key=4, max_queued_megasamples_per_key=0.01
    )
    url = shared_server().database() if request.param == "postgresql" else None
    with open_engine(
        settings.data, children=1, work="fake_work", limits=settings.limits(), database_url=url
    ) as engine:
        sock = bind("127.0.0.1", 0)
        with BackgroundServer(create_app(engine, settings), sock):
            yield engine, url_of(sock)


def test_the_limits_of_a_service_reach_the_queue() -> None:
    limits = Settings().limits()
    assert limits == Limits() or (limits.key_queued, limits.key_samples) == (200_000, None)


def test_each_key_has_room_of_its_own(queue: tuple[Engine, str]) -> None:
    engine, url = queue
    first, second = (engine.keys.create(name, "submit")[1] for name in ("first", "second"))
    with httpx.Client(base_url=url, timeout=30) as client:

        def post(key: str, address: str = "/v1/jobs", **body: Any) -> httpx.Response:
            headers = {"Authorization": f"Bearer {key}"}
            return client.post(address, json=body, headers=headers)

        def refused(answer: httpx.Response) -> str:
            assert (answer.status_code, answer.json()["code"]) == (429, "key_limit"), answer.text
            assert int(answer.headers["retry-after"]) >= 1
            return str(answer.json()["detail"])

        sweep = post(first, "/v1/sweeps", base=SCENE, axes=AXES)
        assert sweep.status_code == 202, sweep.text
        assert post(first, scene=SCENE).status_code == 202
        assert "4 of this API key have not ended" in refused(post(first, scene=SCENE))
        assert "2 jobs" in refused(
            post(first, "/v1/sweeps", base=SCENE, axes=[AXES[0] | {"values": [0.6, 0.7]}])
        )
        five = post(first, "/v1/sweeps", base=SCENE, axes=[AXES[0] | {"values": [1, 2, 3, 4, 5]}])
        assert (five.status_code, five.json()["code"]) == (422, "limit_exceeded"), "never fits"
        assert post(second, scene=SCENE | {"value": 0.9}).status_code == 202, "not its queue"

        large = SCENE | {"width": 20, "height": 20}  # 6,400 samples beside the 1,600
        assert post(second, scene=large).status_code == 202
        assert "megasamples" in refused(post(second, scene=large | {"value": 0.7}))
        huge = post(second, scene=large | {"render": {"spp": 64}})
        assert (huge.status_code, huge.json()["code"]) == (422, "limit_exceeded"), "never fits"

        sweep_id = sweep.json()["id"]
        cancelled = client.post(
            f"/v1/sweeps/{sweep_id}:cancel", headers={"Authorization": f"Bearer {first}"}
        )
        assert cancelled.status_code == 200
        assert post(first, scene=SCENE | {"value": 0.8}).status_code == 202, "there is room again"
    assert engine.submit_job(large | {"value": 0.1}).id, "who owns the data has no such limit"


def test_a_repeated_submission_counts_once(queue: tuple[Engine, str]) -> None:
    engine, url = queue
    key = engine.keys.create("first", "submit")[1]
    headers = {"Authorization": f"Bearer {key}", "Idempotency-Key": "one"}
    with httpx.Client(base_url=url, headers=headers, timeout=30) as client:
        answers = [client.post("/v1/jobs", json={"scene": SCENE}) for _ in range(6)]
    assert len({answer.json()["id"] for answer in answers}) == 1
