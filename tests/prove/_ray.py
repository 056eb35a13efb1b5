"""Inside the namespace of `ray.py`: the service on two Ray nodes, quiet or with kills; tells JSON.

usage: _ray.py FOLDER EDGE SPP quiet|killed
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import ray_cluster
from _service import Service, pixel_hash, sweep_request

DRIVER, CHILD = "matiere.jobs.cluster.driver", "matiere.jobs.child"


def until(condition: Callable[[], Any]) -> None:
    """Wait until a condition holds, for two minutes at most."""
    end = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.05)


def usable(service: Service) -> int:
    """Return how many nodes can be used."""
    return sum(node["state"] == "ready" for node in service.status()["nodes"])


def at_work(service: Service) -> bool:
    """Tell whether a living driver holds claims and both nodes have a render child."""
    driver = service.status()["children"][0]
    return driver["claims"] > 1 and driver["pid"] in ray_cluster.pids(DRIVER)


def kills(service: Service, cluster: ray_cluster.Cluster, job_id: str) -> list[str]:
    """Kill the driver three times and a node once, each while chunks are rendered."""
    done = []
    for number, what in enumerate(("driver", "driver", "node", "driver")):
        until(lambda n=number: service.client.job(job_id).progress > 0.15 * n)
        if what == "node":
            until(lambda: usable(service) == 2)
        until(lambda: at_work(service))
        progress = service.client.job(job_id).progress
        cluster.kill(DRIVER if what == "driver" else "raylet/raylet")
        done.append(f"{what} at {100 * progress:.0f} %")
        until(lambda: not at_work(service) or usable(service) < 2)
        assert service.client.job(job_id).state == "running", "killed too late"
    return done


def main() -> None:
    """Render one film; say what was killed, what came out and what is left."""
    folder, edge, spp = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    cluster = ray_cluster.Cluster()
    service = Service(folder, None, 1, options={"executor": "ray", "ray_address": cluster.address})
    until(lambda: usable(service) == 2)
    begin = time.monotonic()
    job = service.client.submit(sweep_request(edge)[0], stop={"spp": spp})
    facts: dict[str, Any] = {"killed": []}
    if sys.argv[4] == "killed":
        facts["killed"] = kills(service, cluster, job.id)
    job = service.client.wait(job.id)
    facts |= {"state": job.state, "seconds": round(time.monotonic() - begin, 1)}
    facts["hash"] = pixel_hash(service.client.fetch(job.id, "image.exr", folder / "image.exr"))
    facts["counters"] = service.status()["counters"]
    service.stop()
    facts["left"] = cluster.stop()
    print(json.dumps(facts), flush=True)


if __name__ == "__main__":
    main()
