"""Soak: 30 minutes of mixed jobs, cancels, kills and restarts; nothing grows, nothing stays behind

A real `matiere serve` gets jobs of random scenes, sweeps, cancels, pauses and killed children, is
asked for lists, images and events meanwhile, and is stopped or killed and started again now and
then. Resident memory and open files of the service are sampled every second and, after a warm-up,
fitted with one slope for all lives (a line with its own height for each). Wanted: the slope's 99 %
interval holds 0, or it is below 1 MiB and one descriptor in ten minutes. Now and then a job or
sweep is deleted, and at the end all of them are, running or not: bytes and files of the artifacts
are then those of the start, and after `matiere gc` (with no days for what tells of past work) the
database file is within 10 %. Results are stored in prove-out/soak.json.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import psutil
from _service import OUT, ROOT, Service, kill_one_child
from scipy import stats

MINUTES = 30.0
LIFE_S, LEAST_LIVES = 600.0, 2
WARM_S = 360.0  # until caches of bounded size are full: memory of a life then stands still
MOST_RSS_PER_S = 2**20 / 600
MOST_FDS_PER_S = 1 / 600
NO_PAST = {"MATIERE_RESULT_DAYS": "1e-9", "MATIERE_GC_GRACE_HOURS": "0"}


def lives_of(seconds: float) -> int:
    """Return how often the service is ended within a run."""
    return max(LEAST_LIVES, round(seconds / LIFE_S))


def tree(folder: Path) -> tuple[int, int]:
    """Return files and bytes below a folder."""
    sizes = [path.stat().st_size for path in folder.rglob("*") if path.is_file()]
    return len(sizes), sum(sizes)


def slope(
    points: list[tuple[int, float, float]], warm_s: float, bin_s: float = 10.0
) -> dict[str, float]:
    """Fit value = height of its life + slope * seconds; return slope and its 99 % interval.

    Samples of a second are not independent: the interval is that of means over `bin_s`.
    """
    bins: dict[tuple[int, int], list[tuple[float, float]]] = {}
    for life, at, value in points:
        if at > warm_s:
            bins.setdefault((life, int(at // bin_s)), []).append((at, value))
    lives = sorted({life for life, _ in bins})
    rows = [(life, *np.mean(found, axis=0)) for (life, _), found in sorted(bins.items())]
    matrix = np.array([[at, *(float(life == one) for one in lives)] for life, at, _ in rows])
    values = np.array([value for _, _, value in rows])
    freedom = len(rows) - matrix.shape[1]
    if freedom < 2:
        raise SystemExit("too few samples for a slope: run longer")
    solution, *_ = np.linalg.lstsq(matrix, values, rcond=None)
    rest = values - matrix @ solution
    variance = float(rest @ rest) / freedom * np.linalg.inv(matrix.T @ matrix)[0, 0]
    half = float(stats.t.ppf(0.995, freedom)) * float(np.sqrt(variance))
    found = float(solution[0])
    return {"per_s": found, "low": found - half, "high": found + half, "bins": len(rows)}


class Soak:
    """The run: a service, what it was told, what was measured."""

    def __init__(self, data: Path, seed: int) -> None:
        self.data, self.random = data, random.Random(seed)
        self.scene = json.loads((ROOT / "examples" / "scenes" / "first.json").read_text())
        self.live: list[str] = []
        self.done: dict[str, int] = {}
        self.rss: list[tuple[int, float, float]] = []
        self.fds: list[tuple[int, float, float]] = []
        self.life, self.begun = 0, time.monotonic()
        self.service = self.start()

    def start(self) -> Service:
        """Begin a life of the service."""
        service = Service(self.data, children=2)
        self.process = psutil.Process(service.process.pid)
        self.http = httpx.Client(base_url=service.client.url, timeout=60, trust_env=False)
        self.life, self.begun = self.life + 1, time.monotonic()
        return service

    def end(self, kill: bool) -> None:
        """End a life: SIGKILL, or SIGTERM."""
        self.http.close()
        if kill:
            self.service.kill()
        else:
            self.service.stop()

    def sample(self) -> None:
        """Note memory and descriptors of the service."""
        at = time.monotonic() - self.begun
        self.rss.append((self.life, at, float(self.process.memory_info().rss)))
        self.fds.append((self.life, at, float(self.process.num_fds())))

    def film(self) -> dict[str, Any]:
        """Return a scene like no other."""
        edge = self.random.choice([16, 32, 48])
        render = {"spp": self.random.choice([4, 16, 64]), "seed": self.random.randrange(10**6)}
        return {**self.scene, "film": {"width": edge, "height": edge}, "render": render}

    def step(self) -> None:
        """Do one thing that users do."""
        kinds = {"job": 8, "sweep": 1, "cancel": 3, "pause": 1, "read": 6, "image": 2, "delete": 1,
                 "child": 0.2}  # fmt: skip
        what = self.random.choices(list(kinds), list(kinds.values()))[0]
        self.done[what] = self.done.get(what, 0) + 1
        if what == "child":
            kill_one_child(self.service, self.random.randrange(3))
        elif what == "job":
            answer = self.http.post("/v1/jobs", json={"scene": self.film()})
            self.live.append(f"/v1/jobs/{answer.raise_for_status().json()['id']}")
        elif what == "sweep":
            axes = [{"pointer": "/render/seed", "values": self.random.sample(range(10**6), 4)}]
            answer = self.http.post("/v1/sweeps", json={"base": self.film(), "axes": axes})
            self.live.append(f"/v1/sweeps/{answer.raise_for_status().json()['id']}")
        elif self.live:
            url = self.random.choice(self.live[-20:])
            if what in ("cancel", "pause"):
                self.http.post(f"{url}:{what}")
                if what == "pause":
                    self.http.post(f"{url}:resume")
            elif what == "delete":
                self.delete(url)
            elif what == "image":
                self.http.get(f"{url}/image.png")
            else:
                for path in (url, "/v1/jobs", "/v1/events?after=0", "/metrics", "/"):
                    self.http.get(path, headers={"Accept": "application/json"})

    def delete(self, url: str) -> None:
        """Delete a job or sweep, and sometimes send that twice."""
        for _ in range(self.random.choice([1, 1, 2])):
            answer = self.http.delete(url)
            assert answer.status_code == 204, (url, answer.text)
        self.live.remove(url)

    def run(self, seconds: float) -> None:
        """Live several lives, each ended by SIGKILL or SIGTERM."""
        lives = lives_of(seconds)
        for life in range(lives):
            until = self.begun + seconds / lives
            looked = 0.0
            while time.monotonic() < until:
                self.step()
                if time.monotonic() - looked > min(1.0, seconds / lives / 20):
                    looked = time.monotonic()
                    self.sample()
                time.sleep(0.1)
            self.end(kill=life % 2 == 0)
            print(f"life {self.life}: {self.done}", flush=True)
            self.service = self.start()


def remove_all(soak: Soak, before: tuple[int, int]) -> tuple[int, int]:
    """Delete all that is there, whatever it does; return files and bytes left, then collect."""
    listed = [f"/v1/jobs/{job.id}" for job in soak.service.client.jobs() if job.cell is None]
    assert set(listed) <= set(soak.live), "a job came back"
    for url in list(soak.live):
        soak.delete(url)
    folder, end = soak.data / "artifacts", time.monotonic() + 120
    while tree(folder) != before and time.monotonic() < end:
        time.sleep(0.5)
    left = tree(folder)
    soak.end(kill=False)
    command = [sys.executable, "-m", "matiere.service", "gc", "--data", str(soak.data), "--json"]
    done = subprocess.run(command, env=os.environ | NO_PAST, capture_output=True, text=True,
                          check=True)  # fmt: skip
    print("gc:", done.stdout, flush=True)
    return left


def measure(seconds: float, seed: int, data: Path) -> dict[str, Any]:
    """Run once."""
    shutil.rmtree(data, ignore_errors=True)
    service = Service(data, children=2)
    service.client.ready()
    service.stop()
    files = tree(data / "artifacts")
    store = (data / "store.sqlite").stat().st_size
    soak = Soak(data, seed)
    soak.run(seconds)
    peak = (data / "store.sqlite").stat().st_size
    deleted = remove_all(soak, files)
    life_s = seconds / lives_of(seconds)
    warm_s, bin_s = min(WARM_S, 0.6 * life_s), min(10.0, life_s / 20)
    after = (data / "store.sqlite").stat().st_size
    return {
        "seconds": seconds, "seed": seed, "lives": soak.life, "done": soak.done,
        "rss_bytes": slope(soak.rss, warm_s, bin_s), "fds": slope(soak.fds, warm_s, bin_s),
        "artifacts": {"before": files, "deleted": deleted, "after": tree(data / "artifacts")},
        "store_bytes": {"before": store, "peak": peak, "after": after},
    }  # fmt: skip


def verdict(result: dict[str, Any]) -> dict[str, bool]:
    """Judge each of what was wanted."""
    rss, fds, store = result["rss_bytes"], result["fds"], result["store_bytes"]
    files = result["artifacts"]
    return {
        "memory": rss["low"] <= 0 or rss["per_s"] < MOST_RSS_PER_S,
        "descriptors": fds["low"] <= 0 or fds["per_s"] < MOST_FDS_PER_S,
        "artifacts": files["before"] == files["deleted"] == files["after"],
        "store": store["after"] <= 1.1 * store["before"],
    }


def main() -> int:
    """Run, print and store."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=MINUTES)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    result = measure(60 * options.minutes, options.seed, OUT / "soak")
    result["good"] = verdict(result)
    (OUT / "soak.json").write_text(json.dumps(result, indent=1) + "\n")
    print(json.dumps(result, indent=1))
    good = all(result["good"].values())
    print("passed" if good else "FAILED")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
