"""Render the sample sweep through the service: `./dev demo`.

Starts `matiere serve` on a free loopback port, submits a sweep of 24 materials over HTTP, shows how
far it is, and leaves in ./demo-out a contact sheet, every cell's images and reports, the error
against time, and a summary.  Run it again and finished cells come from the store at once.

    ./dev demo                             our own shader ball and studio light
    ./dev demo --assets ../shared/assets   well-known shader balls under real HDR maps
"""

from __future__ import annotations

import argparse
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import demo_report
import demo_sweep
from demo_report import Cell
from demo_sweep import Study
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from matiere.errors import MatiereError
from matiere.service.client import Client, JobStatus
from matiere.service.lockfile import read_announcement

START_TIMEOUT_S = 180.0
STOP_TIMEOUT_S = 30.0
POLL_S = 0.5
LINE_EVERY_S = 10.0  # without a terminal: one line of progress
COLUMNS = len(demo_sweep.MATERIALS)
FILES = ("image.png", "image.exr", "report.json", "error.svg")


@dataclass(frozen=True)
class Options:
    """What the command line asks for."""

    out: Path
    assets: Path | None
    only: str
    size: int
    spp: int
    children: int | None
    fresh: bool


def parse(arguments: Sequence[str] | None = None) -> Options:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="./dev demo", description="Render the sample sweep.")
    parser.add_argument("--out", type=Path, default=Path("demo-out"), help="folder of the results")
    parser.add_argument("--assets", type=Path, help="folder with real balls and HDR maps")
    parser.add_argument("--only", default="", help="with --assets: sweeps whose name has this word")
    parser.add_argument("--size", type=int, default=192, help="pixels on an edge of a cell")
    parser.add_argument("--spp", type=int, default=64, help="samples per pixel (glass takes more)")
    parser.add_argument("--children", type=int, help="render processes (default: one per core)")
    parser.add_argument("--fresh", action="store_true", help="forget the results of earlier runs")
    return Options(**vars(parser.parse_args(arguments)))


@contextmanager
def service(data: Path, log: Path, children: int | None) -> Iterator[Client]:
    """Run `matiere serve` on a free port for the length of a `with` block."""
    command = [sys.executable, "-m", "matiere.service", "serve", "--port", "0", "--data", str(data)]
    if children is not None:
        command += ["--children", str(children)]
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
    try:
        yield Client(wait_until_ready(process, data, log))
    finally:
        stop(process)


def wait_until_ready(process: subprocess.Popen[bytes], data: Path, log: Path) -> str:
    """Return the URL once the service answers; leave with its own words if it ended instead."""
    deadline = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < deadline:
        if process.poll() is not None:
            said = log.read_text(encoding="utf-8", errors="replace").strip()
            raise SystemExit(f"`matiere serve` ended with code {process.returncode}:\n{said}")
        found = read_announcement(data)
        if found is not None and found.pid == process.pid:
            with Client(found.url, patience_s=1.0) as client:
                if client.ready():
                    return found.url
        time.sleep(0.1)
    raise SystemExit(f"`matiere serve` was not ready after {START_TIMEOUT_S:.0f} s; see {log}")


def stop(process: subprocess.Popen[bytes]) -> None:
    """End the service politely, or at once if it does not."""
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
    try:
        process.wait(STOP_TIMEOUT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def run(client: Client, study: Study, out: Path, spp: int, console: Console) -> list[Cell]:
    """Submit one study, wait for it, fetch all its files; return its cells in order."""
    axes = demo_sweep.axes(spp, study.glass_file)
    demo_sweep.write_json(study.folder / f"{study.name}-base.json", study.base)
    shape = {"mode": "zip", "columns": COLUMNS, "label": study.title}
    document = {"version": 1, "base": f"{study.name}-base.json", "axes": axes, **shape}
    demo_sweep.write_json(study.folder / f"{study.name}-sweep.json", document)
    status = client.submit_sweep(
        study.base,
        axes,
        mode="zip",
        columns=COLUMNS,
        label=study.title,
        asset_root=study.folder,
    )
    jobs = watch(client, status.id, study.title, console)
    shutil.rmtree(out / "cells", ignore_errors=True)
    cells = [fetch(client, job, out / "cells") for job in jobs]
    if all(cell.job.state == "succeeded" for cell in cells):
        client.fetch_contact_sheet(status.id, out / "contact-sheet.png")
    return cells


def samples(jobs: Sequence[JobStatus]) -> tuple[int, int]:
    """Return pixel samples merged so far and asked for, over all jobs."""
    done = total = 0
    for job in jobs:
        pixels = job.width * job.height
        asked = max(int(job.stop.get("spp") or job.spp), job.spp)
        total += pixels * asked
        done += pixels * (asked if job.ended else min(job.spp, asked))
    return done, total


def watch(client: Client, sweep_id: str, title: str, console: Console) -> list[JobStatus]:
    """Show progress in samples until every cell has ended."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.fields[cells]} cells"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        task = bar.add_task(title, cells="0")
        line = time.monotonic()
        while True:
            jobs = list(client.jobs(sweep=sweep_id))
            done, total = samples(jobs)
            ended = sum(job.ended for job in jobs)
            show(bar, task, done, total, f"{ended}/{len(jobs)}")
            if ended == len(jobs):
                return jobs
            if not console.is_terminal and time.monotonic() - line > LINE_EVERY_S:
                line = time.monotonic()
                console.print(f"{100 * done / total:3.0f} %  {ended} of {len(jobs)} cells")
            time.sleep(POLL_S)


def show(bar: Progress, task: TaskID, done: int, total: int, cells: str) -> None:
    """Update the bar."""
    bar.update(task, completed=done, total=total, cells=cells)


def fetch(client: Client, job: JobStatus, folder: Path) -> Cell:
    """Write a cell's files, named after its number and its label."""
    words = demo_report.slug(job.label or str(job.parameters.get("material", "")))
    stem = f"{(job.cell or 0) + 1:02d}-{words}"
    files = {}
    if job.state == "succeeded":
        for kind in FILES:
            name = f"{stem}{'' if kind.startswith('image') else '-' + kind.split('.')[0]}"
            target = folder / f"{name}.{kind.rsplit('.', 1)[1]}"
            files[kind] = client.fetch(job.id, kind, target)
    report = client.report(job.id) if files else {}
    return Cell(job, stem, files, report)


def studies(options: Options) -> list[Study]:
    """Make the scene files and return the sweeps to run."""
    folder = options.out / "scene"
    if options.assets is None:
        return [demo_sweep.own_study(folder, options.size, options.spp)]
    found = demo_sweep.asset_studies(options.assets, folder, options.size, options.spp)
    chosen = [study for study in found if options.only in study.name]
    if not chosen:
        names = ", ".join(study.name for study in found)
        raise SystemExit(f"no sweep has {options.only!r} in its name; there are {names}")
    return chosen


def main() -> int:
    """Run the demo; exit code 1 if any cell did not succeed."""
    options = parse()
    console = Console()
    begin = time.monotonic()
    data = options.out / "data"
    if options.fresh and data.exists():
        shutil.rmtree(data)
    options.out.mkdir(parents=True, exist_ok=True)
    todo = studies(options)
    console.print(f"shader ball and light ready after {time.monotonic() - begin:.1f} s")
    failed = 0
    with service(data, options.out / "serve.log", options.children) as client:
        console.print(f"service at {client.url}, log in {options.out / 'serve.log'}")
        for study in todo:
            start = time.monotonic()
            out = options.out if len(todo) == 1 else options.out / study.name
            cells = run(client, study, out, options.spp, console)
            paths = demo_report.write(study, cells, out, time.monotonic() - start)
            failed += tell(console, study, cells, paths, time.monotonic() - start)
    console.print(f"total {time.monotonic() - begin:.1f} s")
    return 1 if failed else 0


def tell(
    console: Console, study: Study, cells: Sequence[Cell], paths: Sequence[Path], seconds: float
) -> int:
    """Print what came out of a study; return the number of cells without an image."""
    bad = [cell for cell in cells if cell.job.state != "succeeded"]
    for cell in bad:
        error = cell.job.error or {}
        console.print(f"[red]{cell.stem}: {cell.job.state} {error.get('message', '')}")
    cached = sum(cell.job.cached for cell in cells)
    console.print(
        f"{study.title}: {len(cells) - len(bad)} of {len(cells)} cells in {seconds:.1f} s"
        + (f" ({cached} from the store)" if cached else "")
    )
    for path in paths:
        console.print(f"  {path}", soft_wrap=True)
    return len(bad)


def leave(_number: int, _frame: object) -> None:
    """End on SIGTERM as on Ctrl-C, so that the service is stopped too."""
    raise KeyboardInterrupt


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, leave)
    try:
        sys.exit(main())
    except MatiereError as problem:
        sys.exit(f"error: {problem}")
    except KeyboardInterrupt:
        sys.exit("interrupted; run ./dev demo again to go on")
