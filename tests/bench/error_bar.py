"""Is the error bar honest? Realised relMSE against the printed 95 % prediction interval.

    python tests/bench/error_bar.py --seeds 20 --spp 64 --size 64

Every scene is rendered with many seeds and compared with one reference of 64 times the samples and
another seed; weights are the reference's, its own estimated error is taken off. Prints one line per
scene: runs inside, below and above the interval, median upper/lower, and mean estimate over mean
realised error. Results are kept as JSON with --out.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from pathlib import Path
from typing import Any

import matiere as mt

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
from film_scenes import scenes

REFERENCE_SEED = 987_654_321


def measure(
    document: dict[str, Any], seeds: int, spp: int, replicates: int | None, threads: int
) -> dict[str, Any]:
    """Return counts and ratios for one scene."""
    scene = mt.load(document)
    reference = mt.render(
        scene, spp=64 * spp, seed=REFERENCE_SEED, replicates=replicates, threads=threads
    )
    rows = []
    for seed in range(seeds):
        film = mt.render(scene, spp=spp, seed=seed, replicates=replicates, threads=threads)
        rows.append({**film.error, "realised": film.realised_relmse(reference)})
    return {
        "runs": seeds,
        "inside": sum(r["lower"] <= r["realised"] <= r["upper"] for r in rows),
        "below": sum(r["realised"] < r["lower"] for r in rows),
        "above": sum(r["realised"] > r["upper"] for r in rows),
        "ratio": statistics.median(r["upper"] / r["lower"] for r in rows),
        "estimate": statistics.fmean(r["relmse"] for r in rows),
        "realised": statistics.fmean(r["realised"] for r in rows),
        "unknown_share": statistics.fmean(r["unknown_share"] for r in rows),
        "reference_relmse": reference.error["relmse"],
        "rows": rows,
    }


def line(name: str, m: dict[str, Any]) -> str:
    """Return one line of the table."""
    return (
        f"| {name} | {m['inside']}/{m['runs']} | {m['below']} | {m['above']} | {m['ratio']:.2f} | "
        f"{m['estimate']:.3g} | {m['realised']:.3g} | {m['estimate'] / m['realised']:.3f} | "
        f"{100 * m['unknown_share']:.1f} % |"
    )


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--replicates", type=int, default=None)
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--scenes", default="diffuse,metal,glass")
    parser.add_argument("--out", type=Path, default=None)
    args = parser.parse_args()
    found = scenes(args.size)
    results: dict[str, Any] = {}
    print(
        "| scene | inside | below | above | upper/lower | estimate | realised | ratio | unknown |"
    )
    print("|---|---|---|---|---|---|---|---|---|", flush=True)
    for name in args.scenes.split(","):
        results[name] = measure(found[name], args.seeds, args.spp, args.replicates, args.threads)
        print(line(name, results[name]), flush=True)
        if args.out is not None:
            args.out.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
