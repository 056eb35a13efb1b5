"""How much a stop by `target_error` biases the image: integrands of known mean, many seeds.

    python tests/bench/stopping_bias.py --seeds 400

A film of 16 x 16 pixels is rendered until its target is met, again and again with new seeds. The
mean radiance of these films over the true one, less 1, is the stopping bias; beside it the same
films at a fixed number of samples near the median, where there is none. Errors are standard errors.
"""

from __future__ import annotations

import argparse

import numpy as np

from matiere import _core

SIZE = 16
COLOURS = np.array([1.0, 0.5, 0.25])  # of every synthetic integrand
CASES = [("gaussian", 0.5, 0.005), ("lognormal", 1.0, 0.01), ("lognormal", 3.0, 0.05),
         ("rare", 3.0, 0.05)]  # fmt: skip


def bias(kind: str, spread: float, stop: dict[str, object], seeds: int) -> tuple[float, float, int]:
    """Return relative bias of the mean, its standard error, and the median samples per pixel."""
    y, x = np.mgrid[0:SIZE, 0:SIZE]
    truth = (_core.synthetic_mean(x, y)[..., None] * COLOURS).mean()
    found, spp = [], []
    for seed in range(seeds):
        film = _core.Film(SIZE, SIZE, 4)
        _core.render_synthetic(film, kind, stop, spread, seed, 1)
        found.append(film.mean()[..., :3].mean() / truth - 1.0)
        spp.append(film.spp)
    return float(np.mean(found)), float(np.std(found) / np.sqrt(seeds)), int(np.median(spp))


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--seeds", type=int, default=400)
    seeds = parser.parse_args().seeds
    print("| integrand | target relMSE | median spp | stopping bias % | fixed spp % |")
    print("|---|---|---|---|---|")
    for kind, spread, target in CASES:
        at, error, spp = bias(kind, spread, {"target_error": {"relmse": target}}, seeds)
        fixed, fixed_error, _ = bias(kind, spread, {"spp": spp}, seeds)
        print(
            f"| {kind}, deviation {spread:g} | {target:g} | {spp} | "
            f"{100 * at:+.3f} ± {100 * error:.3f} | {100 * fixed:+.3f} ± {100 * fixed_error:.3f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
