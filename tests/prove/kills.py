"""T1: 500 jobs with 500 seeds, a child killed every second, the service every five, lose nothing

A real `matiere serve` on an empty store; a client submits 500 jobs, each with its own seed (so
that no film is shared) and Idempotency-Key, and repeats what was not answered. Meanwhile a random
child is killed with SIGKILL every second and the service every five; it is started again at once.
The same 500 jobs are rendered in quiet on a second empty store. Afterwards: every job has succeeded
once, with exactly spp samples in every pixel and the pixels of the quiet run; rows, files and
SQLite's integrity check are clean; no process is left; the killed run took at most three times as
long.
Results are stored in prove-out/kills.json; a finished run is kept and not repeated (--again does).
"""

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import sys
import threading
import time
from collections import Counter
from pathlib import Path

from _service import OUT, Service, pixel_hash

from matiere.errors import MatiereError
from matiere.jobs.artifacts import ArtifactFolder
from matiere.jobs.store.audit import audit, audit_files
from matiere.jobs.store.database import Database

EDGE, SPP = 64, 8
CHILD_S, SERVICE_S = 1.0, 5.0
RATIO = 3.0


def scene(seed: int) -> dict[str, object]:
    """Return a metal ball in a lit box, with its own seed."""
    root = Path(__file__).resolve().parents[2]
    document: dict[str, object] = json.loads(
        (root / "examples" / "scenes" / "rough_metals.json").read_text()
    )
    document["film"] = {"width": EDGE, "height": EDGE}
    document["render"] = {"spp": SPP, "seed": seed}
    return document


class Killer(threading.Thread):
    """Kills children and the service, and starts the service again, until told to end."""

    def __init__(self, data: Path) -> None:
        super().__init__(daemon=True)
        self.data, self.chance = data, random.Random(1)
        self.service = Service(data)
        self.kills: Counter[str] = Counter()
        self.over = False

    def run(self) -> None:
        """Take turns: a child a second, every fifth time the service."""
        last = time.monotonic()
        while not self.over:
            time.sleep(CHILD_S)
            if time.monotonic() - last > SERVICE_S:
                self.service.kill()
                self.kills["service"] += 1
                self.service = Service(self.data)
                last = time.monotonic()
                continue
            with contextlib.suppress(Exception):
                pids = [c["pid"] for c in self.service.status()["children"] if c["pid"]]
                if pids:
                    os.kill(self.chance.choice(pids), signal.SIGKILL)
                    self.kills["child"] += 1


def repeat(action, killer=None):  # type: ignore[no-untyped-def]
    """Do what a client does whose service may die at any moment: ask again."""
    end = time.monotonic() + 600
    while True:
        try:
            return action()
        except (MatiereError, OSError, RuntimeError) as error:
            if time.monotonic() > end:
                raise SystemExit(f"gave up: {error}") from error
            time.sleep(0.2)


def submit_and_wait(count: int, client) -> tuple[list[str], float]:  # type: ignore[no-untyped-def]
    """Submit all jobs and wait for all; return their ids and the seconds."""
    begin = time.monotonic()
    ids = []
    for seed in range(count):
        key = f"job-{seed}"
        document = scene(seed)
        job = repeat(lambda d=document, k=key: client().submit(d, idempotency_key=k))
        ids.append(job.id)
    left = set(ids)
    while left:
        ended = repeat(lambda: {j.id for j in client().jobs() if j.ended})
        left -= ended
        if left:
            time.sleep(0.5)
    return ids, time.monotonic() - begin


def results(service: Service, ids: list[str], folder: Path) -> tuple[list[str], list[list[int]]]:
    """Return pixel hashes and the span of samples per pixel of every job."""
    hashes, spans = [], []
    for job_id in ids:
        path = service.client.fetch(job_id, "image.exr", folder / "image.exr")
        hashes.append(pixel_hash(path))
        spans.append(service.client.report(job_id)["samples_per_pixel"])
    return hashes, spans


def inspect(data: Path) -> tuple[list[str], dict[str, int]]:
    """Return what is wrong with a store that nobody uses, and its attempts by state."""
    from sqlalchemy import text

    base = Database(data / "store.sqlite")
    folder = ArtifactFolder(data / "artifacts")
    wrong = base.read(lambda c: audit(c) + audit_files(c, folder))
    check = base.read(lambda c: c.execute(text("PRAGMA integrity_check")).scalars().all())
    rows = text("SELECT state, COUNT(*) FROM attempt GROUP BY state")
    states = dict(base.read(lambda c: [tuple(r) for r in c.execute(rows)]))
    base.close()
    return wrong + [line for line in check if line != "ok"], states


def orphans(data: Path) -> list[int]:
    """Return processes that still work for a data directory."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            if str(data).encode() in entry.read_bytes() and int(entry.parent.name) != os.getpid():
                found.append(int(entry.parent.name))
    return found


def killed_run(data: Path, count: int) -> dict[str, object]:
    """Render while everything is being killed."""
    killer = Killer(data)
    killer.start()
    ids, seconds = submit_and_wait(count, lambda: killer.service.client)
    killer.over = True
    killer.join()
    jobs = list(killer.service.client.jobs())
    hashes, spans = results(killer.service, ids, data)
    killer.service.stop()
    time.sleep(1.0)
    wrong, states = inspect(data)
    return {"seconds": seconds, "kills": dict(killer.kills), "hashes": hashes, "spans": spans,
            "jobs": len(jobs), "states": dict(Counter(j.state for j in jobs)), "wrong": wrong,
            "attempts": states, "orphans": orphans(data)}  # fmt: skip


def quiet_run(data: Path, count: int) -> dict[str, object]:
    """Render in quiet."""
    service = Service(data)
    ids, seconds = submit_and_wait(count, lambda: service.client)
    hashes, spans = results(service, ids, data)
    service.stop()
    return {"seconds": seconds, "hashes": hashes, "spans": spans}


def main() -> int:
    """Run what is not there yet, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=500)
    parser.add_argument("--again", action="store_true", help="forget earlier runs")
    options = parser.parse_args()
    folder = OUT / "kills"
    if options.again:
        shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True, exist_ok=True)
    found = {}
    for name, run in (("quiet", quiet_run), ("killed", killed_run)):
        note = folder / f"{name}-{options.jobs}.json"
        if not note.exists():
            shutil.rmtree(folder / name, ignore_errors=True)
            note.write_text(json.dumps(run(folder / name, options.jobs)))
        found[name] = json.loads(note.read_text())
        print(f"{name}: {found[name]['seconds']:.0f} s", flush=True)
    killed, quiet = found["killed"], found["quiet"]
    result = {
        "jobs": options.jobs,
        "jobs_in_store": killed["jobs"],
        "states": killed["states"],
        "equal_hashes": sum(a == b for a, b in zip(killed["hashes"], quiet["hashes"], strict=True)),
        "different_hashes_between_jobs": len(set(killed["hashes"])),
        "pixels_with_other_than_spp": sum(span != [SPP, SPP] for span in killed["spans"]),
        "kills": killed["kills"],
        "attempts": killed["attempts"],
        "audit": killed["wrong"],
        "orphans": killed["orphans"],
        "seconds_killed": round(killed["seconds"], 1),
        "seconds_quiet": round(quiet["seconds"], 1),
        "ratio": round(killed["seconds"] / quiet["seconds"], 2),
    }
    (OUT / "kills.json").write_text(json.dumps(result, indent=1))
    print(json.dumps(result, indent=1))
    good = (
        killed["jobs"] == options.jobs == killed["states"].get("succeeded")
        and killed["hashes"] == quiet["hashes"]
        and result["pixels_with_other_than_spp"] == 0
        and not killed["wrong"]
        and not killed["orphans"]
        and result["ratio"] <= RATIO
    )
    print("passed" if good else "FAILED")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
