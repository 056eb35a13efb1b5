"""Acceptance 6 of issue 2: kill -9 of children and of the service in a 24-cell sweep loses nothing

A real `matiere serve` renders 4 roughnesses x 6 materials; children are killed, then the whole
service, twice; the client repeats its request with the same Idempotency-Key. Afterwards every cell
must have succeeded with exactly spp samples in every pixel, and the pixels of a quiet run.
Results are stored in prove-out/kills-sweep.json.
"""

import json
import shutil
import sys
import time

from _service import (
    EDGE,
    OUT,
    Service,
    cell_hashes,
    kill_one_child,
    sweep_request,
    wait_sweep,
)

SPP = 96
SERVICE_KILLS = 2
CELLS_A_LIFE = 7  # cells that have ended before the service is killed
CHILD_KILL_S = 1.5  # between kills of children


def main() -> int:
    """Run the killed and the quiet sweep, compare, print."""
    folder = OUT / "kills-sweep"
    shutil.rmtree(folder, ignore_errors=True)
    base, axes = sweep_request()
    request = {"stop": {"spp": SPP}, "label": "killed", "idempotency_key": "kills"}
    killed, resumed = [], []
    begin = time.monotonic()
    for life in range(SERVICE_KILLS):
        service = Service(folder / "killed")
        sweep = service.client.submit_sweep(base, axes, **request)
        before = 0
        while before < CELLS_A_LIFE * (life + 1):
            time.sleep(CHILD_KILL_S)
            killed.append(kill_one_child(service, len(killed)))
            before = service.client.sweep(sweep.id).counts["succeeded"]
        resumed.append(service.status()["resumed"] | {"cells_done": before})
        service.kill()
        print(
            f"life {life + 1}: {len(killed)} children killed so far, then the service "
            f"with {before} of 24 cells done",
            flush=True,
        )
    service = Service(folder / "killed")
    sweep = wait_sweep(service, service.client.submit_sweep(base, axes, **request).id)
    killed_s = time.monotonic() - begin
    status = service.status()
    spans = [
        service.client.report(job.id)["samples_per_pixel"]
        for job in service.client.jobs(sweep=sweep.id)
    ]
    hashes = cell_hashes(service, sweep.id, folder / "killed-exr")
    jobs = len(list(service.client.jobs()))
    service.stop()

    begin = time.monotonic()
    quiet = Service(folder / "quiet")
    reference = wait_sweep(quiet, quiet.client.submit_sweep(base, axes, stop={"spp": SPP}).id)
    quiet_s = time.monotonic() - begin
    expected = cell_hashes(quiet, reference.id, folder / "quiet-exr")
    quiet.stop()

    result = {
        "cells": sweep.cells,
        "counts": sweep.counts,
        "jobs_in_store": jobs,
        "spp": SPP,
        "samples_per_pixel": [min(a for a, _ in spans), max(b for _, b in spans)],
        "children_killed": len(killed),
        "service_kills": SERVICE_KILLS,
        "resumed_last": status["resumed"],
        "chunks_rendered_last": status["counters"]["chunks_rendered"],
        "equal_hashes": sum(a == b for a, b in zip(hashes, expected, strict=True)),
        "seconds_killed": round(killed_s, 1),
        "seconds_quiet": round(quiet_s, 1),
        "edge": EDGE,
    }
    (OUT / "kills-sweep.json").write_text(json.dumps(result, indent=1))
    print(json.dumps(result, indent=1))
    good = (
        sweep.counts["succeeded"] == sweep.cells == jobs == 24
        and result["samples_per_pixel"] == [SPP, SPP]
        and hashes == expected
    )
    print("passed" if good else "FAILED")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
