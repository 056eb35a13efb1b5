"""Load: wrk reads states over 32 connections while both cores render; submissions go on beside it

A real `matiere serve` renders one long job with two children (at nice 10). First the render
throughput is measured alone, then under load: for 60 s wrk asks for the job's state over 32
connections, and one client submits five jobs a second. Wanted: at least 300 reads a second, 99 % of
them within 100 ms, no error; 99 % of the submissions within 250 ms. The render throughput lost is
told. Results are stored in prove-out/load.json.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import shutil
import subprocess
import sys
import threading
import time
from typing import Any

import httpx
from _service import OUT, ROOT, Service

CONNECTIONS = 32
PACE_S = 0.2
READS, READ_MS, SUBMIT_MS = 300.0, 100.0, 250.0
UNITS = {"us": 1e-3, "ms": 1.0, "s": 1e3, "m": 6e4}


def samples(client: httpx.Client) -> tuple[float, float]:
    """Return the moment, and the samples of pixels rendered so far."""
    text = client.get("/metrics").text
    found = re.search(r"^matiere_pixel_samples_total (\S+)$", text, re.M)
    assert found, text
    return time.monotonic(), float(found[1])


def throughput(client: httpx.Client, seconds: float) -> float:
    """Return samples a second over some time."""
    before = samples(client)
    time.sleep(seconds)
    after = samples(client)
    return (after[1] - before[1]) / (after[0] - before[0])


def submit(url: str, scene: dict[str, Any], until: float, took: list[float]) -> None:
    """Submit a job every 200 ms; keep how long each answer took, in milliseconds; -1: an error."""
    with httpx.Client(base_url=url, timeout=30, trust_env=False) as client:
        number = 0
        while (begin := time.monotonic()) < until:
            number += 1
            body = {"scene": {**scene, "render": {"spp": 16, "seed": 10_000 + number}},
                    "priority": 0}  # fmt: skip
            answer = client.post("/v1/jobs", json=body)
            good = answer.status_code == 202
            took.append(1000 * (time.monotonic() - begin) if good else -1.0)
            time.sleep(max(0.0, begin + PACE_S - time.monotonic()))


def wrk(url: str, seconds: int) -> dict[str, float]:
    """Read `url` again and again; return reads a second, percentiles in ms, and errors."""
    command = ["wrk", "-t2", f"-c{CONNECTIONS}", f"-d{seconds}s", "--latency", url]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    print(said, flush=True)

    def ms(percent: str) -> float:
        found = re.search(rf"^\s*{percent}%\s+([\d.]+)(us|ms|s|m)$", said, re.M)
        assert found, said
        return float(found[1]) * UNITS[found[2]]

    rate = re.search(r"Requests/sec:\s+([\d.]+)", said)
    refused = re.search(r"Non-2xx or 3xx responses: (\d+)", said)
    socket = re.search(r"Socket errors: (.*)", said)
    broken = sum(map(int, re.findall(r"\d+", socket[1]))) if socket else 0
    assert rate, said
    return {"reads_per_s": float(rate[1]), "p50_ms": ms("50"), "p99_ms": ms("99"),
            "errors": broken + (int(refused[1]) if refused else 0)}  # fmt: skip


def percentile(values: list[float], share: float) -> float:
    """Return the smallest value that `share` of all do not exceed."""
    return sorted(values)[max(0, math.ceil(share * len(values)) - 1)]


def measure(seconds: int) -> dict[str, Any]:
    """Run once."""
    data = OUT / "load"
    shutil.rmtree(data, ignore_errors=True)
    scene = json.loads((ROOT / "examples" / "scenes" / "first.json").read_text())
    scene["film"] = {"width": 256, "height": 256}
    service = Service(data, children=2, threads=1)
    url = service.client.url
    with httpx.Client(base_url=url, timeout=30, trust_env=False) as client:
        body = {"scene": {**scene, "render": {"spp": 2**18}}, "priority": 100}
        job = client.post("/v1/jobs", json=body).json()["id"]
        while samples(client)[1] < 256 * 256 * 32:
            time.sleep(0.2)
        alone = throughput(client, max(5, seconds / 3))
        took: list[float] = []
        until = time.monotonic() + seconds
        writer = threading.Thread(target=submit, args=(url, scene, until, took))
        before = samples(client)
        writer.start()
        reads = wrk(f"{url}/v1/jobs/{job}", seconds)
        writer.join()
        after = samples(client)
        under = (after[1] - before[1]) / (after[0] - before[0])
        client.post(f"/v1/jobs/{job}:cancel")
    service.kill()
    result: dict[str, Any] = {"seconds": seconds, "connections": CONNECTIONS, "reads": reads}
    result["submissions"] = {
        "count": len(took),
        "errors": sum(one < 0 for one in took),
        "p50_ms": round(percentile(took, 0.5), 1),
        "p99_ms": round(percentile(took, 0.99), 1),
    }
    result["samples_per_s"] = {"alone": round(alone), "under_load": round(under)}
    result["throughput_lost_percent"] = round(100 * (1 - under / alone), 1)
    return result


def main() -> int:
    """Run, print and store."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=60, help="of load")
    result = measure(parser.parse_args().seconds)
    reads, submissions = result["reads"], result["submissions"]
    result["good"] = (
        reads["reads_per_s"] >= READS
        and reads["p99_ms"] < READ_MS
        and submissions["p99_ms"] < SUBMIT_MS
        and reads["errors"] == submissions["errors"] == 0
    )
    (OUT / "load.json").write_text(json.dumps(result, indent=1) + "\n")
    print(json.dumps(result, indent=1))
    print("passed" if result["good"] else "FAILED")
    return 0 if result["good"] else 1


if __name__ == "__main__":
    sys.exit(main())
