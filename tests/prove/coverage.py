"""Certificate coverage: 30 seeds x 12 scenes x 3 budgets, the three looks of one run

Every scene of tests/support/twelve_scenes.py is rendered at 32 x 32 with 30 seeds to 16, 48 and 144
samples per pixel, each run continued from look to look, and compared with one reference of another
seed. Judged: the 95 % interval holds the realised relMSE in at least 93 % of all cells' runs and in
at least 24 of 30 of every cell; the any-time intervals hold at all three looks together; an error
is never 0. Resumable: finished scenes are kept in prove-out/coverage.json. Arguments: names of
scenes (default: all); --seeds N.
"""

import argparse
import json
import statistics
import sys
from pathlib import Path
from typing import Any

import matiere as mt

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "support"))

from twelve_scenes import twelve  # noqa: E402

OUT = ROOT / "prove-out" / "coverage.json"
SIZE, SEEDS, BUDGETS = 32, 30, (16, 48, 144)
REFERENCE_SPP, REFERENCE_SEED = 8192, 987_654_321
POOLED, LEAST = 0.93, 24 / 30


def run(scene: mt.Scene, seed: int, reference: mt.Film) -> list[dict[str, Any]]:
    """Return the three looks of one run: estimate, intervals and realised error."""
    film, looks = None, []
    for spp in BUDGETS:
        film = mt.render(scene, spp=spp, seed=seed, film=film)
        looks.append({**film.error, "spp": spp, "realised": film.realised_relmse(reference)})
    return looks


def measure(document: dict[str, Any], seeds: int) -> dict[str, Any]:
    """Return the looks of all runs of one scene."""
    scene = mt.load(document)
    reference = mt.render(scene, spp=REFERENCE_SPP, seed=REFERENCE_SEED)
    runs = [run(scene, seed, reference) for seed in range(seeds)]
    return {"reference_relmse": reference.error["relmse"], "runs": runs}


def inside(look: dict[str, Any], kind: str = "") -> bool:
    """Tell whether a look's interval holds its realised error; without evidence there is none."""
    if not look["known"]:
        return True
    lower, upper = look[f"{kind}lower"], look[f"{kind}upper"]
    return bool(lower <= look["realised"] <= upper)


def summary(found: dict[str, Any]) -> list[dict[str, Any]]:
    """Return one row per budget of a scene."""
    rows = []
    for index, spp in enumerate(BUDGETS):
        looks = [looks[index] for looks in found["runs"]]
        known = [look for look in looks if look["known"]]
        rows.append(
            {
                "spp": spp,
                "runs": len(looks),
                "inside": sum(map(inside, looks)),
                "below": sum(look["realised"] < look["lower"] for look in known),
                "above": sum(look["realised"] > look["upper"] for look in known),
                "unknown": len(looks) - len(known),
                "zero": sum(look["relmse"] == 0 for look in looks),
                "ratio": statistics.median(look["upper"] / look["lower"] for look in known),
                "estimate": statistics.fmean(look["relmse"] for look in known),
                "realised": statistics.fmean(look["realised"] for look in known),
            }
        )
    return rows


def line(name: str, row: dict[str, Any]) -> str:
    """Return one line of the table."""
    return (
        f"| {name} | {row['spp']} | {row['inside']}/{row['runs']} | {row['below']} | "
        f"{row['above']} | {row['ratio']:.2f} | {row['realised']:.3g} | "
        f"{row['estimate'] / row['realised']:.2f} |"
    )


def judge(done: dict[str, Any], names: list[str]) -> int:
    """Print the totals; return the exit code."""
    rows = [row for name in names for row in summary(done[name])]
    runs = [looks for name in names for looks in done[name]["runs"]]
    good, total = sum(row["inside"] for row in rows), sum(row["runs"] for row in rows)
    low = min(row["inside"] / row["runs"] for row in rows)
    zero = sum(row["zero"] for row in rows)
    together = sum(all(inside(look, "any_time_") for look in looks) for looks in runs)
    ratio = statistics.median(row["ratio"] for row in rows)
    print(
        f"\npooled {good} of {total} inside ({100 * good / total:.1f} %, needs "
        f"{100 * POOLED:.0f} %); least cell {100 * low:.0f} % (needs {100 * LEAST:.0f} %); "
        f"median upper/lower {ratio:.2f}; zero errors {zero}; any-time intervals hold at all "
        f"three looks in {together} of {len(runs)} runs ({100 * together / len(runs):.1f} %)"
    )
    passed = good >= POOLED * total and low >= LEAST and not zero
    return 0 if passed and together >= POOLED * len(runs) else 1


def main() -> int:
    """Measure what is missing, print the table, judge it."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("scenes", nargs="*", help="names (default: all)")
    parser.add_argument("--seeds", type=int, default=SEEDS)
    asked = parser.parse_args()
    scenes = twelve(SIZE)
    names = asked.scenes or list(scenes)
    done = json.loads(OUT.read_text()) if OUT.exists() else {}
    OUT.parent.mkdir(exist_ok=True)
    print("| scene | spp | inside | below | above | upper/lower | realised | estimate/realised |")
    print("|---|---|---|---|---|---|---|---|", flush=True)
    for name in names:
        if len(done.get(name, {}).get("runs", ())) < asked.seeds:
            done[name] = measure(scenes[name], asked.seeds)
            OUT.write_text(json.dumps(done) + "\n")
        for row in summary(done[name]):
            print(line(name, row), flush=True)
    return judge(done, names)


if __name__ == "__main__":
    sys.exit(main())
