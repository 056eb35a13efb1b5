"""Samples and rays per second on the Cornell box (depth 8) and the shader ball.

    python tests/bench/throughput.py --edge 256 --spp 32 --threads 2 --runs 3

Prints per scene the median over the runs: Msamples/s, Mrays/s (closest-hit and shadow rays),
relMSE, and the efficiency 1 / (relMSE x seconds). The pixels of all runs are the same.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tempfile
from pathlib import Path
from typing import Any

import matiere as mt

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "examples"))


def cornell(edge: int) -> mt.Scene:
    """Return the Cornell box of the examples at depth 8."""
    folder = ROOT / "examples" / "scenes"
    document = json.loads((folder / "cornell.json").read_text())
    document["film"] = {"width": edge, "height": edge}
    document["render"] = {"max_depth": 8}
    return mt.load(document, asset_root=folder)


def shader_ball(edge: int, folder: Path) -> mt.Scene:
    """Return the demo's shader ball in gold, alpha 0.12."""
    import demo_sweep

    study = demo_sweep.own_study(folder, edge, 64)
    base = dict(study.base)
    base["materials"] = {
        **base["materials"],
        "ball": {"type": "conductor", "metal": "Au", "alpha": 0.12},
    }
    return mt.load(base, asset_root=study.folder)


def measure(scene: mt.Scene, spp: int, threads: int) -> dict[str, float]:
    """Render once and return the rates."""
    film = mt.render(scene, spp=spp, threads=threads)
    last = film.report["log"][-1]
    samples = film.spp * film.width * film.height
    seconds = float(film.report["wall_s"])
    relmse = float(film.report["error"]["relmse"])
    return {
        "seconds": seconds,
        "msamples_s": samples / seconds / 1e6,
        "mrays_s": last["rays"] / seconds / 1e6,
        "relmse": relmse,
        "efficiency": 1 / (relmse * seconds),
    }


def main() -> None:
    """Measure both scenes and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--edge", type=int, default=256)
    parser.add_argument("--spp", type=int, default=32)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--runs", type=int, default=3)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        scenes: dict[str, Any] = {
            "cornell, depth 8": cornell(options.edge),
            "shader ball": shader_ball(options.edge, Path(folder)),
        }
        print(f"{options.edge} x {options.edge}, {options.spp} spp, {options.threads} threads")
        print("| scene | Msamples/s | Mrays/s | seconds | relMSE | 1/(relMSE s) |")
        print("|---|---|---|---|---|---|")
        for name, scene in scenes.items():
            runs = [measure(scene, options.spp, options.threads) for _ in range(options.runs)]
            m = {key: statistics.median(run[key] for run in runs) for key in runs[0]}
            print(
                f"| {name} | {m['msamples_s']:.2f} | {m['mrays_s']:.2f} | {m['seconds']:.2f} |"
                f" {m['relmse']:.3g} | {m['efficiency']:.1f} |"
            )


if __name__ == "__main__":
    main()
