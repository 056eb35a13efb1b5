"""What does the queue cost? A sweep through the engine beside `mt.render` in a loop.

    python tests/bench/sweep_overhead.py --cells 64 --size 128 --spp 16 --runs 3

The shader ball under the studio light with another roughness in every cell; the loop keeps the
acceleration structure. Both use two threads; runs alternate, the median counts. Printed as well:
what is left of the time once the contact sheet is there, and (--memory N) how the memory of a
render child grows over N cells after the first 100.
"""

from __future__ import annotations

import argparse
import copy
import json
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import matiere as mt
from matiere.jobs import Engine, open_engine

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))
import demo_sweep

OUT = Path(__file__).parents[2] / "prove-out"


def base(size: int, spp: int, folder: Path) -> dict[str, Any]:
    """Return the demo's scene with a metal ball, its files in `folder`."""
    study = demo_sweep.own_study(folder, size, spp)
    scene: dict[str, Any] = copy.deepcopy(study.base)
    scene["materials"]["ball"] = {"type": "conductor", "metal": "Au", "alpha": 0.1}
    scene["film"] |= {"width": size, "height": size}
    scene["render"] = {"spp": spp, "seed": 1}
    return scene


def alphas(cells: int) -> list[float]:
    """Return a roughness for every cell."""
    return [0.05 + 0.85 * i / max(cells - 1, 1) for i in range(cells)]


def loop(scene: dict[str, Any], folder: Path, cells: int, first: float) -> float:
    """Render all cells one after the other on two threads; return the seconds."""
    begin, built = time.monotonic(), None
    for alpha in alphas(cells):
        document = copy.deepcopy(scene)
        document["materials"]["ball"]["alpha"] = alpha + first
        loaded = mt.load(document, asset_root=folder)
        loaded.build(2, like=built)
        mt.render(loaded, threads=2)
        built = loaded
    return time.monotonic() - begin


def sweep(engine: Engine, scene: dict[str, Any], cells: int, first: float) -> tuple[float, float]:
    """Return seconds until all cells have ended, and until the contact sheet is there."""
    values = [alpha + first for alpha in alphas(cells)]
    axis = {"pointer": "/materials/ball/alpha", "values": values}
    begin = time.monotonic()
    made = engine.submit_sweep(scene, [axis])
    while not made.done:
        time.sleep(0.05)
        made = engine.get_sweep(made.id)
    ended = time.monotonic() - begin
    engine.wait_sweep(made.id)
    return ended, time.monotonic() - begin


def child_memory(engine: Engine) -> float:
    """Return the resident memory of the render children, in KB."""
    pids = [c["pid"] for c in engine.status()["children"] if c["name"] != "utility" and c["pid"]]
    return sum(4.0 * int(Path(f"/proc/{pid}/statm").read_text().split()[1]) for pid in pids)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, default=64)
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--memory", type=int, default=0, metavar="N")
    args = parser.parse_args()
    data = Path(tempfile.mkdtemp(prefix="matiere-bench-"))
    try:
        with open_engine(data / "data", children=2, threads_per_child=1) as engine:
            print(json.dumps(measure(engine, args), indent=1))
    finally:
        shutil.rmtree(data)


def measure(engine: Engine, args: argparse.Namespace) -> dict[str, Any]:
    """Return the figures of all runs."""
    folder = engine.data_dir / "assets"
    scene = base(args.size, args.spp, folder)
    ratios, rows = [], []
    for run in range(args.runs):
        first = 1e-4 * run  # other films in every run
        alone = loop(scene, folder, args.cells, first)
        ended, drawn = sweep(engine, scene, args.cells, first)
        ratios.append(ended / alone)
        rows.append({"loop_s": alone, "ended_s": ended, "sheet_s": drawn})
        print(f"loop {alone:.2f} s, sweep {ended:.2f} s, with its sheet {drawn:.2f} s")
    found: dict[str, Any] = {"runs": rows, "median_ratio": statistics.median(ratios)}
    if args.memory:
        small = base(32, 4, folder)
        sweep(engine, small, 100, 0.0)
        before = child_memory(engine)
        sweep(engine, small, args.memory, 0.001)
        found["kb_per_cell"] = (child_memory(engine) - before) / args.memory
    return found


if __name__ == "__main__":
    main()
