"""`matiere serve` as a process: start, what it prints, second start, busy port, signals."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import stat
import time
from pathlib import Path

import httpx
import psutil
import pytest
from serving import command, serve

from matiere.service.cli import main

QUICK_SCENE = {"width": 16, "height": 16, "value": 0.5, "render": {"spp": 16}}


def test_serve_prints_where_everything_is_and_ends_on_sigterm(tmp_path: Path) -> None:
    data = tmp_path / "data"
    with serve(data, "--children", 1) as (serving, client):
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+", serving.url)
        assert serving.line("data directory") == str(data)
        log = Path(serving.line("log "))
        assert serving.line("children") == "1 render process of 1 thread, 1 utility process"
        note = json.loads((data / "server.json").read_text())
        assert (note["url"], note["pid"]) == (serving.url, serving.process.pid)
        assert stat.S_IMODE((data / "server.json").stat().st_mode) == 0o600, "it holds a token"
        assert stat.S_IMODE(data.stat().st_mode) == 0o700
        job = client.submit(QUICK_SCENE)
        job = client.wait(job.id, timeout_s=30)
        assert job.state == "succeeded", job
        children = psutil.Process(serving.process.pid).children(recursive=True)
        assert len(children) >= 2  # a render child and the utility child
        begin = time.perf_counter()
        assert serving.stop() == 0
        assert time.perf_counter() - begin < 10
        assert "accepted jobs are kept" in serving.output()
        assert not [child for child in children if child.is_running()]
    assert not (data / "server.json").exists()
    assert "POST /v1/jobs" in log.read_text()
    assert log.parent == data / "logs"


def test_a_second_serve_names_url_and_pid(tmp_path: Path) -> None:
    with serve(tmp_path / "data") as (first, _):
        port = first.url.rsplit(":", 1)[1]
        for other_port in (0, port):  # another port, and the very same
            with command("serve", "--data", tmp_path / "data", "--port", other_port) as second:
                said = second.output()
                assert second.process.wait(10) == 2
            assert first.url in said and str(first.process.pid) in said, said
            assert "Traceback" not in said
        assert httpx.get(first.url + "/readyz").status_code == 200


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Run `matiere serve` here, which must refuse; return what it said."""
    with pytest.raises(SystemExit) as end:
        main(["serve", *map(str, arguments)])
    assert end.value.code == 2
    return capsys.readouterr().err


def test_a_busy_port_is_said_with_its_holder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as holder:
        port = holder.getsockname()[1]
        said = refused(capsys, "--data", tmp_path / "data", "--port", port)
    assert f"port {port}" in said and f"process {os.getpid()}" in said and "--port 0" in said
    assert not (tmp_path / "data").exists()


def test_a_bad_setting_names_its_origin(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MATIERE_CHILDREN", "many")
    said = refused(capsys, "--data", tmp_path / "data")
    assert "environment MATIERE_CHILDREN" in said
    assert not (tmp_path / "data").exists()


def test_jobs_accepted_before_sigterm_are_finished_after_the_next_start(tmp_path: Path) -> None:
    slow = {**QUICK_SCENE, "chunk_s": 0.05}
    data = tmp_path / "data"
    with serve(data, "--children", 1) as (serving, client):
        ids = [client.submit({**slow, "value": 0.1 + i}).id for i in range(4)]
        assert serving.stop() == 0
    with serve(data, "--children", 2) as (serving, client):
        states = [client.wait(job_id, timeout_s=60).state for job_id in ids]
        assert states == ["succeeded"] * 4


def test_sigterm_ends_within_ten_seconds_whatever_a_chunk_takes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MATIERE_DRAIN_TIMEOUT_S", "2")  # 8 by default
    data = tmp_path / "data"
    with serve(data, "--children", 2) as (serving, client):
        endless = client.submit({**QUICK_SCENE, "chunk_s": 1000.0})
        while client.job(endless.id).state == "queued":
            time.sleep(0.02)
        begin = time.monotonic()
        assert serving.stop() == 0
        took = time.monotonic() - begin
        print(f"ended {took:.1f} s after SIGTERM, with 2 s for running chunks")
        assert took < 10
    with serve(data, "--children", 1) as (serving, client):
        assert client.job(endless.id).state in ("queued", "running"), "kept, not failed"
        assert client.cancel(endless.id).state == "cancelled"
        assert serving.stop() == 0


def test_draining_answers_503_and_a_second_signal_ends_at_once(tmp_path: Path) -> None:
    slow = {**QUICK_SCENE, "chunk_s": 5.0}
    with serve(tmp_path / "data", "--children", 1) as (serving, client):
        job = client.submit(slow)
        while client.job(job.id).state == "queued":
            time.sleep(0.02)
        serving.process.send_signal(signal.SIGTERM)
        serving.line("SIGTERM")
        answer = httpx.post(serving.url + "/v1/jobs", json={"scene": slow})
        assert (answer.status_code, answer.json()["code"]) == (503, "draining")
        ready = httpx.get(serving.url + "/readyz")
        assert (ready.status_code, ready.json()["code"]) == (503, "not_ready")
        assert httpx.get(serving.url + "/healthz").status_code == 200
        children = psutil.Process(serving.process.pid).children(recursive=True)
        begin = time.perf_counter()
        assert serving.stop() == 1
        assert time.perf_counter() - begin < 2
        _, alive = psutil.wait_procs(children, 10)
        assert not alive, "render children outlived the service"


def test_the_service_loads_no_pixel_library(tmp_path: Path) -> None:
    with serve(tmp_path / "data", quick=False) as (serving, client):
        assert client.ready()
        maps = Path(f"/proc/{serving.process.pid}/maps").read_text()
    assert "OpenImageIO" not in maps and "PyOpenColorIO" not in maps
