"""Instructions and time per sample of the chosen kernel against the full one, scene by scene.

    ./dev bench kernels            (needs valgrind; a few minutes)

Instructions are those outside libembree, counted by callgrind: the difference of two runs that
differ in samples alone, so that the start of Python and the building of the scene drop out. Times
are CPU times of one thread, the median of several runs; machines are noisy, so read the ratios.
docs/kernels.md holds the table of the last release.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path
from time import thread_time
from typing import Any

import matiere as mt
from matiere import _core

ROOT = Path(__file__).resolve().parents[2]
SCENES = ("cornell", "first", "rough_metals", "glass_sphere")
EDGE, FEW, MANY = 12, 4, 8  # whole passes


def load(name: str, edge: int) -> mt.Scene:
    """Return a scene of the examples at depth 8."""
    folder = ROOT / "examples" / "scenes"
    document = json.loads((folder / f"{name}.json").read_text())
    document["film"] = {"width": edge, "height": edge}
    document["render"] = {"max_depth": 8}
    return mt.load(document, asset_root=folder)


def run(name: str, kernel: str, edge: int, spp: int) -> float:
    """Render on this thread; return the CPU seconds of the samples alone."""
    scene = load(name, edge)
    built, plan = scene.build(1), mt.chunks.plan(scene.model)
    settings = _core.Settings(0, 8, kernel=kernel)
    start = thread_time()
    for index in range(plan.chunk_count(spp)):
        _core.render_chunk(built, settings, plan, index)
    return thread_time() - start


def instructions_of(file: Path) -> int:
    """Sum what the objects of the core and the maths library executed by themselves."""
    names: dict[str, str] = {}
    total, counts, called = 0, False, False
    for line in file.read_text().splitlines():
        match = re.match(r"c?ob=\((\d+)\)(?: (.*))?", line)
        if match:
            names.setdefault(match[1], match[2] or "")
            if line.startswith("ob="):
                counts = bool(re.search(r"/_core\.|/libm\.", names[match[1]]))
        elif line.startswith("calls="):
            called = True
        elif re.match(r"[-+*\d]", line):
            if counts and not called:
                total += int(line.split()[1])
            called = False
    return total


def instructions(name: str, kernel: str) -> float:
    """Return the instructions per sample outside libembree."""
    totals = []
    with tempfile.TemporaryDirectory() as folder:
        for spp in (FEW, MANY):
            file = Path(folder) / f"{spp}"
            child = [sys.executable, __file__, "--child", name, kernel, str(EDGE), str(spp)]
            command = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={file}", *child]
            subprocess.run(command, check=True, capture_output=True)
            totals.append(instructions_of(file))
    return (totals[1] - totals[0]) / (EDGE * EDGE * (MANY - FEW))


def microseconds(name: str, kernel: str, edge: int, spp: int, runs: int) -> float:
    """Return the median time of one sample."""
    times = [run(name, kernel, edge, spp) for _ in range(runs)]
    return statistics.median(times) / (edge * edge * spp) * 1e6


def main() -> None:
    """Measure every scene and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=SCENES)
    parser.add_argument("--child", nargs=4, help=argparse.SUPPRESS)
    parser.add_argument("--edge", type=int, default=64)
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--runs", type=int, default=5)
    options = parser.parse_args()
    if options.child:
        name, kernel, edge, spp = options.child
        run(name, kernel, int(edge), int(spp))
        return
    if shutil.which("valgrind") is None:
        sys.exit("install valgrind first: apt-get install valgrind")
    print("| scene | kernel | instructions | of the full one | us | of the full one |")
    print("|---|---|---|---|---|---|")
    for name in options.scenes:
        chosen: dict[str, Any] = _core.kernel_of(load(name, 4).build(1), _core.Settings())
        kernels = dict.fromkeys([chosen["name"], "full"])
        counts = [instructions(name, kernel) for kernel in kernels]
        timing = (options.edge, options.spp, options.runs)
        times = [microseconds(name, kernel, *timing) for kernel in kernels]
        for kernel, count, time in zip(kernels, counts, times, strict=True):
            share, slow = count / counts[-1], time / times[-1]
            print(f"| {name} | {kernel} | {count:.0f} | {share:.2f} | {time:.2f} | {slow:.2f} |")


if __name__ == "__main__":
    main()
