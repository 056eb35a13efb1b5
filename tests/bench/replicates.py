"""What do replicates cost? Realised error for R = 2, 4, 8 beside one unsplit sample set (R = 1).

    python tests/bench/replicates.py --size 48 --seeds 6

For every scene and spp: mean realised relMSE over the seeds against a long reference, and the ratio
to the unsplit set. The table in docs/error.md comes from this; the default R is chosen by it.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
from pathlib import Path
from typing import Any

import matiere as mt

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
from film_scenes import scenes

REFERENCE_SEED = 987_654_321
COUNTS = (1, 2, 4, 8)
SPP = (16, 64, 256)


def realised(
    scene: mt.Scene, reference: mt.Film, spp: int, replicates: int, seeds: int, threads: int
) -> list[float]:
    """Return the realised relMSE of every seed."""
    return [
        mt.render(
            scene, spp=spp, seed=seed, replicates=replicates, threads=threads
        ).realised_relmse(reference)
        for seed in range(seeds)
    ]


def cell(values: list[float], unsplit: list[float]) -> str:
    """Return `error (ratio to unsplit)`, the ratio with its standard error."""
    mean, base = statistics.fmean(values), statistics.fmean(unsplit)
    if values is unsplit:
        return f"{mean:.3g}"
    spread = math.hypot(*(statistics.stdev(v) / statistics.fmean(v) for v in (values, unsplit)))
    ratio = mean / base
    return f"{mean:.3g} ({ratio:.2f} ± {ratio * spread / math.sqrt(len(values)):.2f})"


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--size", type=int, default=48)
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--reference-spp", type=int, default=8192)
    parser.add_argument("--out", type=Path, default=None)
    args = parser.parse_args()
    print("| scene | spp | R = 1 (unsplit) | R = 2 | R = 4 | R = 8 |")
    print("|---|---|---|---|---|---|", flush=True)
    kept: list[dict[str, Any]] = []
    for name, document in scenes(args.size).items():
        scene = mt.load(document)
        reference = mt.render(
            scene, spp=args.reference_spp, seed=REFERENCE_SEED, replicates=4, threads=args.threads
        )
        for spp in SPP:
            found = {
                r: realised(scene, reference, spp, r, args.seeds, args.threads) for r in COUNTS
            }
            cells = " | ".join(cell(found[r], found[1]) for r in COUNTS)
            print(f"| {name} | {spp} | {cells} |", flush=True)
            kept.append({"scene": name, "spp": spp, "relmse": found})
            if args.out is not None:
                args.out.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
