"""Efficiency against Mitsuba, LuxCore and Cycles on six scenes, in one run on this machine.

    ./dev bench peers
    ./dev run python tests/bench/peers.py --scenes cornell,glass --runs 3

Each renderer runs in a process of its own with the scene built; renderers alternate within a round.
The error of each is taken against its own long reference, made of two independent halves whose
difference takes the reference's own noise off. docs/peers.md tells what is measured and how the
renderers differ. Pictures and references are kept beside --out: a run that was stopped goes on.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import shlex
import statistics
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
import numpy.typing as npt

HERE = Path(__file__).resolve().parent / "peers"
ROOT = HERE.parents[2]
sys.path.insert(0, str(HERE))
import neutral  # noqa: E402
from peers_venv import find_llvm, peers_python, say  # noqa: E402

RENDERERS = {  # name -> worker, variant
    "matiere": ("matiere", ""),
    "matiere-plain": ("matiere", "1"),  # one replicate: no error bar, as the peers
    "mitsuba-scalar": ("mitsuba", "scalar_rgb"),
    "mitsuba-llvm": ("mitsuba", "llvm_ad_rgb"),
    "luxcore": ("luxcore", ""),
    "cycles": ("cycles", ""),
}
SAME_MODEL = {  # scene -> peers whose models are matiere's, so that means must agree
    "cornell": ("mitsuba-scalar", "mitsuba-llvm", "luxcore", "cycles"),
    "metals": ("cycles",),
    "glass": ("mitsuba-scalar", "mitsuba-llvm", "luxcore", "cycles"),
    "plastic": ("mitsuba-scalar", "mitsuba-llvm"),
    "mesh": ("mitsuba-scalar", "mitsuba-llvm", "luxcore", "cycles"),
    "lamps": ("mitsuba-scalar", "mitsuba-llvm", "luxcore", "cycles"),
}
PEERS = tuple(name for name in RENDERERS if not name.startswith("matiere"))
TRIM = 0.001  # share of the pixels, the worst ones, that is left out
FLOOR = 0.01  # of the squared mean, added to the squared pixel of the reference
CLOCK = 0.01  # seconds: the coarsest clock, that of Cycles; a shorter render is no measurement
REFERENCE_SEEDS = (900_001, 900_002)
FIRST_SEED = 1001

Image = npt.NDArray[np.float64]
Row = dict[str, Any]


@dataclass
class Worker:
    """A renderer with one scene, in a process of its own."""

    process: subprocess.Popen[str]
    answers: IO[str]
    log: Path
    version: str = ""

    def answer(self) -> Row:
        """Return the next answer, or raise RuntimeError with the end of the log."""
        line = self.answers.readline()
        if not line:
            text = self.log.read_text(encoding="utf-8", errors="replace").strip()
            raise RuntimeError(text.splitlines()[-1][:200] if text else "the worker ended")
        found: Row = json.loads(line)
        return found

    def render(self, spp: int, seed: int, out: Path) -> Row:
        """Render to `out` and return the facts."""
        assert self.process.stdin is not None
        order = json.dumps({"spp": spp, "seed": seed, "out": str(out)})
        try:
            print(order, file=self.process.stdin, flush=True)
        except BrokenPipeError:
            pass  # answer() tells why
        return self.answer()

    def close(self) -> None:
        """End the process."""
        assert self.process.stdin is not None
        try:
            self.process.stdin.close()
            self.process.wait(20)
        except (OSError, subprocess.TimeoutExpired):
            self.process.kill()
            self.process.wait()
        self.answers.close()


@dataclass
class Cell:
    """A renderer on a scene: its worker, its reference, its runs."""

    worker: Worker
    folder: Path
    reference_spp: int  # of each half
    halves: tuple[Image, Image]
    runs: list[tuple[Image, Row]] = field(default_factory=list)


@contextmanager
def working(name: str, scene: Path, args: argparse.Namespace) -> Iterator[Worker]:
    """Start the worker of a renderer; it ends with the block."""
    script, variant = RENDERERS[name]
    python = sys.executable if script == "matiere" else str(args.python)
    reader, writer = os.pipe()
    command = [python, str(HERE / f"{script}_worker.py"), str(scene), str(args.threads)]
    command += [str(writer), *([variant] if variant else [])]
    environment = {**os.environ, "OMP_NUM_THREADS": str(args.threads)}
    if args.llvm is not None:
        environment["DRJIT_LIBLLVM_PATH"] = str(args.llvm)
    log = scene / f"{name}.log"
    with log.open("w", encoding="utf-8") as output:
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=output, stderr=output,
            pass_fds=[writer], env=environment, text=True,
        )  # fmt: skip
    os.close(writer)
    worker = Worker(process, os.fdopen(reader), log)
    try:
        worker.version = worker.answer()["version"]
        yield worker
    finally:
        worker.close()


def kept(worker: Worker, folder: Path, spp: int, seed: int) -> tuple[Image, Row]:
    """Return the picture and facts of a render, from the disk if it was made before."""
    stem = folder / f"{spp}-{seed}"
    if not stem.with_suffix(".json").exists():
        facts = worker.render(spp, seed, stem.with_suffix(".npy"))
        stem.with_suffix(".json").write_text(json.dumps(facts), encoding="utf-8")
    facts = json.loads(stem.with_suffix(".json").read_text(encoding="utf-8"))
    return np.load(stem.with_suffix(".npy")).astype(np.float64), facts


def trimmed_relmse(image: Image, halves: tuple[Image, Image]) -> float:
    """Return relMSE against the mean of two halves, less the halves' own share of it.

    relMSE = mean((I - R)^2 / (R^2 + eps)); R's variance is estimated by ((A - B) / 2)^2 and taken
    off pixel by pixel; the pixels with the worst 0.1 % of (I - R)^2 / (R^2 + eps) are left out.
    """
    reference = (halves[0] + halves[1]) / 2
    below = reference**2 + FLOOR * reference.mean() ** 2
    raw = ((image - reference) ** 2 / below).mean(axis=-1).ravel()
    own = (((halves[0] - halves[1]) / 2) ** 2 / below).mean(axis=-1).ravel()
    keep = np.argsort(raw)[: raw.size - round(TRIM * raw.size)]
    return float((raw - own)[keep].mean())


def mean_and_error(halves: tuple[Image, Image]) -> tuple[float, float]:
    """Return the mean of the reference over pixels and channels, and its standard error."""
    reference = (halves[0] + halves[1]).mean(axis=-1) / 2
    half_difference = (halves[0] - halves[1]).mean(axis=-1) / 2
    return float(reference.mean()), float(np.sqrt((half_difference**2).sum()) / reference.size)


def cell_folder(name: str, text: str, version: str, args: argparse.Namespace) -> Path:
    """Return the folder of a cell's pictures: another scene, setting or engine has another."""
    settings = [text, name, version, args.threads]
    if RENDERERS[name][0] == "matiere":
        from matiere import _core

        settings.append(hashlib.sha256(Path(_core.__file__).read_bytes()).hexdigest())
    script = HERE / f"{RENDERERS[name][0]}_worker.py"
    settings.append(script.read_text(encoding="utf-8"))
    key = hashlib.sha256(json.dumps(settings).encode()).hexdigest()[:12]
    folder: Path = args.cache / f"{json.loads(text)['name']}-{name}-{key}"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def reference_spp(worker: Worker, folder: Path, args: argparse.Namespace) -> int:
    """Return the spp of half a reference: as asked, halved until it fits --reference-seconds."""
    note = folder / f"reference-{args.reference_spp}-{args.reference_seconds}.json"
    if note.exists():
        return int(json.loads(note.read_text(encoding="utf-8")))
    worker.render(args.spp, 1, folder / "warm.npy")
    facts = worker.render(args.spp, 2, folder / "warm.npy")
    rate = facts["spp"] / max(facts["seconds"], 1e-3)
    spp: int = args.reference_spp // 2
    while spp > 2 * args.spp and 2 * spp / rate > args.reference_seconds:
        spp //= 2
    note.write_text(json.dumps(spp), encoding="utf-8")
    return spp


def summary(runs: list[tuple[Image, Row]], halves: tuple[Image, Image], size: int) -> Row:
    """Return the medians over the runs of a cell, and its converged mean."""
    rows = []
    for image, facts in runs:
        relmse = trimmed_relmse(image, halves)
        seconds = max(facts["seconds"], CLOCK)
        rate = facts["spp"] * size**2 / seconds / 1e6
        rows.append(
            {
                "seconds": seconds,
                "spp": facts["spp"],
                "relmse": relmse,
                "efficiency": 1 / (relmse * seconds),
                "msamples_s": rate,
                "mrays_s": facts["rays"] / seconds / 1e6 if "rays" in facts else None,
            }
        )
    middle: Row = {}
    for key in rows[0]:
        values = [row[key] for row in rows]
        middle[key] = None if values[0] is None else statistics.median(values)
    mean, error = mean_and_error(halves)
    return {**middle, "runs": rows, "mean": mean, "mean_error": error}


def open_cells(
    stack: ExitStack, name: str, args: argparse.Namespace, missing: dict[str, str]
) -> Iterator[tuple[str, Cell | str]]:
    """Start every renderer on a scene, make its reference; yield the cell, or why there is none."""
    scene = args.cache / f"scene-{name}-{args.size}"
    text = neutral.write(name, args.assets, args.size, scene)
    for renderer in args.renderers:
        if renderer in missing:
            yield renderer, missing[renderer]
            continue
        try:
            worker = stack.enter_context(working(renderer, scene, args))
            folder = cell_folder(renderer, text, worker.version, args)
            spp = reference_spp(worker, folder, args)
            say(f"{name}, {renderer} {worker.version}: reference of 2 x {spp} spp")
            first, second = (kept(worker, folder, spp, seed)[0] for seed in REFERENCE_SEEDS)
            yield renderer, Cell(worker, folder, spp, (first, second))
        except RuntimeError as error:
            yield renderer, str(error)


def measure(name: str, args: argparse.Namespace, missing: dict[str, str]) -> dict[str, Row]:
    """Measure one scene with every renderer; one that cannot run has its reason instead."""
    rows: dict[str, Row] = {}
    with ExitStack() as stack:
        cells: dict[str, Cell] = {}
        for renderer, cell in open_cells(stack, name, args, missing):
            if isinstance(cell, str):
                say(f"{name}, {renderer}: not run: {cell}")
                rows[renderer] = {"not_run": cell}
            else:
                cells[renderer] = cell
        for number in range(args.runs):
            say(f"{name}: round {number + 1} of {args.runs}")
            order = list(cells) if number % 2 == 0 else list(cells)[::-1]
            for renderer in order:
                cell = cells[renderer]
                try:
                    made = kept(cell.worker, cell.folder, args.spp, FIRST_SEED + number)
                    cell.runs.append(made)
                except RuntimeError as error:
                    rows[renderer] = {"not_run": str(error)}
                    del cells[renderer]
        for renderer, cell in cells.items():
            row = summary(cell.runs, cell.halves, args.size)
            versions = {"version": cell.worker.version, "reference_spp": 2 * cell.reference_spp}
            rows[renderer] = {**versions, **row}
    return {renderer: rows[renderer] for renderer in args.renderers}


def agreement(scene: str, renderer: str, cells: dict[str, Row]) -> str:
    """Return how far a peer's converged mean is from matiere's, in percent and standard errors."""
    ours, theirs = cells.get("matiere", {}), cells[renderer]
    if renderer not in PEERS or "mean" not in ours:
        return ""
    apart = theirs["mean"] - ours["mean"]
    text = f"{100 * apart / ours['mean']:+.2f} %"
    if renderer not in SAME_MODEL[scene]:
        return f"{text}, other model"
    deviations = apart / np.hypot(theirs["mean_error"], ours["mean_error"])
    verdict = "agrees" if abs(deviations) <= 3 else "**differs**"
    return f"{text}, {deviations:+.1f} s.e., {verdict}"


def table_rows(scene: str, cells: dict[str, Row]) -> Iterator[str]:
    """Yield the lines of a scene in the table; the ratio is to the best peer."""
    peers = [c["efficiency"] for n, c in cells.items() if n in PEERS and "efficiency" in c]
    best = max(peers, default=None)
    for renderer, c in cells.items():
        if "not_run" in c:
            yield f"| {scene} | {renderer} | not run: {c['not_run']} | | | | | | | |"
            continue
        ratio = f"{c['efficiency'] / best:.2f}" if best else ""
        rays = f"{c['mrays_s']:.2f}" if c["mrays_s"] is not None else ""
        yield (
            f"| {scene} | {renderer} | {c['seconds']:.2f} | {c['relmse']:.3g} |"
            f" {c['efficiency']:.3g} | {ratio} | {c['msamples_s']:.2f} | {rays} |"
            f" {c['mean']:.5f} ± {c['mean_error']:.5f} ({c['reference_spp']} spp) |"
            f" {agreement(scene, renderer, cells)} |"
        )


def report(results: dict[str, Any], args: argparse.Namespace) -> None:
    """Print the Markdown table with versions, seeds and the command."""
    scenes: dict[str, dict[str, Row]] = results["scenes"]
    every = [
        (n, c["version"]) for cells in scenes.values() for n, c in cells.items() if "mean" in c
    ]
    versions = ", ".join(f"{name} {version}" for name, version in dict(every).items())
    last = FIRST_SEED + args.runs - 1
    print(
        f"{args.size} x {args.size}, {args.spp} spp, {args.threads} threads, median of {args.runs}"
        f" alternating runs, seeds {FIRST_SEED} to {last}, references"
        f" {REFERENCE_SEEDS[0]} and {REFERENCE_SEEDS[1]}. {versions}.\n{results['machine']}.\n"
        f"Command: `{results['command']}`\n"
    )
    print(
        "| scene | renderer | seconds | relMSE | 1/(relMSE s) | of the best peer's | Msamples/s |"
        " Mrays/s | converged mean | mean against matiere's |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name, cells in scenes.items():
        print("\n".join(table_rows(name, cells)))


def arguments() -> argparse.Namespace:
    """Return the options."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    names = ",".join
    parser.add_argument("--size", type=int, default=256, help="pixels on an edge")
    parser.add_argument("--spp", type=int, default=32)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--scenes", default=names(neutral.SCENES))
    parser.add_argument("--renderers", default=names(["matiere", *PEERS]))
    parser.add_argument("--reference-spp", type=int, default=2048, help="of both halves together")
    parser.add_argument(
        "--reference-seconds", type=float, default=40, help="halve a reference until it fits"
    )
    parser.add_argument("--out", type=Path, default=ROOT / "prove-out" / "peers.json")
    parser.add_argument("--python", type=Path, default=None, help="a Python that has the peers")
    parser.add_argument("--assets", type=Path, default=ROOT.parent / "shared" / "assets")
    args = parser.parse_args()
    args.scenes, args.renderers = args.scenes.split(","), args.renderers.split(",")
    for given, known in ((args.scenes, neutral.SCENES), (args.renderers, RENDERERS)):
        for name in given:
            if name not in known:
                parser.error(f"unknown name '{name}'; known: {', '.join(known)}")
    args.out = args.out.resolve()
    args.cache = args.out.with_suffix("")
    args.cache.mkdir(parents=True, exist_ok=True)
    return args


def main() -> None:
    """Measure the scenes and print the table."""
    args = arguments()
    missing: dict[str, str] = {}
    if set(args.renderers) & set(PEERS):
        args.python, missing = peers_python(args.python, ROOT / "prove-out" / "peers-venv")
    args.llvm = find_llvm()
    if args.llvm is None:
        missing["mitsuba-llvm"] = "no LLVM 16 to 19 here, and apt has no libllvm19"
    results: dict[str, Any] = {
        "command": shlex.join(["python", "tests/bench/peers.py", *sys.argv[1:]]),
        "machine": f"{machine()}, LLVM {args.llvm and args.llvm.name}",
        "settings": {key: str(value) for key, value in vars(args).items()},
        "scenes": {},
    }
    for name in args.scenes:
        try:
            results["scenes"][name] = measure(name, args, missing)
        except FileNotFoundError as error:
            results["scenes"][name] = {r: {"not_run": str(error)} for r in args.renderers}
        args.out.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    report(results, args)


def machine() -> str:
    """Return the processor, the cores and the system."""
    cpu = next(
        (
            line.split(":")[1].strip()
            for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
            if line.startswith("model name")
        ),
        platform.machine(),
    )
    return f"{cpu}, {os.cpu_count()} CPUs, {platform.platform(terse=True)}"


if __name__ == "__main__":
    main()
