"""T2 to T6: fences, bits in any order, crash points, native faults, 2,000 runs of a state machine

Runs the slow versions of tests/jobs (test_faults, test_crash_points, test_shuffle), measures how
fast a cancel is obeyed by a real render (while rows are rendered, while Embree builds, while a file
is read), then the state machine of tests/jobs/queue_machine.py in slices of 100 runs with a seed
each.
Every part is stored in prove-out/faults.json as soon as it is done, and a second call goes on after
the last (--again begins anew).
"""

import argparse
import json
import statistics
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from _service import OUT, ROOT

from matiere.jobs import Engine

JOBS = ROOT / "tests" / "jobs"
RUNS, SLICE = 2000, 100
SUITES = ("test_faults.py", "test_crash_points.py", "test_shuffle.py")
CANCEL_MS = 100.0

MACHINE = """
import sys
from hypothesis import HealthCheck, seed, settings
from hypothesis.stateful import run_state_machine_as_test
from queue_machine import QueueMachine
run_state_machine_as_test(seed({number})(QueueMachine), settings=settings(
    max_examples={runs}, stateful_step_count=40, deadline=None, database=None,
    suppress_health_check=list(HealthCheck)))
"""


def suite(name: str) -> dict[str, object]:
    """Run one file of tests with its slow ones."""
    begin = time.monotonic()
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(JOBS / name)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    print(done.stdout[-2000:], flush=True)
    last = done.stdout.strip().splitlines()[-1] if done.stdout.strip() else done.stderr[-300:]
    return {"good": done.returncode == 0, "said": last, "seconds": time.monotonic() - begin}


def machine(number: int) -> dict[str, object]:
    """Make one slice of runs of the state machine."""
    begin = time.monotonic()
    program = MACHINE.format(number=number, runs=SLICE)
    done = subprocess.run([sys.executable, "-c", program], cwd=JOBS, capture_output=True, text=True)
    if done.returncode:
        print(done.stderr[-4000:], flush=True)
    good = done.returncode == 0
    return {"good": good, "runs": SLICE, "seconds": time.monotonic() - begin}


def bumpy_mesh(path: Path, edge: int = 700) -> None:
    """Write a mesh of a million triangles as PLY."""
    x, y = np.meshgrid(*(2 * [np.linspace(-1, 1, edge + 1, dtype=np.float32)]))
    positions = np.stack([x, y, 0.05 * np.sin(40 * x) * np.cos(37 * y)], -1).reshape(-1, 3)
    i = np.arange(edge * (edge + 1)).reshape(edge, edge + 1)[:, :-1].ravel()
    right, up = i + 1, i + edge + 2
    corners = np.concatenate([np.stack([i, right, up], 1), np.stack([i, up, up - 1], 1)])
    faces = np.empty(len(corners), dtype=[("n", "u1"), ("v", "<i4", 3)])
    faces["n"], faces["v"] = 3, corners
    head = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(positions)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(head.encode() + positions.astype("<f4").tobytes() + faces.tobytes())


def phases(engine: Engine) -> list[str]:
    """Return what the oldest claims of the children are at."""
    children = [slot.child for slot in engine._scheduler.slots if slot.child is not None]
    return [held.phase for child in children for held in list(child.inflight.values())[:1]]


def cancels() -> dict[str, object]:
    """Measure, on an engine with one real child, how long after a cancel the child is free."""
    from matiere.jobs import open_engine

    data = OUT / "faults-data"
    scene = json.loads((ROOT / "examples" / "scenes" / "first.json").read_text())
    scene["film"] = {"width": 256, "height": 256}
    (data / "assets").mkdir(parents=True, exist_ok=True)
    bumpy_mesh(data / "assets" / "bumpy.ply")
    material = next(iter(scene["materials"]))
    heavy = {**scene, "shapes": [*scene["shapes"],
             {"type": "mesh", "file": "bumpy.ply", "material": material}]}  # fmt: skip
    found: dict[str, list[float]] = {"render": [], "build": [], "read": []}
    with open_engine(data, children=1) as engine:
        while not engine.readiness().ready:
            time.sleep(0.1)
        for n in range(8):
            for name, document, phase, pause in (
                ("render", scene, "working", 0.5),
                ("build", heavy, "working", 0.03 * n),
                ("read", heavy, "reading", 0.03 * n),
            ):
                job = engine.submit_job(
                    {**document, "render": {"spp": 2**16, "seed": 1000 + n}}, stop={"spp": 2**16}
                )
                while phase not in phases(engine):
                    time.sleep(0.002)
                time.sleep(pause)
                begin = time.monotonic()
                engine.cancel_job(job.id)
                while any(c["claims"] for c in engine.status()["children"]):
                    time.sleep(0.002)
                found[name].append(1000 * (time.monotonic() - begin))
        counters = engine.status()["counters"]
    result: dict[str, object] = {"killed_while_reading": counters.get("children_lost", 0)}
    for name, times in found.items():
        result[name] = {"median_ms": statistics.median(times), "worst_ms": max(times)}
    medians = [statistics.median(times) for times in found.values()]
    return {"good": max(medians) < CANCEL_MS, **result}


def main() -> int:
    """Do every part that is not stored yet; tell all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--again", action="store_true", help="forget earlier runs")
    options = parser.parse_args()
    note = OUT / "faults.json"
    if options.again:
        note.unlink(missing_ok=True)
    parts: dict[str, dict[str, object]] = json.loads(note.read_text()) if note.exists() else {}
    todo = {name: (lambda n=name: suite(n)) for name in SUITES}
    todo["cancels"] = cancels
    todo |= {f"machine {n}": (lambda n=n: machine(n)) for n in range(RUNS // SLICE)}
    for name, action in todo.items():
        if not parts.get(name, {}).get("good"):
            parts[name] = action()
            note.write_text(json.dumps(parts, indent=1))
        print(f"{name}: {json.dumps(parts[name])}", flush=True)
    runs = sum(int(str(part.get("runs", 0))) for part in parts.values() if part["good"])
    good = all(part["good"] for part in parts.values())
    print(f"{runs} runs of the state machine; {'passed' if good else 'FAILED'}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
