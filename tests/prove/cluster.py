"""Acceptance 7 of the queue: two Ray nodes, the driver killed thrice and a node once: same bits

Everything runs in a network namespace with loopback alone. A film is rendered by mt.render, by a
service on two Ray nodes, and by one under kills: the driver three times, a node while it renders.
The hashes of the pixels must be equal, no job may fail, and no process be left. What the jobs of
tests/jobs/test_ray.py prove besides (refused nodes, an outage, poisoned films) is run there.
Results are stored in prove-out/ray.json.
"""

import json
import os
import shutil
import subprocess
import sys

from _service import OUT, ROOT, pixel_hash, sweep_request

import matiere as mt

EDGE, SPP = 128, 512
SCRIPT = ROOT / "tests" / "prove" / "_ray.py"


def main() -> int:
    """Render in three ways, compare, print; then run the tests of the cluster."""
    sys.path.insert(0, str(ROOT / "tests" / "support"))
    import ray_cluster

    if why := ray_cluster.why_not():
        print(f"not run: {why}")
        return 1
    folder = OUT / "ray"
    folder.mkdir(parents=True, exist_ok=True)
    scene, _ = sweep_request(EDGE)
    path = folder / "render.exr"
    mt.write_image(path, mt.render(mt.load(scene), spp=SPP, threads=2))
    rows: list[dict[str, object]] = [{"name": "mt.render", "hash": pixel_hash(path), "left": []}]
    for how in ("quiet", "killed"):
        shutil.rmtree(folder / how, ignore_errors=True)
        words = (str(folder / how), str(EDGE), str(SPP), how)
        facts = ray_cluster.run_inside(SCRIPT, *words, timeout_s=1200)
        rows.append({"name": f"ray, 2 nodes, {how}", **facts})
    (OUT / "ray.json").write_text(json.dumps(rows, indent=1))
    for row in rows:
        print(f"{str(row['hash'])[:24]}...  {row['name']}  {row.get('killed') or ''}", flush=True)
    good = len({row["hash"] for row in rows}) == 1 and not any(row["left"] for row in rows)
    tests = [sys.executable, "-m", "pytest", "-q", str(ROOT / "tests" / "jobs" / "test_ray.py")]
    proving = os.environ | {"PROVE_RAY": "1"}
    good &= subprocess.run(tests, cwd=ROOT, env=proving, check=False).returncode == 0
    print("passed" if good else "FAILED")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
