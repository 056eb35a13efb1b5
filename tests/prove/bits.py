"""Acceptance 5: one hash of the EXR's pixels for threads, children, kills and resumption

The same scene is rendered by mt.render with 1 and 2 threads, by jobs with 1x1, 1x2 and 2x1
processes x threads, and by a service killed with SIGKILL in mid-render and started again; there
chunks rendered after the restart must equal the chunks that were missing. All of it once more with
the job store on a PostgreSQL server of its own, where there is one to start, and on two Ray nodes,
where namespaces allow it.
Results are stored in prove-out/bits.json.
"""

import json
import shutil
import sys
import time
from collections.abc import Callable

from _service import OUT, ROOT, Service, pixel_hash, sweep_request

import matiere as mt

SPP = 192
EDGE = 192


def by_job(
    name: str, children: int, threads: int, kill: bool = False, url: str | None = None
) -> dict[str, object]:
    """Render the scene as a job; kill the service in the middle if asked to."""
    scene, _ = sweep_request(EDGE)
    data = OUT / "bits" / name
    service = Service(data, children, threads, url)
    job = service.client.submit(scene, stop={"spp": SPP}, idempotency_key="bits")
    facts: dict[str, object] = {}
    if kill:
        while service.client.job(job.id).progress < 0.4:
            time.sleep(0.05)
        service.kill()
        service = Service(data, children, threads, url)
        job = service.client.submit(scene, stop={"spp": SPP}, idempotency_key="bits")
    job = service.client.wait(job.id)
    if kill:
        status = service.status()
        facts["chunks_missing"] = status["resumed"]["chunks_missing"]
        facts["chunks_rendered"] = status["counters"]["chunks_rendered"]
        facts["chunks_in_film"] = service.client.report(job.id)["chunks_rendered"]
    path = service.client.fetch(job.id, "image.exr", data / "image.exr")
    service.stop()
    return {"name": name, "state": job.state, "hash": pixel_hash(path), **facts}


def stores() -> dict[str, Callable[[], str | None]]:
    """Return what gives a new database's URL, by kind of store."""
    sys.path.insert(0, str(ROOT / "tests" / "support"))
    import postgres_server

    if postgres_server.binaries() is None:
        print("no PostgreSQL to start here: only SQLite is compared")
        return {"sqlite": lambda: None}
    return {"sqlite": lambda: None, "postgresql": postgres_server.shared_server().database}


def on_ray() -> list[dict[str, object]]:
    """Render on two Ray nodes, where that can be done."""
    sys.path.insert(0, str(ROOT / "tests" / "support"))
    import ray_cluster

    if why := ray_cluster.why_not():
        print(f"no Ray: {why}")
        return []
    words = (str(OUT / "bits" / "ray"), str(EDGE), str(SPP), "quiet")
    script = ROOT / "tests" / "prove" / "_ray.py"
    facts = ray_cluster.run_inside(script, *words, timeout_s=600)
    return [{"name": "ray, 2 nodes", **facts}]


def main() -> int:
    """Render in every way, compare, print."""
    shutil.rmtree(OUT / "bits", ignore_errors=True)
    (OUT / "bits").mkdir(parents=True)
    scene, _ = sweep_request(EDGE)
    rows: list[dict[str, object]] = []
    for threads in (1, 2):
        path = OUT / "bits" / f"render-{threads}.exr"
        mt.write_image(path, mt.render(mt.load(scene), spp=SPP, threads=threads))
        rows.append({"name": f"mt.render, {threads} threads", "hash": pixel_hash(path)})
    killed = []
    for store, new_url in stores().items():
        for children, threads in ((1, 1), (1, 2), (2, 1)):
            name = f"{store}-{children}x{threads}"
            rows.append(by_job(name, children, threads, url=new_url()))
        killed.append(by_job(f"{store}-killed", 2, 1, kill=True, url=new_url()))
    rows += killed + on_ray()
    (OUT / "bits.json").write_text(json.dumps(rows, indent=1))
    for row in rows:
        print(f"{str(row['hash'])[:24]}...  {row['name']}", flush=True)
    good = len({row["hash"] for row in rows}) == 1
    for row in killed:
        print(f"{row['name']}: {row['chunks_missing']} chunks missing, {row['chunks_rendered']} "
              f"rendered after the restart, {row['chunks_in_film']} in the whole film")  # fmt: skip
        good &= row["chunks_missing"] == row["chunks_rendered"] != 0
    print("passed" if good else "FAILED")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
