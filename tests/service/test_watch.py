"""`matiere watch`: figures that are true, lines and a bar, a restart in the middle, exit codes."""

from __future__ import annotations

import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from serving import command, serve

from matiere.service.client import Client, JobStatus, SweepStatus
from matiere.service.watching import Pace, figures, outlook, sweep_figures

SCENE: dict[str, Any] = {"width": 16, "height": 16, "value": 1.0}
LOOK = {"relmse": 3e-3, "relmse_interval": (2e-3, 4e-3)}


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    """A served queue of the stand-in renderer."""
    with serve(tmp_path_factory.mktemp("watch") / "d", "--children", 1) as (_, client):
        yield client


def scene(spp: int, chunk_s: float = 0.03, **more: Any) -> dict[str, Any]:
    """Return a scene that no other test has."""
    return SCENE | {
        "chunk_s": chunk_s,
        "render": {"spp": spp, "seed": time.time_ns() % 2**31},
        **more,
    }


def job(**more: Any) -> JobStatus:
    """Return a job that is being rendered."""
    facts = {"id": "1", "state": "running", "width": 8, "height": 8, "spp": 256, "progress": 0.25}
    return JobStatus.model_validate({**facts, "seconds": 30.0, "stop": {"spp": 1024}, **more})


def paced(rate: float) -> Pace:
    """Return a pace of so many render seconds a second."""
    now = [100.0]
    pace = Pace(lambda: now[0])
    for _ in range(5):
        now[0] += 1.0
        pace.see((now[0] - 100.0) * rate)
    return pace


# -- words ---------------------------------------------------------------------------------------
def test_render_seconds_are_told_until_the_pace_is_known() -> None:
    assert outlook(job(), Pace()) == "about 1:30 of rendering left"
    assert outlook(job(), paced(2.0)) == "about 0:45 left", "two processes render"
    assert figures(job(), paced(2.0)) == "256 of 1,024 spp, error unknown, about 0:45 left"


def test_the_target_is_told_with_its_time() -> None:
    stop = {"spp": 4096, "target_error": {"relmse": 1e-3}}
    unknown = job(stop=stop, **LOOK)
    assert outlook(unknown, paced(1.0)) == "time to relMSE 0.001 not known yet"
    near = job(stop=stop, target_seconds=90.0, progress=30 / 90, **LOOK)
    assert figures(near, paced(1.0)) == (
        "256 of 4,096 spp, relMSE 3.00e-03 (95 %: 2.00e-03 to 4.00e-03), relMSE 0.001 in about 1:00"
    )
    late = job(stop=stop, target_seconds=90.0, progress=0.75, **LOOK)
    assert outlook(late, paced(1.0)) == "ends in about 0:10, before relMSE 0.001 (about 1:00)"
    over = job(stop=stop, target_seconds=20.0, progress=0.99, **LOOK)
    assert outlook(over, paced(1.0)) == "relMSE 0.001 in about 0:00"


def test_the_pace_forgets_a_pause_and_an_earlier_attempt() -> None:
    now = [0.0]
    pace = Pace(lambda: now[0])
    for at, seconds in [(0, 0), (10, 10), (100, 11), (101, 12), (102, 13)]:
        now[0] = at
        pace.see(seconds)
    assert pace.wait(5.0) == pytest.approx(5.0), "the pause is outside the window"
    pace.see(0.5)
    assert pace.wait(5.0) is None


def test_states_other_than_running_are_named() -> None:
    assert (
        figures(job(state="queued", spp=0, waiting_for=2), Pace()) == "queued, waits for 2 others"
    )
    reused = job(state="succeeded", spp=2048)
    assert figures(reused, Pace()) == "2,048 spp, error unknown", "an earlier render had more"
    assert figures(job(state="paused"), paced(1.0)) == "paused, 256 of 1,024 spp, error unknown"


def test_a_sweep_tells_how_its_cells_ended() -> None:
    counts = {"queued": 2, "paused": 1, "running": 1, "succeeded": 3, "failed": 1}
    sweep = SweepStatus(id="1", state="running", axes=[], cells=8, counts=counts, columns=2)
    assert sweep_figures(sweep, Pace()) == (
        "4 of 8 cells, 2 queued, 1 paused, 1 running, 3 succeeded, 1 failed"
    )
    assert sweep_figures(sweep, paced(0.01)).endswith("1 failed, about 0:50 left")


# -- the command -----------------------------------------------------------------------------------
def test_lines_tell_of_a_job_and_its_end(service: Client) -> None:
    name = service.steer(service.submit(scene(64), label="ball").id, "pause").id
    with command("watch", name, "--url", service.url) as watching:
        watching.line("")
        service.steer(name, "resume")
        said = watching.output()
        assert watching.process.wait(120) == 0, said
    *lines, last = said.splitlines()
    assert lines and all(re.match(r"\d\d:\d\d:\d\d  ball +\d+ %  ", line) for line in lines), said
    assert re.fullmatch(r"ball: 64 spp in .* s, relMSE .* \(95 %: .* to .*\), stopped by spp", last)


def test_a_sweep_is_watched(service: Client) -> None:
    axes = [{"pointer": "/value", "values": [1.0, 2.0, 3.0]}]
    sweep = service.submit_sweep(scene(16), axes, label="three")
    service.steer_sweep(sweep.id, "pause")
    with command("watch", sweep.id, "--url", service.url) as watching:
        watching.line("")
        service.steer_sweep(sweep.id, "resume")
        said = watching.output()
        assert watching.process.wait(120) == 0, said
    assert said.splitlines()[-1] == "three: succeeded, 3 succeeded"
    assert " of 3 cells, " in said


def test_the_exit_code_tells_how_it_ended(service: Client) -> None:
    cancelled = service.submit(scene(4096))
    failed = service.submit(scene(16, misdeed={"kind": "raise"}))
    expired = service.submit(scene(4096), deadline=0.3)
    service.cancel(cancelled.id)
    for name in (failed.id, expired.id):
        service.wait(name, timeout_s=120)
    for name, code in ((cancelled.id, 3), (failed.id, 1), (expired.id, 4), ("nothing", 2)):
        with command("watch", name, "--url", service.url) as watching:
            said = watching.output()
            assert watching.process.wait(120) == code, said
    assert "no job or sweep has the id nothing" in said


def test_who_stops_watching_leaves_the_job(service: Client) -> None:
    name = service.submit(scene(4096)).id
    with command("watch", name, "--url", service.url) as watching:
        while not any(" of 4,096 spp" in line for line in watching.lines):
            watching.lines.append(watching._queue.get(timeout=120) or "")
        assert watching.stop(signal.SIGINT) == 130
        said = watching.output()
    assert f"job {name} goes on" in said and f"matiere cancel {name} --url {service.url}" in said
    assert "Traceback" not in said
    assert not service.job(name).ended
    assert service.cancel(name).state == "cancelled"


def test_a_terminal_gets_a_bar(service: Client) -> None:
    name = service.submit(scene(64), label="bar").id
    here, there = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "matiere.service", "watch", name, "--url", service.url],
        stdout=there, stderr=there, env={**os.environ, "TERM": "xterm", "COLUMNS": "160"},
    )  # fmt: skip
    os.close(there)
    text = b""
    end = time.monotonic() + 120
    while time.monotonic() < end:
        if select.select([here], [], [], 0.5)[0]:
            try:
                text += os.read(here, 65536)
            except OSError:  # the other end is closed
                break
    os.close(here)
    assert process.wait(120) == 0, text
    assert "━".encode() in text and b"of 64 spp" in text and b"stopped by spp" in text


@pytest.mark.slow
def test_a_restart_is_told_and_outlived(tmp_path: Path) -> None:
    data = tmp_path / "d"
    with serve(data, "--children", 1) as (first, client):
        url, port = client.url, client.url.rsplit(":", 1)[1]
        name = client.submit(scene(128, chunk_s=0.05), label="long").id
        with command("watch", name, "--url", url) as watching:
            watching.line("")  # the first line: it is connected
            first.process.kill()
            first.process.wait(10)
            with command("serve", "--data", data, "--port", port, "--children", 1):
                watching.line("long: ", 180)
                said = watching.output()
                assert watching.process.wait(120) == 0, said
    assert said.count("does not answer") == 1 == said.count("answers again"), said
    shares = [int(share) for share in re.findall(r"long +(\d+) %", said)]
    assert shares == sorted(shares), "no step back"
    assert said.splitlines()[-1].startswith("long: 128 spp in ")
