"""Nights compared: 20 pairs of 1,000 cells without change, and changes of 1 % and 0.1 %

False alarms: 1,000 cells (12 kinds of scenes, views and roughness varied) are rendered at 8 x 8
and 16 samples per pixel with 40 seeds, and seed 2k compared with seed 2k + 1. At most 3 of 20 pairs
may raise any alarm at the familywise 5 %, as nights of different seeds (Welch) and, with the same
films called nights of one seed, in the paired test; and so may 20 pairs of one seed and 200 cells
whose field of view differs in the last bit, so that a few paths go elsewhere. Power: into such
nights of 1,000 cells goes one cell of 64 x 64 pixels and 64 samples, a ball of metal whose F0 is
larger by 1 % in the later night (other seeds) or by 0.1 % (the same seed); it must be found in 19
of 20 seeds each, against all 51,000 tests. Resumable: films become signatures in prove-out/nights/.
Arguments: --pairs, --seeds, --cells.
"""

import argparse
import copy
import json
import statistics
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matiere as mt
from matiere import _core, chunks
from matiere.jobs.artifacts import pack, unpack
from matiere.jobs.compare_nights import compare_nights
from matiere.jobs.night import Night
from matiere.scene.digest import fingerprint
from matiere.signature import engine_digest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "support"))

from twelve_scenes import twelve  # noqa: E402

OUT = ROOT / "prove-out" / "nights"
PAIRS, SEEDS, CELLS = 20, 20, 1000
SIZE, SPP, BLOCK = 8, 16, 50
BIG, BIG_SPP = 64, 64
LEFT_OUT = {"layered"}  # ten times as slow as the others
MOST_ALARMS, LEAST_FOUND = 3 / 20, 19 / 20
METAL = (0.95, 0.64, 0.37)  # F0 of the changed cell, about that of copper
TINY = 1e-7  # about the last bit of a float
CHANGES = {"other seeds": 1.01, "one seed": 1.001}


class Made(Night):
    """A night in memory: signatures by cell."""

    def __init__(self, name: str, data: list[bytes]) -> None:
        """Name the cells by number."""
        rows = [
            {"cell": i, "label": str(i), "parameters": {"cell": i}, "state": "succeeded",
             "spp": SPP, "seconds": 1.0, "relmse": None, "cached": False}
            for i in range(len(data))
        ]  # fmt: skip
        super().__init__({"name": name}, rows)
        self._data = data

    def data(self, row: dict[str, Any]) -> bytes:
        """Return a signature."""
        return self._data[row["cell"]]

    def with_cell(self, data: bytes) -> "Made":
        """Return this night with another first cell."""
        return Made(self.name, [data, *self._data[1:]])

    def called(self, seed: int) -> "Made":
        """Return the same night with its seed called another."""
        from dataclasses import replace

        renamed = [replace(mt.Signature.from_bytes(d), seeds=(seed,)) for d in self._data]
        return Made(self.name, [s.to_bytes() for s in renamed])


def documents(count: int) -> Iterator[dict[str, Any]]:
    """Yield the scenes of the cells."""
    kinds = {name: d for name, d in twelve(SIZE).items() if name not in LEFT_OUT}
    for index in range(count):
        document = copy.deepcopy(list(kinds.values())[index % len(kinds)])
        turn = index // len(kinds)
        document["camera"]["origin"][0] += 0.02 * turn
        for material in document["materials"].values():
            if isinstance(material.get("alpha"), float) and material["alpha"] > 0.0:
                material["alpha"] = 0.05 + 0.005 * (turn % 90)
        yield document


def signed(built: Any, scene: mt.Scene, seed: int, spp: int) -> bytes:
    """Render with a seed and return the signature."""
    film = chunks.new_film(chunks.plan(scene.model))
    settings = chunks.settings(scene.with_render(seed=seed).model)
    _core.render(built, settings, film, {"spp": spp}, 1)
    return mt.signature(film, seeds=(seed,), engine=engine_digest(fingerprint())).to_bytes()


def store(path: Path, data: bytes) -> None:
    """Write a file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_bytes(data)
    part.replace(path)


def block(first: int, count: int, seeds: int, moved: bool = False) -> list[list[bytes]]:
    """Return signatures by cell and seed of one block, rendering what is not stored.

    `moved`: the field of view is larger by one part in ten million.
    """
    kind = "moved" if moved else "cells"
    path = OUT / f"{kind}-{first:04}-{count}-{engine_digest(fingerprint())}-{seeds}.pack"
    if not path.exists():
        records = []
        for document in list(documents(first + count))[first:]:
            document["camera"]["vfov_deg"] *= 1.0 + moved * TINY
            scene = mt.load(document)
            built = scene.build(1)
            records += [signed(built, scene, seed, SPP) for seed in range(seeds)]
        store(path, b"".join(pack({}, records)))
    _, found = unpack(path.read_bytes())
    return [[bytes(r) for r in found[i : i + seeds]] for i in range(0, len(found), seeds)]


def last_bits(cells: int, pairs: int) -> list[dict[str, Any]]:
    """Compare nights of one seed that differ by rounding alone: a few paths go elsewhere."""
    few = max(cells // 5, 1)
    print(f"  {few} cells with another rounding", flush=True)
    now = [block(i, min(BLOCK, few - i), pairs, moved=True) for i in range(0, few, BLOCK)]
    before = [block(i, min(BLOCK, cells - i), 2 * pairs) for i in range(0, few, BLOCK)]  # stored
    later = [cell for cells_of in now for cell in cells_of]
    earlier = [cell for cells_of in before for cell in cells_of][:few]
    rows = []
    for k in range(pairs):
        a, b = (Made(f"seed {k}", [cell[k] for cell in night]) for night in (earlier, later))
        report = compare_nights(a, b)
        least = min(row["p_corrected"] for row in report["table"])
        rows.append(
            {"pair": k, "changed": report["cells"]["changed"], "least": least,
             "tests": report["tests"], "identical": report["cells"]["identical"]}
        )  # fmt: skip
    return rows


def nights(cells: int, seeds: int) -> list[Made]:
    """Return one night for each seed."""
    begin, found = time.monotonic(), list[list[bytes]]()
    for first in range(0, cells, BLOCK):
        found += block(first, min(BLOCK, cells - first), seeds)
        if first % 200 == 0:
            print(f"  {len(found)} cells, {time.monotonic() - begin:.0f} s", flush=True)
    return [Made(f"seed {seed}", [cell[seed] for cell in found]) for seed in range(seeds)]


def false_alarms(made: list[Made], pairs: int) -> dict[str, list[dict[str, Any]]]:
    """Compare nights that differ by their seeds alone."""
    done: dict[str, list[dict[str, Any]]] = {"other seeds": [], "called one seed": []}
    for k in range(pairs):
        a, b = made[2 * k], made[2 * k + 1]
        for name, later in (("other seeds", b), ("called one seed", b.called(2 * k))):
            report = compare_nights(a, later)
            least = min(row["p_corrected"] for row in report["table"])
            done[name].append(
                {"pair": k, "changed": report["cells"]["changed"], "least": least,
                 "tests": report["tests"], "paired": report["cells"]["paired"]}
            )  # fmt: skip
            print(f"  pair {k}, {name}: {report['cells']['changed']} alarms, "
                  f"least corrected p {least:.2g}", flush=True)  # fmt: skip
    return done


def big_cell(factor: float, seed: int) -> bytes:
    """Return the signature of the metal ball, its F0 larger by a factor."""
    path = OUT / f"ball-{factor}-{seed}-{engine_digest(fingerprint())}.signature"
    if not path.exists():
        document = json.loads((ROOT / "examples" / "scenes" / "first.json").read_text())
        document["film"] = {"width": BIG, "height": BIG}
        f0 = [factor * x for x in METAL]
        document["materials"]["ball"] = {"type": "cook_torrance", "F0": f0, "alpha": 0.3}
        scene = mt.load(document)
        store(path, signed(scene.build(1), scene, seed, BIG_SPP))
    return path.read_bytes()


def power(made: list[Made], seeds: int) -> dict[str, list[dict[str, Any]]]:
    """Put a changed cell into nights of 1,000 and look whether it is found."""
    done: dict[str, list[dict[str, Any]]] = {name: [] for name in CHANGES}
    for seed in range(seeds):
        for name, factor in CHANGES.items():
            later = made[seed] if name == "one seed" else made[(seed + 1) % len(made)]
            other = seed if name == "one seed" else 1000 + seed
            a = made[seed].with_cell(big_cell(1.0, seed))
            report = compare_nights(a, later.with_cell(big_cell(factor, other)))
            row = report["table"][0]
            done[name].append(
                {"seed": seed, "found": any(c["cell"] == 0 for c in report["changes"]),
                 "p_corrected": row["p_corrected"], "percent": row["percent"],
                 "others": report["cells"]["changed"], "detectable": row["detectable_percent"]}
            )  # fmt: skip
            print(
                f"  seed {seed}, {100 * (factor - 1):.1f} %, {name}: corrected p "
                f"{row['p_corrected']:.2g}, image {row['percent']:+.3f} %, smallest detectable "
                f"{row['detectable_percent']:.3g} %",
                flush=True,
            )
    return done


def judge(found: dict[str, Any]) -> int:
    """Print the totals; return the exit code."""
    good = True
    for name, rows in found["alarms"].items():
        hits = sum(row["changed"] > 0 for row in rows)
        good &= hits <= MOST_ALARMS * len(rows)
        print(
            f"no change, {name}: {hits} of {len(rows)} pairs raise an alarm (at most "
            f"{MOST_ALARMS * len(rows):.0f}); {rows[0]['tests']:,} tests each"
        )
    for name, rows in found["power"].items():
        hits = sum(row["found"] for row in rows)
        good &= hits >= LEAST_FOUND * len(rows)
        least = statistics.median(row["detectable"] for row in rows)
        seen = statistics.median(row["percent"] for row in rows)
        print(
            f"F0 larger by {100 * (CHANGES[name] - 1):.1f} %, {name}: found in {hits} of "
            f"{len(rows)} (needs {LEAST_FOUND * len(rows):.0f}); image {seen:+.3g} %, smallest "
            f"detectable change of the image {least:.3g} %"
        )
    return 0 if good else 1


def main() -> int:
    """Render, compare, judge."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--pairs", type=int, default=PAIRS)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--cells", type=int, default=CELLS)
    asked = parser.parse_args()
    made = nights(asked.cells, 2 * asked.pairs)
    alarms = false_alarms(made, asked.pairs)
    alarms["one seed, another rounding"] = last_bits(asked.cells, asked.pairs)
    found = {"alarms": alarms, "power": power(made, asked.seeds)}
    (OUT / "nights.json").write_text(json.dumps(found, indent=1) + "\n")
    return judge(found)


if __name__ == "__main__":
    sys.exit(main())
