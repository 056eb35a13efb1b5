"""The Python client and `matiere submit`, against the application over a queue in memory."""

from __future__ import annotations

import hashlib
import json
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from fake_engine import FakeEngine

from matiere.service.cli import main
from matiere.service.client import Client, ServiceError, Unreachable

MESH = {"version": 1, "shapes": [{"type": "mesh", "file": "mesh/ball.glb", "material": "a"}]}


@pytest.fixture
def api(url: str, engine: FakeEngine) -> Iterator[Client]:
    """Return a client."""
    with Client(url, patience_s=2.0) as client:
        yield client


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Write a scene with a mesh beside it."""
    (tmp_path / "mesh").mkdir()
    (tmp_path / "mesh" / "ball.glb").write_bytes(b"not really a mesh")
    path = tmp_path / "scene.json"
    path.write_text(json.dumps(MESH))
    return path


def finish_soon(engine: FakeEngine) -> threading.Thread:
    """End every job shortly after it comes."""

    def run() -> None:
        for _ in range(200):
            for job_id, job in list(engine.jobs.items()):
                if not job.state.final:
                    engine.finish(job_id)
            time.sleep(0.02)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    return thread


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Run the command line; return exit code, stdout and stderr."""
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return int(end.value.code or 0), out, err


def test_submit_uploads_what_the_service_lacks_once(
    api: Client, engine: FakeEngine, scene: Path
) -> None:
    digest = hashlib.sha256(b"not really a mesh").hexdigest()
    uploads: list[tuple[str, int, int]] = []
    job = api.submit(scene, stop={"spp": 4}, on_upload=lambda *what: uploads.append(what))
    assert engine.assets == {digest}
    assert uploads == [("mesh/ball.glb", 17, 17)]
    assert api.job(job.id) == job
    api.submit(scene, on_upload=lambda *what: uploads.append(what))
    assert len(uploads) == 1


def test_files_outside_the_scene_folder_are_never_read(
    api: Client, engine: FakeEngine, tmp_path: Path
) -> None:
    secret = tmp_path / "secret.glb"
    secret.write_bytes(b"secret")
    inner = tmp_path / "inner"
    inner.mkdir()
    (inner / "link.glb").symlink_to(secret)
    for name in ("../secret.glb", str(secret), "link.glb"):
        shapes = [{"type": "mesh", "file": name, "material": "a"}]
        api.submit({"version": 1, "shapes": shapes}, asset_root=inner)
    assert engine.assets == set()


def test_wait_and_fetch(api: Client, engine: FakeEngine, tmp_path: Path) -> None:
    job = api.submit({"version": 1})
    finish_soon(engine)
    seen: list[str] = []
    job = api.wait(job.id, on_change=lambda job: seen.append(job.state), timeout_s=10)
    assert job.ended and seen[-1] == "succeeded"
    path = api.fetch(job.id, "report.json", tmp_path / "new" / "report.json")
    assert job.id in path.read_text()
    assert [file.name for file in path.parent.iterdir()] == ["report.json"]


def test_wait_gives_up_in_time(api: Client) -> None:
    job = api.submit({"version": 1})
    with pytest.raises(TimeoutError, match=job.id):
        api.wait(job.id, timeout_s=0.2)


def test_all_pages_are_listed(api: Client) -> None:
    ids = [api.submit({"version": 1}).id for _ in range(5)]
    assert [job.id for job in api.jobs(page=2)] == ids[::-1]


def test_errors_carry_pointers_as_seen_from_the_scene(api: Client) -> None:
    with pytest.raises(ServiceError) as caught:
        api.submit({"version": 2})
    error = caught.value
    assert (error.code, error.status) == ("invalid_scene", 422)
    assert error.errors[0]["pointer"] == "/version"
    assert str(error) == "/version: must be 1"


def test_no_service_is_said_at_once() -> None:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{sock.getsockname()[1]}"
    begin = time.perf_counter()
    with pytest.raises(Unreachable, match="matiere serve"), Client(url) as client:
        client.job("x")
    assert time.perf_counter() - begin < 2


def test_a_lost_answer_makes_no_second_job(engine: FakeEngine, url: str) -> None:
    """A proxy passes the first request on and then drops the connection before the answer."""
    target = ("127.0.0.1", int(url.rsplit(":", 1)[1]))
    listener = socket.create_server(("127.0.0.1", 0))
    count = 0

    def proxy() -> None:
        nonlocal count
        while True:
            try:
                here, _ = listener.accept()
            except OSError:
                return
            count += 1
            request = here.recv(65536)
            while b"\r\n\r\n" not in request or request.endswith(b"\r\n\r\n"):
                request += here.recv(65536)
            with socket.create_connection(target) as there:
                there.sendall(request.replace(b"Connection: keep-alive", b"Connection: close"))
                answer = b""
                while piece := there.recv(65536):
                    answer += piece
            if count > 1:
                here.sendall(answer)
            here.close()

    thread = threading.Thread(target=proxy, daemon=True)
    thread.start()
    with Client(f"http://127.0.0.1:{listener.getsockname()[1]}", patience_s=5) as client:
        client._reached = True
        job = client.submit({"version": 1})
    listener.close()
    assert count == 2
    assert list(engine.jobs) == [job.id]


def test_submit_command_prints_the_job(
    capsys: pytest.CaptureFixture[str], url: str, engine: FakeEngine, scene: Path
) -> None:
    code, out, err = run(capsys, "submit", scene, "--url", url, "--spp", 8)
    (job,) = engine.jobs.values()
    assert (code, job.stop, job.label) == (0, {"spp": 8}, "scene"), err
    assert job.id in out and f"{url}/v1/jobs/{job.id}" in out


def test_submit_command_writes_the_results(
    capsys: pytest.CaptureFixture[str], url: str, engine: FakeEngine, scene: Path, tmp_path: Path
) -> None:
    finish_soon(engine)
    png, svg = tmp_path / "out.png", tmp_path / "error.svg"
    code, out, err = run(capsys, "submit", scene, "--url", url, "-o", png, "-o", svg)
    assert code == 0, err
    assert "16 spp" in out and "relMSE 1.00e-02 (95 %: 9.00e-03 to 1.10e-02)" in out
    assert png.read_text().startswith("image.png of")
    assert svg.read_text().startswith("error.svg of")


def test_submit_command_words_errors_like_render(
    capsys: pytest.CaptureFixture[str], url: str, engine: FakeEngine, tmp_path: Path
) -> None:
    path = tmp_path / "bad.json"
    path.write_text('{"version": 2}')
    code, _, err = run(capsys, "submit", path, "--url", url)
    assert (code, err.strip()) == (2, f"{path}: /version: must be 1")
    path.write_text('{"version": 1,')
    code, _, err = run(capsys, "submit", path, "--url", url)
    assert code == 2 and "not valid JSON" in err and str(path) in err
    code, _, err = run(capsys, "submit", tmp_path / "none.json", "--url", url)
    assert code == 2 and "none.json" in err
    code, _, err = run(capsys, "submit", path, "--url", url, "-o", "out.gif")
    assert code == 2 and ".png" in err
    assert not engine.jobs


def test_submit_command_without_a_service(
    capsys: pytest.CaptureFixture[str], scene: Path, tmp_path: Path
) -> None:
    code, _, err = run(capsys, "submit", scene, "--url", "http://127.0.0.1:9")
    assert code == 2 and "matiere serve" in err


def test_files_inside_the_values_of_an_axis_are_sent(tmp_path: Path) -> None:
    from matiere.service.client_files import files_of_sweep

    for name in ("a.binary", "b.binary"):
        (tmp_path / name).write_bytes(name.encode())
    values = [
        {"type": "measured", "file": "a.binary"},
        {"type": "mix", "a": {"type": "measured", "file": "b.binary"}, "b": {"file": "none"}},
    ]
    ball, file = "/materials/ball", "/materials/ball/file"
    for body in (
        {"axes": [{"pointer": ball, "values": values}]},
        {"axes": [{"pointer": file, "values": ["a.binary", "b.binary"]}]},
        {"axes": [{"pointer": ball, "set": "s"}], "sets": {"s": {"x": values}}},
        {"list": [{ball: values[0]}, {file: "b.binary"}]},
        {"axes": [{"pointer": file, "label": "of"}], "list": [{"of": f"{x}.binary"} for x in "ab"]},
        {"overrides": [{"when": "x < 1", "set": {ball: values[0], file: "b.binary"}}]},
    ):
        assert sorted(files_of_sweep(body, tmp_path)) == ["a.binary", "b.binary"], body
