"""Acceptance 5: one hash of the EXR's pixels for threads, children, kills and resumption

The same scene is rendered by mt.render with 1 and 2 threads, by jobs with 1x1, 1x2 and 2x1
processes x threads, and by a service killed with SIGKILL in mid-render and started again; there
chunks rendered after the restart must equal the chunks that were missing.
Results are stored in prove-out/bits.json.
"""

import json
import shutil
import sys
import time

from _service import OUT, Service, pixel_hash, sweep_request

import matiere as mt

SPP = 192
EDGE = 192


def by_job(name: str, children: int, threads: int, kill: bool = False) -> dict[str, object]:
    """Render the scene as a job; kill the service in the middle if asked to."""
    scene, _ = sweep_request(EDGE)
    data = OUT / "bits" / name
    service = Service(data, children, threads)
    job = service.client.submit(scene, stop={"spp": SPP}, idempotency_key="bits")
    facts: dict[str, object] = {}
    if kill:
        while service.client.job(job.id).progress < 0.4:
            time.sleep(0.05)
        service.kill()
        service = Service(data, children, threads)
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
    for children, threads in ((1, 1), (1, 2), (2, 1)):
        rows.append(by_job(f"job-{children}x{threads}", children, threads))
    rows.append(by_job("job-killed", 2, 1, kill=True))
    (OUT / "bits.json").write_text(json.dumps(rows, indent=1))
    for row in rows:
        print(f"{str(row['hash'])[:24]}...  {row['name']}", flush=True)
    last = rows[-1]
    print(f"killed: {last['chunks_missing']} chunks missing, {last['chunks_rendered']} rendered "
          f"after the restart, {last['chunks_in_film']} in the whole film")  # fmt: skip
    good = len({row["hash"] for row in rows}) == 1
    good &= last["chunks_missing"] == last["chunks_rendered"] != 0
    print("passed" if good else "FAILED")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
