"""Nights over HTTP and at the command line."""

from __future__ import annotations

from typing import Any

import httpx
import pytest
from fake_engine import FakeEngine

SWEEP: dict[str, Any] = {
    "base": {"version": 1},
    "axes": [{"pointer": "/x", "values": [1, 2], "label": "x"}],
}


def finished(client: httpx.Client, engine: FakeEngine) -> str:
    """Submit a sweep, let its cells succeed and return its id."""
    sweep_id = str(client.post("/v1/sweeps", json=SWEEP).json()["id"])
    for job in list(engine.jobs.values()):
        if job.sweep_id == sweep_id:
            engine.finish(job.id)
    return sweep_id


def test_a_night_is_listed_by_pages_and_fetched(client: httpx.Client, engine: FakeEngine) -> None:
    sweep_id = finished(client, engine)
    night = client.get(f"/v1/sweeps/{sweep_id}/night").json()
    assert night["pages"] == [f"/v1/sweeps/{sweep_id}/night/0"] and night["cells"] == 2
    answer = client.get(night["pages"][0])
    assert answer.content == f"night of {sweep_id}".encode() and answer.headers["etag"]
    assert client.get(f"/v1/sweeps/{sweep_id}/night/1").json()["code"] == "artifact_not_found"


def test_an_unfinished_sweep_has_no_night(client: httpx.Client) -> None:
    sweep_id = client.post("/v1/sweeps", json=SWEEP).json()["id"]
    answer = client.get(f"/v1/sweeps/{sweep_id}/night")
    assert answer.status_code == 409 and answer.json()["code"] == "sweep_not_finished"
    compared = client.post("/v1/compare", json={"a": sweep_id, "b": sweep_id})
    assert compared.json()["code"] == "sweep_not_finished"
    assert client.get("/v1/sweeps/none/night").json()["code"] == "sweep_not_found"


def test_two_sweeps_are_compared(client: httpx.Client, engine: FakeEngine) -> None:
    a, b = finished(client, engine), finished(client, engine)
    found = client.post("/v1/compare", json={"a": a, "b": b, "method": "bh"}).json()
    assert found == {"a": a, "b": b, "significance": 0.05, "method": "bh", "power": 0.8,
                     "listed": 100}  # fmt: skip
    busy = client.post("/v1/compare", json={"a": a, "b": a})
    assert busy.status_code == 429 and busy.json()["code"] == "too_many_comparisons"


@pytest.mark.parametrize(
    ("more", "pointer"),
    [({"significance": 0.9}, "/significance"), ({"method": "t"}, "/method"), ({"c": 1}, "/c")],
)
def test_wrong_options_are_refused(client: httpx.Client, more: Any, pointer: str) -> None:
    answer = client.post("/v1/compare", json={"a": "x", "b": "y", **more})
    assert answer.status_code == 422 and answer.json()["errors"][0]["pointer"] == pointer
