"""T8: a sweep of 100,000 cells of 8 x 8 pixels and 16 spp, then again with one value changed

A real `matiere serve` on an empty store takes the sweep over HTTP; while it works, single jobs,
lists of cells, the sweep and the status are read all the time. Then the service ends and starts
again, and the same sweep is submitted with one of the 100 values of an axis changed: 99 % of the
cells are known. Judged: accepted within 2 s; all cells ended within 30 minutes; reads at the 99th
percentile within 150 ms; memory of the service below 500 MB; the store below 4 GB and 20,000
files; ready again within 5 s; the known cells ended within 60 s. At last both sweeps are deleted:
answered within a second, and jobs submitted while the rows go are accepted within 250 ms at the
99th percentile.
Results are stored in prove-out/cells.json; a finished run is kept and not repeated (--again does).
"""

import argparse
import itertools
import json
import os
import shutil
import sys
import threading
import time
from pathlib import Path
from typing import Any

import httpx
from _service import OUT, ROOT, Service
from pysqlite3 import dbapi2

SPP, EDGE, VALUES = 16, 8, 100
LIMITS = {
    "accepted_s": 2.0, "all_ended_s": 1800.0, "read_p99_ms": 150.0, "service_rss_mb": 500.0,
    "store_gb": 4.0, "files": 20_000, "ready_s": 5.0, "known_s": 60.0, "delete_s": 1.0,
    "submit_p99_ms": 250.0,
}  # fmt: skip


def request(cells: int, first: float) -> dict[str, Any]:
    """Return a grid of roughness and albedo; `first` is one of its 100 roughnesses."""
    base = json.loads((ROOT / "examples" / "scenes" / "first.json").read_text())
    base["film"] = {"width": EDGE, "height": EDGE}
    base["render"] = {"spp": SPP, "seed": 1}
    alphas = [first, *(0.1 + 0.8 * i / (VALUES - 1) for i in range(1, VALUES))]
    across = cells // VALUES
    return {
        "base": base,
        "axes": [
            {"pointer": "/materials/ball/alpha", "values": alphas, "label": "alpha"},
            {"pointer": "/materials/floor/albedo/1", "linspace": [0.05, 0.95, across],
             "label": "green"},
        ],
    }  # fmt: skip


class Reader(threading.Thread):
    """Reads the API as a page does, and takes the time of each answer and the service's memory."""

    def __init__(self, service: Service, sweep: str) -> None:
        super().__init__(daemon=True)
        self._client = httpx.Client(base_url=service.client.url, trust_env=False, timeout=30)
        self._pid, self._sweep = service.process.pid, sweep
        self.took: dict[str, list[float]] = {}
        self.errors = 0
        self.rss_mb = 0.0
        self.over = False

    def run(self) -> None:
        """Read until told to end."""
        jobs = self._client.get(f"/v1/jobs?sweep={self._sweep}&limit=1").json()["jobs"]
        paths = {
            "sweep": f"/v1/sweeps/{self._sweep}",
            "cells": f"/v1/jobs?sweep={self._sweep}&limit=100",
            "job": f"/v1/jobs/{jobs[0]['id']}",
            "status": "/v1/status",
            "ready": "/readyz",
        }
        while not self.over:
            for name, path in paths.items():
                begin = time.monotonic()
                answer = self._client.get(path)
                self.took.setdefault(name, []).append(1000.0 * (time.monotonic() - begin))
                self.errors += answer.status_code >= 400
                time.sleep(0.02)
            pages = int(Path(f"/proc/{self._pid}/statm").read_text().split()[1])
            self.rss_mb = max(self.rss_mb, pages * os.sysconf("SC_PAGE_SIZE") / 1e6)

    def report(self) -> dict[str, Any]:
        """Return percentiles by kind of request, in ms, and memory."""
        found: dict[str, Any] = {"errors": self.errors, "service_rss_mb": round(self.rss_mb, 1)}
        for name, took in self.took.items():
            took.sort()
            found[name] = {"reads": len(took), "p50_ms": round(took[len(took) // 2], 1),
                           "p99_ms": round(took[int(0.99 * len(took))], 1)}  # fmt: skip
        return found


def submit(service: Service, body: dict[str, Any]) -> tuple[str, float]:
    """Submit a sweep; return its id and how long the answer took."""
    begin = time.monotonic()
    answer = httpx.post(f"{service.client.url}/v1/sweeps", json=body, trust_env=False, timeout=60)
    took = time.monotonic() - begin
    assert answer.status_code == 202, answer.text
    return str(answer.json()["id"]), took


def counts(service: Service, sweep: str) -> dict[str, int]:
    """Return the cells of a sweep by state."""
    answer = httpx.get(f"{service.client.url}/v1/sweeps/{sweep}", trust_env=False, timeout=30)
    return dict(answer.raise_for_status().json()["counts"])


def watch(service: Service, sweep: str, cells: int, rendered: int) -> dict[str, Any]:
    """Wait for all cells; return when they had ended, and when all but `rendered` of them had."""
    begin = told = time.monotonic()
    known_s = None
    while True:
        now = counts(service, sweep)
        ended = now["succeeded"] + now["failed"]
        elapsed = time.monotonic() - begin
        if known_s is None and ended >= cells - rendered:
            known_s = elapsed
        if ended == cells:
            return {"ended_s": round(elapsed, 1), "known_s": known_s, "counts": now}
        if time.monotonic() - told > 10.0:
            told = time.monotonic()
            print(f"{elapsed:6.0f} s  {ended:,} of {cells:,} cells", flush=True)
        time.sleep(0.5)


def measure(cells: int, data: Path) -> dict[str, Any]:
    """Run both sweeps and return the figures."""
    service = Service(data)
    sweep, accepted_s = submit(service, request(cells, 0.1))
    reader = Reader(service, sweep)
    reader.start()
    first = watch(service, sweep, cells, 0)
    reader.over = True
    reader.join()
    files = [p.stat().st_size for p in data.rglob("*") if p.is_file()]
    found: dict[str, Any] = {"cells": cells, "accepted_s": round(accepted_s, 2), "first": first}
    found |= {"reads": reader.report(), "files": len(files), "store_gb": round(sum(files) / 1e9, 3)}
    service.stop()
    begin = time.monotonic()
    service = Service(data)
    while httpx.get(f"{service.client.url}/readyz", trust_env=False).status_code != 200:
        time.sleep(0.05)
    found["ready_s"] = round(time.monotonic() - begin, 2)
    rendered = service.status()["counters"].get("chunks_rendered", 0)
    again, again_s = submit(service, request(cells, 0.101))
    found["again"] = watch(service, again, cells, cells // VALUES) | {"accepted_s": again_s}
    after = service.status()["counters"].get("chunks_rendered", 0)
    found["again"]["chunks_rendered"] = after - rendered
    found["deletion"] = delete(service, [sweep, again], data)
    service.stop()
    return found


def delete(service: Service, sweeps: list[str], data: Path) -> dict[str, Any]:
    """Delete sweeps; submit jobs until all rows of theirs are gone; return what took how long."""
    scene = request(VALUES, 0.1)["base"]
    begin, answered, took = time.monotonic(), [], []
    with httpx.Client(base_url=service.client.url, trust_env=False, timeout=60) as client:
        for sweep in sweeps:
            at = time.monotonic()
            assert client.delete(f"/v1/sweeps/{sweep}").status_code == 204
            answered.append(time.monotonic() - at)
        store = dbapi2.connect(f"file:{data / 'store.sqlite'}?mode=ro", uri=True)
        for number in itertools.count():
            at = time.monotonic()
            body = {"scene": scene | {"render": {"spp": SPP, "seed": 1000 + number}}}
            assert client.post("/v1/jobs", json=body).status_code == 202
            took.append(1000.0 * (time.monotonic() - at))
            if store.execute("SELECT count(*) FROM sweep").fetchone()[0] == 0:
                break
            time.sleep(0.05)
        store.close()
    took.sort()
    return {"delete_s": round(max(answered), 2), "gone_s": round(time.monotonic() - begin, 1),
            "submissions": len(took), "submit_p50_ms": round(took[len(took) // 2], 1),
            "submit_p99_ms": round(took[int(0.99 * len(took))], 1)}  # fmt: skip


def judge(found: dict[str, Any]) -> list[str]:
    """Return what is beyond its limit."""
    figures = {
        "accepted_s": found["accepted_s"],
        "all_ended_s": found["first"]["ended_s"],
        "read_p99_ms": max(r["p99_ms"] for r in found["reads"].values() if isinstance(r, dict)),
        "service_rss_mb": found["reads"]["service_rss_mb"],
        "store_gb": found["store_gb"],
        "files": found["files"],
        "ready_s": found["ready_s"],
        "known_s": found["again"]["known_s"],
        "delete_s": found["deletion"]["delete_s"],
        "submit_p99_ms": found["deletion"]["submit_p99_ms"],
    }
    for name, value in figures.items():
        print(f"{name:16} {value:>10}   limit {LIMITS[name]}")
    bad = [name for name, value in figures.items() if value > LIMITS[name]]
    if found["first"]["counts"]["failed"] or found["again"]["counts"]["failed"]:
        bad.append("failed cells")
    if found["reads"]["errors"]:
        bad.append("errors of reads")
    return bad


def main() -> None:
    """Parse the command line, measure, judge, store."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, default=100_000, help="a multiple of 100")
    parser.add_argument("--again", action="store_true", help="repeat a finished run")
    options = parser.parse_args()
    result, data = OUT / "cells.json", OUT / "cells"
    if result.exists() and not options.again:
        found = json.loads(result.read_text())
    else:
        shutil.rmtree(data, ignore_errors=True)
        found = measure(options.cells, data)
        result.write_text(json.dumps(found, indent=1) + "\n")
        shutil.rmtree(data)
    bad = judge(found)
    print(json.dumps(found, indent=1))
    if bad:
        sys.exit(f"beyond the limit: {', '.join(bad)}")
    print("all within their limits")


if __name__ == "__main__":
    main()
