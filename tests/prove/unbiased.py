"""Unbiasedness: 12 scenes, 64 short renders against a long one and against every other strategy

Every scene of tests/support/twelve_scenes.py is rendered at 32 x 32 with 64 seeds by the default
strategy, once long with another seed, and with 64 seeds by each alternative: light sampling only,
BSDF sampling only (where it can find the lights), the light tree off, the caustic guide off, paths
from every lamp, and none (where paths from the camera find all there is), adaptive sampling. A road
that makes the very pixels of the default is not one of its own.
Judged: means of the image and of its 16 tiles (4 where lamps are small and tiles dark) by Welch's t
on the 64 means, Sidak-corrected over all tests (1 in 100 for the whole table); and the same tests
must find a planted bias of 1 % of the image and 5 % of a tile, or they prove nothing. Resumable:
finished pairs are kept in prove-out/unbiased.json. Arguments: names of scenes (default: all).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

import matiere as mt
from matiere import _core

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "support"))

from twelve_scenes import twelve  # noqa: E402

OUT = ROOT / "prove-out" / "unbiased.json"
SIZE, TILES, SEEDS, LONG_SEED = 32, 4, 64, 555_555
FEW_TILES, COARSE = 2, ("veach_mis", "many_lights")
TESTS, CHANCE = 13 * 8 * (TILES**2 + 1), 0.01
LEVEL = 1 - (1 - CHANCE) ** (1 / TESTS)  # of one two-sided test (Sidak 1967)
FIRST_SPP, FIRST_ADAPTIVE_SPP = 16, 128  # where an adaptive film has left the even counts
MOST_SPP = 4096  # of a short render: where even that finds no planted bias, the line fails
PLANTED_IMAGE, PLANTED_TILE = 1.01, 1.05
# strategy, light tree, caustic guide, light tracing, adaptive
ROADS = {
    "default": ("mis", True, True, "auto", False),
    "light sampling only": ("light", True, True, "auto", False),
    "bsdf sampling only": ("bsdf", True, True, "auto", False),
    "light tree off": ("mis", False, True, "auto", False),
    "caustic guide off": ("mis", True, False, "auto", False),
    "light tracing on": ("mis", True, True, "on", False),
    "light tracing off": ("mis", True, True, "off", False),
    "adaptive sampling on": ("mis", True, True, "auto", True),
}
Means = NDArray[np.float64]  # (runs, 1 + tiles): the image, then its tiles


def planted(means: Means) -> Means:
    """Return what the means would be with the bias that must be found."""
    factors = np.full(means.shape[-1], PLANTED_TILE)
    factors[0] = PLANTED_IMAGE
    return means * factors


class Road:
    """One scene by one strategy: means of short renders, more samples on demand."""

    def __init__(self, document: dict[str, Any], road: str, tiles: int) -> None:
        strategy, tree, guide, light, self._adaptive = ROADS[road]
        self.first_spp = FIRST_ADAPTIVE_SPP if self._adaptive else FIRST_SPP
        self._tiles = tiles
        description = mt.load(document)._flatten().description  # the tree has no public switch
        description.light_tree = tree
        self._scene = _core.Scene(description, 2)
        self._settings = lambda seed: _core.Settings(
            seed, -1, strategy, guide_caustics=guide, light_tracing=light
        )
        self._films: dict[int, _core.Film] = {}

    def why_not(self, road: str) -> str:
        """Say why another road would be the same one, or would miss light; empty if neither."""
        settings = self._settings(1)
        layer = _core.has_light_layer(self._scene, settings)
        if road == "light tracing on":
            every = _core.Settings(1, -1, "mis", light_tracing="on")
            return "" if _core.has_light_layer(self._scene, every) else "no lamp shines on a mirror"
        if road == "light tracing off" and not layer:
            return "the default has no paths from lamps"
        found = _core.kernel_of(self._scene, settings)["found"]
        if road == "light tracing off" and {"point_lights", "delta_lobes"} <= set(found):
            return "camera paths cannot find the light of points by way of mirrors"
        return ""

    def makes_the_pixels_of(self, other: Road) -> bool:
        """Tell whether both are the same road."""
        return self._adaptive == other._adaptive and bool(
            np.array_equal(self._image(0, 32), other._image(0, 32))
        )

    def means(self, spp: int, seeds: range) -> Means:
        """Return luminance means of the image and its tiles for every seed."""
        return np.stack([self._means(seed, spp) for seed in seeds])

    def _image(self, seed: int, spp: int) -> Means:
        film = self._films.setdefault(seed, _core.Film(SIZE, SIZE, 4, self._adaptive))
        _core.render(self._scene, self._settings(seed), film, {"spp": spp}, 2)
        return np.asarray(film.mean()[..., :3] @ [0.2126, 0.7152, 0.0722])

    def _means(self, seed: int, spp: int) -> Means:
        light, n, edge = self._image(seed, spp), self._tiles, SIZE // self._tiles
        tiles = light.reshape(n, edge, n, edge).mean(axis=(1, 3))
        return np.concatenate([[light.mean()], tiles.ravel()])


def welch(a: Means, b: Means) -> NDArray[np.float64]:
    """Return the p value of each mean; a side whose runs all agree counts as exact."""
    with np.errstate(divide="ignore", invalid="ignore"):
        found = stats.ttest_ind(a, b, axis=0, equal_var=False).pvalue
    equal = same(a.mean(0), b.mean(0))
    return np.where(np.isfinite(found), np.where(equal, 1.0, found), equal.astype(float))


def same(a: Means, b: Means) -> NDArray[np.bool_]:
    """Tell which means are those of black or constant tiles: their only noise is rounding."""
    return np.abs(a - b) <= 1e-5 * np.abs(a)


def finds_planted_bias(a: Means, b: Means) -> bool:
    """Tell whether 1 % more light in the image and 5 % more in any tile would be found."""
    lit = b.mean(0) > 1e-6 * b[:, 0].mean()
    return bool(np.all((welch(a, planted(b)) < LEVEL) | ~lit))


def compare(a: Road, b: Road, spp: int) -> dict[str, Any]:
    """Double the samples until the test could find a planted bias; then return what it finds."""
    began = time.monotonic()
    while True:
        ours, theirs = a.means(spp, range(1, SEEDS + 1)), b.means(spp, range(1001, 1001 + SEEDS))
        power = finds_planted_bias(ours, theirs)
        if power or 2 * spp > MOST_SPP:
            break
        spp *= 2
    gap = theirs[:, 0].mean() / ours[:, 0].mean() - 1
    return row(spp, welch(ours, theirs), gap, power, began)


def against_long(road: Road, spp: int) -> dict[str, Any]:
    """Compare 64 short renders with one long one of the same samples in all."""
    began = time.monotonic()
    while True:
        short = road.means(spp, range(1, SEEDS + 1))
        long = road.means(spp * SEEDS, range(LONG_SEED, LONG_SEED + 1))
        p = against_one(short, long[0])
        lit = short.mean(0) > 1e-6 * short[:, 0].mean()
        power = bool(np.all((against_one(short, planted(long[0])) < LEVEL) | ~lit))
        if power or 2 * spp > MOST_SPP:
            break
        spp *= 2
    gap = long[0, 0] / short[:, 0].mean() - 1
    return row(spp, p, gap, power, began)


def against_one(short: Means, long: Means) -> NDArray[np.float64]:
    """Return the p values of one long render, taken to vary like the mean of the short ones."""
    error = np.sqrt(2 / SEEDS) * short.std(axis=0, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        p = 2 * stats.t.sf(np.abs(short.mean(0) - long) / error, SEEDS - 1)
    return np.where(np.isfinite(p) & ~same(short.mean(0), long), p, 1.0)


def row(spp: int, p: NDArray[np.float64], gap: float, power: bool, began: float) -> dict[str, Any]:
    """Return what is kept of one comparison."""
    return {
        "spp": spp,
        "least_p": float(p.min()),
        "image_p": float(p[0]),
        "image_gap": float(gap),
        "planted_found": power,
        "seconds": time.monotonic() - began,
    }


def line(scene: str, road: str, found: dict[str, Any]) -> str:
    """Return one line of the table."""
    verdict = "agrees" if found["least_p"] >= LEVEL else "DIFFERS"
    planted = "yes" if found["planted_found"] else "NO"
    return (
        f"| {scene} | {road} | {found['spp']} | {100 * found['image_gap']:+.3f} % | "
        f"{found['image_p']:.2g} | {found['least_p']:.2g} | {verdict} | "
        f"{planted} | {found['seconds']:.0f} |"
    )


def main() -> int:
    """Compare what is missing, print the table, judge it."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("scenes", nargs="*", help="names (default: all)")
    asked = parser.parse_args()
    scenes = twelve(SIZE)
    done = json.loads(OUT.read_text()) if OUT.exists() else {}
    OUT.parent.mkdir(exist_ok=True)
    print(f"a test fails below p = {LEVEL:.2g}")
    print("| scene | against | spp x 64 | image differs by | p (image) | least p | verdict | "
          "planted bias found | s |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|", flush=True)
    for name in asked.scenes or list(scenes):
        tiles = FEW_TILES if name in COARSE else TILES
        default = Road(scenes[name], "default", tiles)
        for road in ("one long render", *list(ROADS)[1:]):
            key = f"{name}: {road}"
            other = default if road == "one long render" else Road(scenes[name], road, tiles)
            why = default.why_not(road)
            if not why and other is not default and other.makes_the_pixels_of(default):
                why = "the very pixels of the default"
            if why:
                print(f"| {name} | {road} | - | - | - | - | {why} | - | - |", flush=True)
                continue
            if key not in done:
                if other is default:
                    done[key] = against_long(default, FIRST_SPP)
                else:
                    done[key] = compare(default, other, other.first_spp)
                OUT.write_text(json.dumps(done, indent=1) + "\n")
            print(line(name, road, done[key]), flush=True)
    rows = list(done.values())
    agreed = sum(row["least_p"] >= LEVEL for row in rows)
    strong = sum(row["planted_found"] for row in rows)
    print(f"\n{agreed} of {len(rows)} agree; {strong} of {len(rows)} would find the planted bias")
    return 0 if agreed == strong == len(rows) else 1


if __name__ == "__main__":
    sys.exit(main())
