"""Malformed scenes of tests/support: one clear error over HTTP and CLI, nothing left behind."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

pytest.importorskip("matiere._core", reason="needs the built core")

from malformed import CASES, GOOD, Case
from real_queue import served_queue

from matiere.jobs.engine import Engine
from matiere.service.cli import main

# These are told while the JSON is read, before anything knows it is a scene.
BY_THE_PARSER = {"not_json": "invalid_json", "deep_nesting": "json_too_deep"}


@pytest.fixture(scope="module")
def queue(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Engine, str]]:
    """Serve a queue that renders for real."""
    with served_queue(tmp_path_factory.mktemp("real") / "data") as served:
        yield served


def state(engine: Engine) -> tuple[set[str], int]:
    """Return the files of the data directory and the number of jobs."""
    found = {str(path) for path in engine.data_dir.rglob("*") if path.is_file()}
    own = ("store.sqlite", "serve.log", "child-", "utility")
    files = {path for path in found if not Path(path).name.startswith(own)}
    return files, len(engine.list_jobs(limit=1000))


def test_there_are_twenty_of_them() -> None:
    assert len(CASES) >= 20


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_over_http(queue: tuple[Engine, str], case: Case) -> None:
    engine, url = queue
    before = state(engine)
    body = '{"scene": ' + case.text + "}"
    answer = httpx.post(
        url + "/v1/jobs", content=body, headers={"Content-Type": "application/json"}, timeout=30
    )
    problem = answer.json()
    print(answer.status_code, problem["code"], problem["detail"])
    assert answer.headers["content-type"] == "application/problem+json"
    assert answer.status_code == (400 if case.name == "not_json" else 422)
    (error,) = problem["errors"]
    assert error["message"] and len(error["message"]) < 500
    if case.name in BY_THE_PARSER:
        assert problem["code"] == BY_THE_PARSER[case.name]
        assert error["pointer"] == ("" if case.name == "not_json" else "/scene/deep" + "/0" * 62)
    else:
        if case.name != "not_an_object":  # the envelope says: scene must be an object
            assert error["code"] == case.code
        assert error["pointer"] == "/scene" + case.pointer
        assert error["pointer"] in problem["detail"]
    if case.suggestion:
        assert error["suggestion"] == case.suggestion
    assert state(engine) == before


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_as_the_base_of_a_sweep(queue: tuple[Engine, str], case: Case) -> None:
    engine, url = queue
    before = state(engine)
    axes = '[{"pointer": "/render/seed", "values": [1, 2]}]'
    body = f'{{"base": {case.text}, "axes": {axes}}}'
    answer = httpx.post(
        url + "/v1/sweeps", content=body, headers={"Content-Type": "application/json"}, timeout=30
    )
    problem = answer.json()
    assert answer.status_code == (400 if case.name == "not_json" else 422)
    (error,) = problem["errors"]
    if case.name not in BY_THE_PARSER:
        assert error["pointer"] == "/base" + case.pointer
    assert state(engine) == before


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_through_submit(
    queue: tuple[Engine, str], case: Case, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    engine, url = queue
    before = state(engine)
    path, output = tmp_path / "scene.json", tmp_path / "out.png"
    path.write_text(case.text)
    with pytest.raises(SystemExit) as end:
        main(["submit", str(path), "--url", url, "-o", str(output)])
    said = capsys.readouterr().err
    assert end.value.code == 2
    (line,) = said.strip().splitlines()
    place = f"{path}: {case.pointer}: " if case.pointer else f"{path}: "
    assert line.startswith(place), line
    assert not output.exists()
    assert state(engine) == before


def test_all_errors_come_at_once(queue: tuple[Engine, str]) -> None:
    scene = json.loads(json.dumps(GOOD))
    scene["materials"]["ball"]["alpha"] = -1
    scene["film"]["width"] = 0
    scene["shapes"][0]["material"] = "bal"
    answer = httpx.post(queue[1] + "/v1/jobs", json={"scene": scene, "stop": {"spp": 4}})
    pointers = [error["pointer"] for error in answer.json()["errors"]]
    assert pointers == [
        "/scene/film/width",
        "/scene/materials/ball/alpha",
        "/scene/shapes/0/material",
    ]
