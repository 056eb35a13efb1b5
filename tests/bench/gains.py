"""What each part gains at equal time: relMSE x CPU seconds without it over that with it.

    ./dev bench gains --out prove-out/gains.json

Adaptive sampling against even counts, Sobol points against independent ones, light tracing against
camera paths alone (with the photons' guide and without), the light tree against a choice by power,
in one run. Both sides are rendered in turn with the same seeds; the reference has many more
samples, another seed and whatever finds the most light, and its own noise is taken off. Independent
points are those of many films of four samples a pixel (one a replicate), with seeds of their own:
their time is taken to be that of Sobol points. A gain of 2 is half the time to the same error, +-
its standard error.
"""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

import matiere as mt
from matiere import _core

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
for folder in (HERE.parent / "support", HERE / "peers"):
    sys.path.insert(0, str(folder))
import neutral  # noqa: E402
from film_scenes import scenes  # noqa: E402
from matiere_worker import document as of_neutral  # noqa: E402

REFERENCE_SEED = 987_654_321
TRIM = 0.001  # share of the pixels, the worst ones, that the trimmed gain leaves out
Image = npt.NDArray[np.float64]


class Side(NamedTuple):
    """One of the two ways to render a scene."""

    document: dict[str, Any]
    tree: bool = True
    guide: bool = True
    light_tracing: str = "auto"
    adaptive: bool = False
    independent: bool = False


class Gain(NamedTuple):
    """A part of the renderer, and a scene with and without it."""

    part: str
    scene: str
    without: Side
    having: Side


def renderer(side: Side, threads: int) -> Callable[[int, int], tuple[Image, float]]:
    """Return what renders a side with (spp, seed) to its mean and CPU seconds."""
    description = mt.load(side.document)._flatten().description  # the tree has no public switch
    description.light_tree = side.tree
    scene = _core.Scene(description, threads)
    film_size = side.document["film"]
    max_depth = side.document.get("render", {}).get("max_depth", -1)

    def once(spp: int, seed: int) -> tuple[Image, float]:
        settings = _core.Settings(
            seed, max_depth, "mis", guide_caustics=side.guide, light_tracing=side.light_tracing
        )
        film = _core.Film(film_size["width"], film_size["height"], 4, side.adaptive)
        _core.render(scene, settings, film, {"spp": spp}, threads)
        return np.asarray(film.mean(), float)[..., :3], float(film.counters["cpu_s"])

    def render(spp: int, seed: int) -> tuple[Image, float]:
        if not side.independent:
            return once(spp, seed)
        found = [once(4, 1_000_003 * seed + part) for part in range(spp // 4)]
        return np.mean([image for image, _ in found], axis=0), 0.0

    return render


def error(image: Image, halves: tuple[Image, Image]) -> tuple[float, float]:
    """Return the relMSE of all pixels and of all but the worst, less the reference's own noise."""
    reference = (halves[0] + halves[1]) / 2
    square = (image - reference) ** 2 - ((halves[0] - halves[1]) / 2) ** 2
    pixels = (square / (reference**2 + 0.01 * reference.mean() ** 2)).mean(axis=2).ravel()
    return float(pixels.mean()), float(np.sort(pixels)[: round(pixels.size * (1 - TRIM))].mean())


def measure(gain: Gain, options: argparse.Namespace) -> dict[str, Any]:
    """Return mean relMSE of both sides, their time ratio and the gain."""
    sides = [renderer(side, options.threads) for side in (gain.without, gain.having)]
    spp = options.spp * options.factor // 2
    halves = [sides[1](spp, REFERENCE_SEED + half)[0] for half in (0, 1)]
    errors: list[list[tuple[float, float]]] = [[], []]
    seconds: list[list[float]] = [[], []]
    for seed in range(options.seeds):
        for side, render in enumerate(sides):
            image, cpu = render(options.spp, seed)
            errors[side].append(error(image, (halves[0], halves[1])))
            seconds[side].append(cpu)
    known = not gain.without.independent
    slower = statistics.median(b / a for a, b in zip(*seconds, strict=True)) if known else 1.0
    found: dict[str, Any] = {
        "part": gain.part, "scene": gain.scene, "spp": options.spp, "seeds": options.seeds,
        "time": slower,
    }  # fmt: skip
    for kind, name in enumerate(("", "trimmed_")):
        without, having = ([e[kind] for e in side] for side in errors)
        mean = [statistics.fmean(e) for e in (without, having)]
        relative = [statistics.stdev(e) / statistics.fmean(e) for e in (without, having)]
        ratio = mean[0] / mean[1] / slower
        found |= {f"{name}without": mean[0], f"{name}having": mean[1], f"{name}gain": ratio}
        found[f"{name}gain_error"] = ratio * math.hypot(*relative) / math.sqrt(options.seeds)
    return found


def peer_scene(name: str, size: int, assets: Path) -> dict[str, Any]:
    """Return a scene of the comparison with other renderers."""
    return of_neutral({"name": name, "size": size, **neutral.SCENES[name](assets)})


def gains(size: int, assets: Path) -> list[Gain]:
    """Return what is measured."""
    found = []
    for name, document in scenes(size).items():
        plain = Side(document)
        found.append(Gain("adaptive sampling", name, plain, plain._replace(adaptive=True)))
        found.append(Gain("Sobol points", name, plain._replace(independent=True), plain))
    traced = Side(peer_scene("glass", size, assets))
    camera = traced._replace(light_tracing="off")
    found.append(Gain("light tracing, over the guide", "glass ball", camera, traced))
    unguided = camera._replace(guide=False)
    found.append(Gain("light tracing, over neither", "glass ball", unguided, traced))
    lamps = Side(peer_scene("lamps", size, assets))
    found.append(Gain("light tree", "500 lamps", lamps._replace(tree=False), lamps))
    return found


def row(m: dict[str, Any]) -> str:
    """Return one line of the table."""
    return (
        f"| {m['part']} | {m['scene']} | {m['spp']} | {m['without']:.3g} | {m['having']:.3g} | "
        f"{m['time']:.2f} | {m['gain']:.2f} ± {m['gain_error']:.2f} | "
        f"{m['trimmed_gain']:.2f} ± {m['trimmed_gain_error']:.2f} |"
    )


def main() -> None:
    """Measure, print the table, keep the figures."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("parts", nargs="*", help="beginnings of part names (default: all)")
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--spp", type=int, default=64)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--factor", type=int, default=64, help="samples of the reference over spp")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--assets", type=Path, default=ROOT.parent / "shared" / "assets")
    parser.add_argument("--out", type=Path, help="JSON of the figures")
    options = parser.parse_args()
    print("| part | scene | spp | relMSE without | relMSE with | time with / without | gain | "
          "gain, trimmed |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|", flush=True)
    rows = []
    for gain in gains(options.size, options.assets):
        if options.parts and not gain.part.startswith(tuple(options.parts)):
            continue
        rows.append(measure(gain, options))
        print(row(rows[-1]), flush=True)
        if options.out:
            options.out.parent.mkdir(parents=True, exist_ok=True)
            options.out.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
