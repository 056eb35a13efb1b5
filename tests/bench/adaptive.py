"""What adaptive sampling gains: relMSE x seconds of uniform over that of adaptive films.

    ./dev bench adaptive

Both are rendered in turn with the same seeds and spp, and compared with one uniform reference of
many more samples and another seed, whose own error is taken off. Seconds are CPU seconds. A gain
of 2 is half the time to the same error. The second table is the bias of stopping at a target_error:
the mean of many stopped films of an integrand of known mean, relative to that mean and to the root
of the target.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
from pathlib import Path
from typing import Any

import numpy as np

import matiere as mt

sys.path.insert(0, str(Path(__file__).parents[1] / "support"))
from film_scenes import scenes

REFERENCE_SEED = 987_654_321


def spotlit(size: int) -> dict[str, Any]:
    """A glossy ball and its shadow in a corner of a large plain sky: most pixels are easy."""
    document = scenes(size)["metal"]
    camera = {**document["camera"], "vfov_deg": 75, "target": [1.5, 2.2, 0]}
    return {**document, "camera": camera}


def gain(document: dict[str, Any], spp: int, seeds: int, factor: int) -> dict[str, Any]:
    """Return mean realised relMSE and CPU seconds of both, and the ratio of their products."""
    scene = mt.load(document)
    reference = mt.render(scene, spp=factor * spp, seed=REFERENCE_SEED)
    found: dict[bool, list[tuple[float, float]]] = {False: [], True: []}
    for seed in range(seeds):
        for adaptive in (False, True):
            film = mt.render(scene, spp=spp, seed=seed, adaptive=adaptive)
            cost = film.core.counters["cpu_s"]
            found[adaptive].append((film.realised_relmse(reference), cost))
    error, cpu = ([np.array(found[a])[:, i] for a in (False, True)] for i in (0, 1))
    ratio = error[0].mean() / error[1].mean()
    spread = math.hypot(*(e.std(ddof=1) / e.mean() / math.sqrt(seeds) for e in error))
    slower = statistics.median(cpu[1] / cpu[0])
    return {
        "spp": spp, "seeds": seeds, "uniform": error[0].mean(), "adaptive": error[1].mean(),
        "time": slower, "gain": ratio / slower, "gain_error": ratio / slower * spread,
    }  # fmt: skip


STOPS = (("gaussian", 0.5, 0.01), ("lognormal", 2.0, 0.05), ("rare", 5.0, 0.1))
EDGE = 32  # pixels of the films of the second table


def stopping(kind: str, spread: float, target: float, runs: int, adaptive: bool) -> dict[str, Any]:
    """Return the bias of the image mean of renders of an integrand that end at a target_error."""
    from matiere import _core

    y, x = np.mgrid[0:EDGE, 0:EDGE]
    truth, means, ended = np.asarray(_core.synthetic_mean(x, y)), [], []
    for seed in range(runs):
        film = _core.Film(EDGE, EDGE, 4, adaptive)
        stop = {"target_error": {"relmse": target}}
        _core.render_synthetic(film, kind, stop, spread, seed)
        means.append(float((film.mean()[..., 0] / truth).mean()) - 1.0)
        ended.append(film.spp)
    bias, error = statistics.fmean(means), statistics.stdev(means) / math.sqrt(runs)
    return {
        "target": target, "runs": runs, "adaptive": adaptive, "spp": [min(ended), max(ended)],
        "bias": bias, "bias_error": error, "share": bias / math.sqrt(target),
    }  # fmt: skip


def gain_row(name: str, m: dict[str, Any]) -> str:
    """Return one line of the first table."""
    return (
        f"| {name} | {m['spp']} | {m['uniform']:.3g} | {m['adaptive']:.3g} | {m['time']:.2f} | "
        f"{m['gain']:.2f} ± {m['gain_error']:.2f} |"
    )


def stop_row(name: str, m: dict[str, Any]) -> str:
    """Return one line of the second table."""
    return (
        f"| {name} | {'yes' if m['adaptive'] else 'no'} | {m['target']:g} | "
        f"{m['spp'][0]} to {m['spp'][1]} | {100 * m['bias']:.3f} ± {100 * m['bias_error']:.3f} % | "
        f"{100 * m['share']:.2f} % |"
    )


def main() -> None:
    """Measure and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--spp", type=int, nargs="+", default=[64, 256])
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--factor", type=int, default=32, help="samples of the reference")
    parser.add_argument("--stops", type=int, default=400, help="films that end at a target")
    parser.add_argument("--scenes", default="")
    parser.add_argument("--out", type=Path, default=None)
    args = parser.parse_args()
    found = scenes(args.size) | {"spotlit": spotlit(args.size)}
    results: dict[str, list[dict[str, Any]]] = {"gain": [], "stopping": []}
    print("| scene | spp | uniform relMSE | adaptive relMSE | time ratio | gain |")
    print("|---|---|---|---|---|---|", flush=True)
    for name in args.scenes.split(",") if args.scenes else found:
        for spp in args.spp:
            m = gain(found[name], spp, args.seeds, args.factor)
            results["gain"].append({"scene": name, **m})
            print(gain_row(name, m), flush=True)
    print("\n| samples | adaptive | target relMSE | spp | bias of the mean | over root of target |")
    print("|---|---|---|---|---|---|", flush=True)
    for kind, spread, target in STOPS:
        for adaptive in (False, True) if args.stops > 1 else ():
            m = stopping(kind, spread, target, args.stops, adaptive)
            results["stopping"].append({"kind": kind, "spread": spread, **m})
            print(stop_row(f"{kind} {spread:g}", m), flush=True)
    if args.out is not None:
        args.out.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
