"""The documents, the OpenAPI and the code name the same routes, codes and settings."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import httpx
import pytest
from fake_engine import FakeEngine
from fastapi import FastAPI

from matiere.jobs.sweep import parse_sweep
from matiere.scene.model import TargetError
from matiere.service.errors import ALIASES, CODES, TYPE_PREFIX
from matiere.service.schemas import JobSubmission, SweepSubmission, Target
from matiere.service.settings import Settings
from matiere.service.sweepfile import SweepFile

BUILT_IN = {("GET", "/v1/openapi.json")}


def operations(app: FastAPI) -> set[tuple[str, str]]:
    """Return every (method, path) of the OpenAPI document."""
    paths: dict[str, dict[str, Any]] = app.openapi()["paths"]
    return {(method.upper(), path) for path, item in paths.items() for method in item}


@pytest.fixture
def http_page(root: Path) -> str:
    """Return docs/http.md."""
    return (root / "docs" / "http.md").read_text(encoding="utf-8")


def table(page: str, heading: str) -> list[list[str]]:
    """Return the rows of the table below a heading, without its own head."""
    section = page.split(f"## {heading}\n")[1].split("\n## ")[0]
    rows = [line.strip("|").split("|") for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in row] for row in rows[2:]]


def test_every_route_is_documented(app: FastAPI, http_page: str) -> None:
    said = {tuple(row[0].strip("`").split(" ", 1)) for row in table(http_page, "Routes")}
    twins = {("HEAD", path) for method, path in operations(app) if method == "GET"}
    assert said == (operations(app) | BUILT_IN) - twins


def test_every_problem_code_is_documented_with_its_status(http_page: str) -> None:
    said = {row[0].strip("`"): int(row[1]) for row in table(http_page, "Errors")}
    assert said == {code: kind.status for code, kind in CODES.items()}
    assert set(ALIASES.values()) <= set(CODES)


def test_every_setting_is_documented(http_page: str) -> None:
    said = [row[0].strip("`") for row in table(http_page, "Settings")]
    assert said == list(Settings.model_fields)


def test_json_of_the_documents_is_accepted(root: Path, http_page: str) -> None:
    submitting = http_page.split("## Submitting")[1]
    JobSubmission.model_validate(json.loads(re.findall(r"```json\n(.*?)```", submitting, re.S)[0]))
    sweeps = http_page.split("## Sweeps")[1]
    SweepSubmission.model_validate(json.loads(re.findall(r"```json\n(.*?)```", sweeps, re.S)[0]))
    page = (root / "docs" / "sweep.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```json[^\n]*\n(.*?)```", page, re.S)
    file, *parts = (json.loads(block) for block in blocks)
    base = json.loads((root / file["base"]).read_text(encoding="utf-8"))
    for part in [{}, *parts]:
        whole = {**file, **({"axes": [part]} if "pointer" in part else part)}
        language = SweepFile.model_validate(whole).language()
        assert len(parse_sweep({"mode": whole.get("mode", "grid"), **language}, base)) > 1
    keys = {row[0].strip("`") for row in table(page, "The file")}
    assert set(SweepFile.model_fields) <= keys


def test_openapi_is_served_and_complete(client: httpx.Client, app: FastAPI) -> None:
    served = client.get("/v1/openapi.json").json()
    assert served == json.loads(json.dumps(app.openapi()))
    ids = [
        operation["operationId"] for item in served["paths"].values() for operation in item.values()
    ]
    assert len(ids) == len(set(ids))
    post = served["paths"]["/v1/jobs"]["post"]
    assert "202" in post["responses"] and "200" not in post["responses"]
    assert any(p["name"] == "Idempotency-Key" for p in post["parameters"])


def test_every_route_answers_errors_as_problem_documents(
    client: httpx.Client, app: FastAPI, engine: FakeEngine
) -> None:
    """A wrong id, a wrong method, a wrong body: at every route, a 4xx that is a problem."""
    checked = 0
    for method, path in sorted(operations(app)):
        address = re.sub(r"\{\w+\}", "nothing", path)
        answers = [client.request("DELETE", address, headers={"Content-Type": "application/json"})]
        if "{" in path and method != "HEAD":
            answers.append(client.request(method, address, json=None if method == "PUT" else {}))
        if method == "POST" and ":" not in path:
            answers.append(client.post(address, json={"wrong": 1}))
            answers.append(
                client.post(address, content=b"x", headers={"Content-Type": "text/plain"})
            )
        for answer in answers:
            assert 400 <= answer.status_code < 500, (method, path, answer.text)
            assert answer.headers["content-type"] == "application/problem+json", (method, path)
            problem = answer.json()
            assert problem["type"] == TYPE_PREFIX + problem["code"]
            assert problem["status"] == answer.status_code == CODES[problem["code"]].status
            assert problem["title"] and problem["detail"] and problem["remedy"]
            assert isinstance(problem["errors"], list)
            checked += 1
    assert checked > 25
    assert client.request(
        "DELETE", "/v1/jobs", headers={"Content-Type": "application/json"}
    ).headers["allow"]


def facts(schema: Any) -> Any:
    """Return a JSON Schema without its names and the descriptions of its objects."""
    if isinstance(schema, list):
        return [facts(entry) for entry in schema]
    if not isinstance(schema, dict):
        return schema
    left_out = {"title"} | ({"description"} if "properties" in schema else set())
    return {key: facts(value) for key, value in schema.items() if key not in left_out}


def test_a_target_is_the_same_in_a_submission_and_in_a_scene() -> None:
    assert facts(Target.model_json_schema()) == facts(TargetError.model_json_schema())
