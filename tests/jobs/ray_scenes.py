"""What happens inside the namespace of `test_ray.py`: `ray_scenes.py NAME` prints facts as JSON."""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import ray_cluster
from conftest_jobs import FAKE, SCENE, report_of, wait_until
from ray_cluster import Cluster, pids

from matiere.jobs import Engine, open_engine

Facts = dict[str, Any]
HERE = Path(tempfile.gettempdir())
DRIVER, CHILD = "matiere.jobs.cluster.driver", "matiere.jobs.child"
LONG = SCENE | {"chunk_s": 0.08, "render": {"spp": 24}}


def opened(cluster: Cluster, name: str = "data", **more: Any) -> Engine:
    """Open an engine that renders on the cluster."""
    options = FAKE | {"executor": "ray", "ray_address": cluster.address} | more
    return open_engine(HERE / name, **options)


def ready(engine: Engine, nodes: int) -> None:
    """Wait until so many nodes can be used."""

    def enough() -> bool:
        return sum(n["state"] == "ready" for n in engine.status()["nodes"]) == nodes

    wait_until(enough, 60)


def claims(engine: Engine) -> int:
    """Return how many claims a living driver holds."""
    driver = engine.status()["children"][0]
    return int(driver["claims"]) if driver["pid"] in pids(DRIVER) else 0


def quiet(scene: Facts) -> str:
    """Return the sums of the same film rendered by a child of this machine."""
    with open_engine(HERE / "quiet", children=1, **FAKE) as engine:
        job = engine.wait_job(engine.submit_job(scene).id, 60)
        return str(report_of(engine, job.id)["sums"])


def attempts(engine: Engine) -> list[str]:
    """Return "state class" of every attempt that did not give a result."""
    import sqlalchemy as sa

    from matiere.jobs.store.tables import attempt

    rows = engine._db.read(
        lambda c: c.execute(
            sa.select(attempt.c.state, attempt.c.error_class).where(attempt.c.error_class != "")
        ).all()
    )
    return sorted({f"{state} {kind}" for state, kind in rows})


def kill_in_the_middle(engine: Engine, cluster: Cluster, job_id: str) -> list[str]:
    """Kill the driver three times while it holds work, then a node while a chunk runs there.

    Return the state of the job at every kill. Ray takes 15 s to say that a node is gone, in which
    the other may end the film: so that comes last.
    """
    states = []
    for number in range(4):
        wait_until(
            lambda n=number: engine.get_job(job_id).progress > 0.1 * n and claims(engine), 60
        )
        states.append(engine.get_job(job_id).state.value)
        if number == 3:
            ready(engine, 2)
            wait_until(lambda: claims(engine) >= 2 and len(pids(CHILD)) >= 2, 60)
            cluster.kill("raylet/raylet")
            wait_until(lambda: len(engine.status()["nodes"]) == 1, 60)
        else:
            kill_driver(engine, cluster)
    return states


def kill_driver(engine: Engine, cluster: Cluster) -> None:
    """Kill the driver and wait until the service has seen it."""
    lost = engine.status()["counters"].get("children_lost", 0)
    cluster.kill(DRIVER)
    wait_until(lambda: engine.status()["counters"].get("children_lost", 0) > lost)


def cells(engine: Engine) -> list[str]:
    """Return the sums of the cells of a sweep of small films, rendered whole."""
    axes = [{"pointer": "/value", "values": [1.0 + n for n in range(8)], "label": "v"}]
    base = {"width": 8, "height": 8, "value": 1.0, "render": {"spp": 8}}
    sweep = engine.wait_sweep(engine.submit_sweep(base, axes).id, 90)
    assert sweep.counts["succeeded"] == 8, sweep.counts
    jobs = sorted(engine.list_jobs(sweep_id=sweep.id), key=lambda job: job.cell or 0)
    return [str(report_of(engine, job.id)["sums"]) for job in jobs]


def kills(cluster: Cluster) -> Facts:
    """The acceptance with numpy chunks: kills, a poisoned film, a cancel, nothing left over."""
    facts: Facts = {"ports": ray_cluster.wildcard_ports(), "expected": quiet(LONG)}
    with open_engine(HERE / "quiet", children=1, **FAKE) as engine:
        facts["cells_expected"] = cells(engine)
    with opened(cluster) as engine:
        ready(engine, 2)
        job = engine.submit_job(LONG)
        facts["at_kills"] = kill_in_the_middle(engine, cluster, job.id)
        job = engine.wait_job(job.id, 90)
        facts |= {"state": job.state.value, "spp": job.spp, "report": report_of(engine, job.id)}
        facts |= {"kills": attempts(engine), "started": engine.status()["counters"]}
        facts["cells"] = cells(engine)
        bad = SCENE | {"value": 2.0, "misdeed": {"kind": "SIGSEGV", "chunk": 1}}
        error = engine.wait_job(engine.submit_job(bad).id, 60).error
        facts["poison"] = [error.code, error.message] if error else None
        slow = engine.submit_job(SCENE | {"value": 3.0, "chunk_s": 60.0})
        wait_until(lambda: claims(engine), 30)
        time.sleep(1.0)
        begin = time.monotonic()
        engine.cancel_job(slow.id)
        wait_until(lambda: claims(engine) == 0, 30)
        facts["cancel_s"] = time.monotonic() - begin
        facts["events"] = [[e.kind, e.data] for e in engine.events(0) if e.kind[:5] == "node_"]
    return facts


def refusals(cluster: Cluster) -> Facts:
    """Nodes that would render other bits, or do not see what must be shared."""
    facts: Facts = {}
    data = HERE / "data"
    (data / "assets").mkdir(parents=True)
    (data / "assets" / "a.txt").write_text("mesh")
    (HERE / "other").write_text("another mesh")
    with opened(cluster) as engine:
        ready(engine, 2)
        cluster.start_node(1, {"FAKE_ENGINE": "another"})
        empty = f"mount -t tmpfs none {data}"
        cluster.start_node(1, before=f"{empty}/assets")
        cluster.start_node(1, before=f"{empty}/artifacts")
        changed = f"mount --bind {HERE / 'other'} {data / 'assets' / 'a.txt'}"
        cluster.start_node(1, before=changed)
        wait_until(lambda: len(engine.status()["nodes"]) == 6, 30)
        ready(engine, 3)
        job = engine.submit_job(LONG | {"files": ["a.txt"]})
        job = engine.wait_job(job.id, 90)
        facts |= {"state": job.state.value, "error": str(job.error)}
        facts["attempts"] = attempts(engine)
        facts["reasons"] = [n["reason"] for n in engine.status()["nodes"]]
        facts["events"] = [e.data for e in engine.events(0) if e.kind == "node_refused"]
    return facts


def outage(cluster: Cluster) -> Facts:
    """Ray stops, hangs, is not there and comes back: work waits, and then goes on."""
    facts: Facts = {"expected": quiet(LONG)}
    with opened(cluster) as engine:
        ready(engine, 2)
        job = engine.submit_job(LONG)
        wait_until(lambda: engine.get_job(job.id).progress > 0.1, 60)
        os.kill(pids("gcs/gcs_server")[0], signal.SIGSTOP)  # hangs, and answers nobody
        wait_until(lambda: engine.status()["counters"].get("children_lost"), 90)
        ray_cluster._ray("stop", "--force")
        wait_until(lambda: "cannot join" in engine.status()["stuck"], 90)
        facts |= {"stuck": engine.status()["stuck"], "ready": engine.readiness().ready}
        facts["waiting"] = engine.get_job(job.id).state.value
        cluster.start_head(1)
        cluster.start_node(1)
        job = engine.wait_job(job.id, 120)
        facts |= {"state": job.state.value, "report": report_of(engine, job.id)}
        facts["kills"] = attempts(engine)
    return facts


def real(cluster: Cluster) -> Facts:
    """A film of the real engine under the same kills, and what mt.render makes of it."""
    import numpy as np

    import matiere as mt
    from matiere.imageio import read_image

    root = Path(__file__).resolve().parents[2]
    scene = json.loads((root / "examples" / "scenes" / "rough_metals.json").read_text())
    scene["film"], scene["output"] = {"width": 96, "height": 96}, {}
    mt.write_image(HERE / "plain.exr", mt.render(mt.load(scene), spp=256, threads=2))
    options = {"executor": "ray", "ray_address": cluster.address, "min_free_bytes": 0}
    with open_engine(HERE / "data", **options) as engine:
        ready(engine, 2)
        job = engine.submit_job(scene, stop={"spp": 256})
        states = kill_in_the_middle(engine, cluster, job.id)
        job = engine.wait_job(job.id, 200)
        path = engine.artifact(job.id, "image.exr").path
        facts: Facts = {"at_kills": states, "state": job.state.value, "kills": attempts(engine)}
    made, plain = (read_image(p).pixels for p in (path, HERE / "plain.exr"))
    return facts | {"equal": bool(np.array_equal(made, plain, equal_nan=True))}


def main() -> None:
    """Run a scene, stop Ray, and say what is left."""
    scenes: dict[str, Callable[[Cluster], Facts]] = {
        "kills": kills, "refusals": refusals, "outage": outage, "real": real,
    }  # fmt: skip
    cluster = Cluster()
    try:
        facts = scenes[sys.argv[1]](cluster)
    except BaseException:
        for log in (HERE / "data" / "logs").glob("ray.log"):
            print(log.read_text()[-4000:], file=sys.stderr)
        print(*ray_cluster.commands(), sep="\n", file=sys.stderr)
        raise
    end = time.monotonic() + 15  # Ray has to see that its driver is gone
    while (ours := [x for _, x in ray_cluster.commands() if "matiere.jobs" in x]) and (
        time.monotonic() < end
    ):
        time.sleep(0.1)
    facts["ours"] = ours
    facts["left"] = cluster.stop()
    facts["scratch"] = [path.name for path in HERE.glob("matiere-node-*")]
    print(json.dumps(facts), flush=True)


if __name__ == "__main__":
    main()
