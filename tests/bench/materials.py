"""Time of one evaluation and one sample of every picked material, and of building its tables.

Run: `python tests/bench/materials.py [rows]`. Machines are noisy: compare ratios to lambert.
"""

from __future__ import annotations

import sys
from pathlib import Path
from time import perf_counter

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "support"))
from material_cases import PICKED


def best(call: object, repeats: int = 5) -> float:
    """Return the shortest of a few timings [s]."""
    times = []
    for _ in range(repeats):
        start = perf_counter()
        call()  # type: ignore[operator]
        times.append(perf_counter() - start)
    return min(times)


def main(rows: int = 100_000) -> None:
    rng = np.random.default_rng(1)
    w = rng.normal(size=(2, rows, 3))
    w /= np.linalg.norm(w, axis=2, keepdims=True)
    wo, wi = np.abs(w[0]).astype(np.float32), np.abs(w[1]).astype(np.float32)
    u = rng.random((rows, 3), dtype=np.float32)
    print(f"{'build ms':>9} {'eval ns':>8} {'sample ns':>9}  material")
    for case in PICKED:
        build = best(case.bsdf, 3) * 1e3
        b = case.bsdf()
        evaluate = best(lambda b=b: b.pdf(wo, wi)) / rows * 1e9
        sample = best(lambda b=b: b.sample(wo, u)) / rows * 1e9
        print(f"{build:9.2f} {evaluate:8.1f} {sample:9.1f}  {case.id}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
