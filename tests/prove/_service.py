"""A real `matiere serve` for the acceptance lines: start, kill -9, start again, ask over HTTP."""

from __future__ import annotations

import atexit
import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from matiere.imageio import read_image
from matiere.service.client import Client

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "prove-out"
EDGE = 128
ALPHAS = (0.05, 0.15, 0.3, 0.5)
MATERIALS: tuple[dict[str, Any], ...] = (
    {"type": "conductor", "metal": "Au"},
    {"type": "conductor", "metal": "Cu"},
    {"type": "conductor", "metal": "Al"},
    {"type": "plastic", "albedo": [0.5, 0.05, 0.04]},
    {"type": "plastic", "albedo": [0.03, 0.2, 0.4]},
    {"type": "cook_torrance", "F0": [0.05, 0.05, 0.05], "diffuse": [0.1, 0.3, 0.1]},
)


def sweep_request(edge: int = EDGE) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return base scene and axes of the 24-cell sweep: 4 roughnesses x 6 materials."""
    base = json.loads((ROOT / "examples" / "scenes" / "rough_metals.json").read_text())
    base["film"] = {"width": edge, "height": edge}
    base["materials"]["ball"] = {"type": "conductor", "metal": "Au"}
    for shape in base["shapes"]:
        if shape["type"] == "sphere":
            shape["material"] = "ball"
    axes = [
        {"pointer": "/materials/ball/alpha", "values": list(ALPHAS)},
        {"pointer": "/materials/ball", "label": "material", "values": list(MATERIALS)},
    ]
    return base, axes[::-1]


class Service:
    """One `matiere serve` process on a free port."""

    def __init__(
        self,
        data: Path,
        children: int | None = 2,
        threads: int = 1,
        database_url: str | None = None,
        options: Mapping[str, str] | None = None,
    ) -> None:
        """Start it (with SQLite, or a PostgreSQL database) and wait until it answers."""
        data.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-m", "matiere.service", "serve", "--data", str(data)]
        command += ["--port", "0", "--threads-per-child", str(threads)]
        command += ["--children", str(children)] if children else []
        self.data = data
        settings = {**(options or {}), **({"database_url": database_url} if database_url else {})}
        more = {f"MATIERE_{name.upper()}": value for name, value in settings.items()}
        with (data / "serve.out").open("ab") as out:
            self.process = subprocess.Popen(command, stdout=out, stderr=out, env=os.environ | more)
        atexit.register(self.process.kill)  # also when the line fails half-way
        end = time.monotonic() + 120
        while not self._announced():
            if self.process.poll() is not None or time.monotonic() > end:
                raise SystemExit(f"the service did not start; see {data / 'serve.out'}")
            time.sleep(0.05)
        self.client = Client(self._note()["url"], patience_s=5.0)

    def _note(self) -> dict[str, Any]:
        try:
            note = json.loads((self.data / "server.json").read_text())
        except (OSError, ValueError):
            return {}
        return note if note.get("pid") == self.process.pid else {}

    def _announced(self) -> bool:
        return bool(self._note().get("url"))

    def status(self) -> dict[str, Any]:
        """Return what the service says of itself: children, counters, what it resumed."""
        import httpx

        answer = httpx.get(f"{self.client.url}/v1/status", trust_env=False)
        return dict(answer.raise_for_status().json())

    def kill(self) -> None:
        """SIGKILL the service."""
        self.client.close()
        self.process.kill()
        self.process.wait()

    def stop(self) -> None:
        """Let the service end in order."""
        self.client.close()
        self.process.terminate()
        self.process.wait(30)


def kill_one_child(service: Service, which: int) -> int:
    """SIGKILL one child of a service, waiting for one to be there; return its pid."""
    until = time.monotonic() + 60
    while not (pids := [c["pid"] for c in service.status()["children"] if c["pid"]]):
        assert time.monotonic() < until, "no child came back within a minute"
        time.sleep(0.1)
    pid = int(pids[which % len(pids)])
    os.kill(pid, signal.SIGKILL)
    return pid


def pixel_hash(path: Path) -> str:
    """Return the SHA-256 of the pixels of an EXR, colour and standard error."""
    pixels = np.ascontiguousarray(read_image(path).pixels)
    assert np.isfinite(pixels[..., :3]).all()
    return hashlib.sha256(pixels.tobytes()).hexdigest()


def cell_hashes(service: Service, sweep_id: str, folder: Path) -> list[str]:
    """Fetch every cell's EXR of a finished sweep and return the pixel hashes in order."""
    folder.mkdir(parents=True, exist_ok=True)
    found = []
    for job in sorted(service.client.jobs(sweep=sweep_id), key=lambda job: job.cell or 0):
        path = service.client.fetch(job.id, "image.exr", folder / f"{job.cell}.exr")
        found.append(pixel_hash(path))
    return found


def wait_sweep(service: Service, sweep_id: str) -> Any:
    """Return the sweep once every cell has ended."""
    while not (status := service.client.sweep(sweep_id)).ended:
        time.sleep(0.2)
    return status
