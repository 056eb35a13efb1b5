"""`kill -9` of a child and then of the service in the middle of a 24-cell sweep over HTTP."""

from __future__ import annotations

import csv
import json
import os
import signal
import socket
import time
from pathlib import Path

import psutil
import pytest
from serving import command

CELLS = 24


def free_port() -> int:
    """Return a port that nobody listens on now."""
    with socket.create_server(("127.0.0.1", 0)) as sock:
        return int(sock.getsockname()[1])


@pytest.mark.slow
def test_a_sweep_outlives_the_service(tmp_path: Path) -> None:
    data, out, port = tmp_path / "data", tmp_path / "out", free_port()
    scene = {"width": 16, "height": 16, "value": 1, "chunk_s": 0.01, "render": {"spp": 32}}
    axes = [
        {"pointer": "/value", "linspace": [0.1, 0.6, 6], "label": "value"},
        {"pointer": "/seed", "values": [1, 2, 3, 4], "label": "seed"},
    ]
    sweep_file = tmp_path / "sweep.json"
    sweep_file.write_text(json.dumps({"version": 1, "base": scene, "axes": axes}))
    serve = ("serve", "--data", data, "--port", port, "--children", 2)

    def done() -> int:
        return len(list((out / "cells").glob("*.png"))) if (out / "cells").exists() else 0

    def wait_for(count: int) -> None:
        end = time.monotonic() + 60
        while done() < count:
            assert time.monotonic() < end and sweep.process.poll() is None, sweep.output()
            time.sleep(0.01)

    with command(*serve) as first:
        url = first.url
        with command("sweep", sweep_file, "-o", out, "--url", url) as sweep:
            wait_for(3)
            children = psutil.Process(first.process.pid).children(recursive=True)
            os.kill(children[0].pid, signal.SIGKILL)
            wait_for(6)
            first.process.send_signal(signal.SIGKILL)
            first.process.wait(10)
            at_kill = done()
            _, alive = psutil.wait_procs(children, 10)
            assert not alive, "children outlived the killed service"
            with command(*serve) as second:
                said = sweep.output()
                assert sweep.process.wait(10) == 0, said
                assert second.stop() == 0
    assert f"{CELLS}/{CELLS} cells" in said
    with (out / "table.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == CELLS and {row["state"] for row in rows} == {"succeeded"}
    for row in rows:
        report = json.loads((out / row["image"]).with_suffix(".json").read_text())
        assert report["min_count"] == report["max_count"] == int(row["spp"]) == 32, row
    assert len({row["job"] for row in rows}) == CELLS
    print(f"{at_kill} of {CELLS} cells were done when the service was killed")
