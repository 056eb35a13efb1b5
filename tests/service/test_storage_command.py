"""Storage over HTTP and at the command line, with a service running and without."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from matiere.jobs.engine import Engine, open_engine
from matiere.service.app import create_app
from matiere.service.cli import main
from matiere.service.server import BackgroundServer, bind, url_of
from matiere.service.settings import Settings

FAKE = str(Path(__file__).parents[1] / "jobs")
SCENE = {"width": 8, "height": 8, "value": 1.0, "render": {"spp": 8}}


@pytest.fixture
def data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a data directory for the commands, whose work is the stand-in of tests/jobs."""
    monkeypatch.syspath_prepend(FAKE)
    monkeypatch.setenv("PYTHONPATH", FAKE, prepend=":")
    monkeypatch.setenv("MATIERE_DATA", str(tmp_path / "data"))
    monkeypatch.setenv("MATIERE_MIN_FREE_BYTES", "0")
    return tmp_path / "data"


@pytest.fixture
def served(data: Path) -> Iterator[tuple[Engine, str]]:
    """Serve a queue and announce it."""
    sock = bind("127.0.0.1", 0)
    url = url_of(sock)
    with (
        open_engine(data, children=1, work="fake_work", min_free_bytes=0) as engine,
        BackgroundServer(create_app(engine, Settings(data=data)), sock),
    ):
        engine.announce(url)
        yield engine, url


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as end:
        main(list(arguments))
    return int(end.value.code or 0)


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> Any:
    assert run(*arguments, "--json") == 0
    return json.loads(capsys.readouterr().out)


def look_around(capsys: pytest.CaptureFixture[str], job_id: str, sweep_id: str) -> int:
    """Use every command, the same with and without a service; return how many files there are."""
    found = printed(capsys, "du")
    files = int(found["artifacts"]["results"]["files"])
    assert files >= 5 and found["artifacts"]["films"]["files"] == 1
    assert found["result_days"] == 30
    assert run("du") == 0
    out = capsys.readouterr().out
    assert "results" in out and f"{files} files" in out and "pinned ones for ever" in out
    assert run("pin", job_id, sweep_id) == 0
    out = capsys.readouterr().out
    assert f"job {job_id} is kept" in out and f"sweep {sweep_id} is kept" in out
    assert run("unpin", sweep_id) == 0
    assert "no longer" in capsys.readouterr().out
    assert printed(capsys, "gc", "--dry-run") == {
        "dry_run": True, "jobs": 0, "sweeps": 0, "films": 0, "film_bytes": 0, "files": 0,
        "file_bytes": 0,
    }  # fmt: skip
    assert run("gc") == 0
    assert "removed 0 jobs" in capsys.readouterr().out
    assert run("pin", "019aaaaa-0000-7000-8000-000000000000") == 2
    assert "no" in capsys.readouterr().err.lower()
    return files + 1


def test_commands_with_and_without_a_service(
    data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("du") == 2
    assert "no data directory" in capsys.readouterr().err
    assert not data.exists(), "looking makes nothing"
    with open_engine(data, children=1, work="fake_work", min_free_bytes=0) as engine:
        job = engine.submit_job(SCENE)
        sweep = engine.submit_sweep(SCENE, [{"pointer": "/value", "values": [1.0]}])
        assert engine.wait_sweep(sweep.id, 60).finished
        sock = bind("127.0.0.1", 0)
        with BackgroundServer(create_app(engine, Settings(data=data)), sock):
            engine.announce(url_of(sock))
            files = look_around(capsys, job.id, sweep.id)
            assert engine.get_job(job.id).pinned and not engine.get_sweep(sweep.id).pinned
            assert run("backup", str(tmp_path / "copy")) == 0
            assert f"copied the job store, {files} files" in capsys.readouterr().out
    assert look_around(capsys, job.id, sweep.id) == files
    assert run("backup", str(tmp_path / "copy")) == 2
    assert "not empty" in capsys.readouterr().err


def test_routes_tell_pin_and_collect(served: tuple[Engine, str]) -> None:
    engine, url = served
    job = engine.wait_job(engine.submit_job(SCENE).id, 60)
    sweep = engine.submit_sweep(SCENE, [{"pointer": "/value", "values": [1.0]}])
    with httpx.Client(base_url=url, headers={"Content-Type": "application/json"}) as client:
        assert client.get("/v1/storage").json()["artifacts"]["films"]["files"] == 1
        for kind, name in (("jobs", job.id), ("sweeps", sweep.id)):
            assert client.post(f"/v1/{kind}/{name}:pin").json()["pinned"] is True
            assert client.get(f"/v1/{kind}/{name}").json()["pinned"] is True
            assert client.post(f"/v1/{kind}/{name}:unpin").json()["pinned"] is False
            assert client.post(f"/v1/{kind}/nothing:pin").status_code == 404
        answer = client.post("/v1/storage:collect", params={"dry_run": "true"})
        assert (answer.status_code, answer.json()["dry_run"]) == (200, True)
        assert client.post("/v1/storage:collect").json()["jobs"] == 0
        with engine.storage._busy:
            busy = client.post("/v1/storage:collect")
        assert (busy.status_code, busy.json()["code"]) == (503, "busy")
