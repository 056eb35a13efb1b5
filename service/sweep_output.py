"""The folder a sweep writes: contact sheet, each cell's files, a table, error against time.

sweep.json          which sweep this folder belongs to, and which cells are here already
contact-sheet.png   all cells, labelled
table.csv           one row per cell: parameters, state, samples, error, seconds, files
error-vs-time.svg   one curve per cell
cells/0003_gold_0.1.{png,exr,json,svg}
"""

from __future__ import annotations

import csv
import json
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from matiere.service.client import Client, JobStatus

STATE_FILE = "sweep.json"
STATE_VERSION = 1
CELL_FILES = {
    ".png": "image.png",
    ".exr": "image.exr",
    ".json": "report.json",
    ".svg": "error.svg",
}
MAX_CURVES = 200  # beyond that a plot is a black patch
MAX_LEGEND = 30
_NOT_IN_A_NAME = re.compile(r"[^A-Za-z0-9.+-]+")


class OutputFolder:
    """Fetches the cells of one sweep into a folder, each once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.sweep_id: str | None = None
        self.digest: str | None = None
        self._fetched: dict[str, str] = {}  # cell index -> job id
        self._files: list[str] = []  # written by us, relative to the folder
        self._read_state()

    def _read_state(self) -> None:
        try:
            state = json.loads((self.folder / STATE_FILE).read_text(encoding="utf-8"))
            if state["version"] != STATE_VERSION:
                return
            self.sweep_id, self.digest = state["sweep"], state["digest"]
            self._fetched, self._files = dict(state["fetched"]), list(state["files"])
        except (OSError, ValueError, KeyError, TypeError):
            return

    def begin(self, sweep_id: str, digest: str) -> None:
        """Bind the folder to a sweep; files of another sweep written here before are removed."""
        if digest != self.digest:
            for name in self._files:
                (self.folder / name).unlink(missing_ok=True)
            self._fetched, self._files = {}, []
        if sweep_id != self.sweep_id:
            self._fetched = {}  # other jobs: their files are written again
        self.sweep_id, self.digest = sweep_id, digest
        (self.folder / "cells").mkdir(parents=True, exist_ok=True)
        self.save_state()

    def save_state(self) -> None:
        """Write `sweep.json`, whole or not at all."""
        state = {
            "version": STATE_VERSION,
            "sweep": self.sweep_id,
            "digest": self.digest,
            "fetched": self._fetched,
            "files": self._files,
        }
        self._write(STATE_FILE, json.dumps(state, indent=1) + "\n", ours=False)

    def has(self, job: JobStatus) -> bool:
        """Tell whether the files of a cell are here."""
        return self._fetched.get(str(job.cell)) == job.id and all(
            (self.folder / name).exists() for name in self.names(job)
        )

    def names(self, job: JobStatus) -> list[str]:
        """Return the file names of a cell, relative to the folder."""
        values = "_".join(_slug(value) for value in job.parameters.values())
        stem = f"{job.cell:04}" + (f"_{values}" if values else "")
        return [f"cells/{stem[:100]}{ending}" for ending in CELL_FILES]

    def fetch(self, client: Client, job: JobStatus) -> None:
        """Write the files of a finished cell."""
        for name, kind in zip(self.names(job), CELL_FILES.values(), strict=True):
            if f"/{_last(kind)}" in "".join(job.links.values()):
                client.fetch(job.id, kind, self.folder / name)
                self._note(name)
        self._fetched[str(job.cell)] = job.id
        self.save_state()

    def finish(self, client: Client, jobs: list[JobStatus]) -> list[Path]:
        """Write contact sheet, table and plot; return the paths worth printing."""
        assert self.sweep_id is not None
        self.write_table(jobs)
        written = [self.folder / "table.csv"]
        done = [job for job in jobs if job.state == "succeeded"]
        if done:
            sheet = self.folder / "contact-sheet.png"
            client.fetch_contact_sheet(self.sweep_id, sheet)
            self._note(sheet.name)
            written.insert(0, sheet)
            self.write_plot(done)
            written.append(self.folder / "error-vs-time.svg")
        self.save_state()
        return [*written, self.folder / "cells"]

    def write_table(self, jobs: Iterable[JobStatus]) -> None:
        """Write one CSV row per cell."""
        rows = list(jobs)
        labels = list(dict.fromkeys(label for job in rows for label in job.parameters))
        part = self.folder / f".table.{os.getpid()}.part"
        with part.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(
                ["cell", *labels, "state", "spp", "seconds", "relmse", "relmse_low",
                 "relmse_high", "stop_reason", "cached", "image", "job", "error"]
            )  # fmt: skip
            for job in rows:
                low, high = job.relmse_interval or ("", "")
                values = [_text(job.parameters.get(label, "")) for label in labels]
                error = job.error["message"] if job.error else ""
                table.writerow(
                    [job.cell, *values, job.state, job.spp, f"{job.seconds:.3f}",
                     "" if job.relmse is None else job.relmse, low, high, job.stop_reason or "",
                     job.cached, self.names(job)[0], job.id, error]
                )  # fmt: skip
        part.replace(self.folder / "table.csv")
        self._note("table.csv")

    def write_plot(self, jobs: list[JobStatus]) -> None:
        """Draw error against render time, one curve per cell."""
        curves = []
        for job in jobs[:MAX_CURVES]:
            report = json.loads((self.folder / self.names(job)[2]).read_text(encoding="utf-8"))
            name = ", ".join(_text(value) for value in job.parameters.values())
            curves.append((name or str(job.cell), looks(report)))
        draw_error_plot(curves, self.folder / "error-vs-time.svg")
        self._note("error-vs-time.svg")

    def _note(self, name: str) -> None:
        if name not in self._files:
            self._files.append(name)

    def _write(self, name: str, text: str, *, ours: bool = True) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        part = self.folder / f".{name}.{os.getpid()}.part"
        part.write_text(text, encoding="utf-8")
        part.replace(self.folder / name)
        if ours:
            self._note(name)


def looks(report: dict[str, Any]) -> list[tuple[float, float, float, float]]:
    """Return (seconds, relMSE, low, high) of every look of a report at which the error is known."""
    points = []
    for row in report.get("log", []):
        relmse, seconds = row.get("relmse"), row.get("wall_s")
        if relmse and seconds:
            low, high = row.get("lower") or relmse, row.get("upper") or relmse
            points.append((float(seconds), float(relmse), float(low), float(high)))
    return points


def draw_error_plot(
    curves: list[tuple[str, list[tuple[float, float, float, float]]]], path: Path
) -> None:
    """Draw relMSE against seconds, both logarithmic, with the slope 1/time for the eye."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter

    figure = Figure(figsize=(8, 5.5), layout="constrained")
    axes = figure.add_subplot()
    for name, points in curves:
        if not points:
            continue
        seconds, error, low, high = zip(*points, strict=True)
        (line,) = axes.plot(seconds, error, marker=".", linewidth=1.0, label=name)
        if len(curves) <= 8:
            axes.fill_between(seconds, low, high, color=line.get_color(), alpha=0.15, linewidth=0)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="render time of the cell / s",
        ylabel="estimated relMSE (95 % interval shaded)"
        if len(curves) <= 8
        else "estimated relMSE",
        title="error against render time",
    )
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter(NullFormatter())
    _draw_slope(axes, [point for _, points in curves for point in points])
    axes.grid(True, which="both", linewidth=0.3)
    if axes.has_data() and len(curves) <= MAX_LEGEND:
        axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    figure.savefig(part, format=path.suffix.lstrip("."))
    part.replace(path)


def _draw_slope(axes: Any, points: list[tuple[float, float, float, float]]) -> None:
    if len(points) < 2:
        return
    first, last = min(p[0] for p in points), max(p[0] for p in points)
    if last <= first:
        return
    at = max(p[1] for p in points if p[0] == first)
    axes.plot(
        [first, last], [at, at * first / last], "k--", linewidth=0.8, label="slope of 1 / time"
    )


def _last(kind: str) -> str:
    return {"report.json": "report", "error.svg": "error-plot.svg"}.get(kind, kind)


def _slug(value: object) -> str:
    return _NOT_IN_A_NAME.sub("-", _text(value)).strip("-.")[:40]


def _text(value: object) -> str:
    if isinstance(value, str):
        return value
    if isinstance(value, float):
        return f"{value:.6g}"
    return json.dumps(value, separators=(",", ":"))
