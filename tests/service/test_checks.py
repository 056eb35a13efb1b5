"""Stability reports over HTTP: the answer, its pointers, and what happens when there is no time."""

from __future__ import annotations

import httpx
import pytest

GOOD = {"type": "lambert", "albedo": 0.5}


def test_a_report_is_answered(client: httpx.Client) -> None:
    answer = client.post("/v1/checks", json={"material": GOOD})
    assert answer.status_code == 200, answer.text
    report = answer.json()
    assert report["verdict"] == "pass" and report["material"] == GOOD and report["version"] == 1
    assert "plots" not in report


def test_plots_come_when_asked_for(client: httpx.Client) -> None:
    answer = client.post("/v1/checks", json={"material": GOOD, "plots": True, "seed": 7})
    assert answer.json()["plots"] == {"polar": "<svg>7</svg>"}


def test_a_wrong_material_is_refused_with_its_pointer(client: httpx.Client) -> None:
    answer = client.post("/v1/checks", json={"material": {"type": "wood"}})
    assert answer.status_code == 422
    assert answer.json()["errors"][0]["pointer"] == "/material/type"


@pytest.mark.parametrize(
    ("body", "pointer"),
    [({}, "/material"), ({"material": 3}, "/material"), ({"material": GOOD, "seed": -1}, "/seed"),
     ({"material": GOOD, "sed": 1}, "/sed")],
)  # fmt: skip
def test_a_wrong_request_is_refused(client: httpx.Client, body: object, pointer: str) -> None:
    answer = client.post("/v1/checks", json=body)
    assert answer.status_code == 422 and answer.json()["errors"][0]["pointer"] == pointer


def test_a_second_check_is_told_to_come_back(client: httpx.Client) -> None:
    answer = client.post("/v1/checks", json={"material": {"type": "busy"}})
    assert answer.status_code == 429 and int(answer.headers["retry-after"]) >= 1
    assert answer.json()["code"] == "too_many_checks"


def test_a_child_that_breaks_down_is_our_mistake(client: httpx.Client) -> None:
    answer = client.post("/v1/checks", json={"material": {"type": "broken"}})
    assert answer.status_code == 500 and answer.json()["code"] == "internal_error"
