"""The folder a sweep writes: contact sheet, each cell's files, a table, error against time.

contact-sheet.png   all cells, labelled
table.csv           one row per cell: parameters, state, samples, error, seconds, files
error-vs-time.svg   one curve per cell
cells/0003_gold_0.1.{png,exr,json,svg}
.matiere-sweep.json which sweep this folder belongs to, and which cells are here already
"""

from __future__ import annotations

import contextlib
import csv
import json
import os
import re
from pathlib import Path

from matiere.service.client import Client, JobStatus, SweepStatus

STATE_FILE = ".matiere-sweep.json"
STATE_VERSION = 1
PLOT = "error-vs-time.svg"
CELL_FILES = {
    ".png": "image.png",
    ".exr": "image.exr",
    ".json": "report.json",
    ".svg": "error.svg",
}
MAX_CURVES = 200  # beyond that a plot is a black patch
_OURS = re.compile(r"(cells/)?[A-Za-z0-9+_-][A-Za-z0-9.+_-]*")  # what we may remove again
_NOT_IN_A_NAME = re.compile(r"[^A-Za-z0-9_.+-]+")


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
            self._fetched = dict(state["fetched"])
            self._files = [name for name in state["files"] if _OURS.fullmatch(name)]
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
        """Write the state file, whole or not at all."""
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
        stem = f"{job.cell:04}_{_slug(job.label)}".rstrip("_")
        return [f"cells/{stem}{ending}" for ending in CELL_FILES]

    def fetch(self, client: Client, job: JobStatus) -> None:
        """Write the files of a finished cell."""
        for name, kind in zip(self.names(job), CELL_FILES.values(), strict=True):
            if f"/{_last(kind)}" in "".join(job.links.values()):
                client.fetch(job.id, kind, self.folder / name)
                self._note(name)
        self._fetched[str(job.cell)] = job.id
        self.save_state()

    def finish(self, client: Client, sweep: SweepStatus, jobs: list[JobStatus]) -> list[Path]:
        """Write contact sheet, table and plot; return the paths worth printing."""
        self.write_table(sweep, jobs)
        written = [self.folder / "table.csv"]
        done = [job for job in jobs if job.state == "succeeded"]
        if done:
            sheet = self.folder / "contact-sheet.png"
            client.fetch_contact_sheet(sweep.id, sheet)
            self._note(sheet.name)
            written.insert(0, sheet)
            self.write_plot(done)
            if PLOT in self._files:
                written.append(self.folder / PLOT)
        self.save_state()
        return [*written, self.folder / "cells"]

    def write_table(self, sweep: SweepStatus, rows: list[JobStatus]) -> None:
        """Write one CSV row per cell."""
        labels = list(dict.fromkeys(label for job in rows for label in job.parameters))
        texts = {
            (axis["label"], _key(value)): text
            for axis in sweep.axes
            for value, text in zip(axis.get("values", ()), axis.get("labels", ()), strict=True)
        }
        part = self.folder / f".table.{os.getpid()}.part"
        with part.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(
                ["cell", *labels, "state", "spp", "seconds", "relmse", "relmse_low",
                 "relmse_high", "stop_reason", "cached", "image", "job", "error"]
            )  # fmt: skip
            for job in rows:
                low, high = job.relmse_interval or ("", "")
                values = [_cell_text(texts, label, job.parameters.get(label)) for label in labels]
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
        from matiere.plot import error_plot

        curves = []
        for job in jobs[:MAX_CURVES]:
            report = json.loads((self.folder / self.names(job)[2]).read_text(encoding="utf-8"))
            curves.append((job.label or str(job.cell), report["log"]))
        with contextlib.suppress(ValueError):  # no cell knows its error: nothing to draw
            self._write(PLOT, error_plot(curves, "error against render time"))

    def _note(self, name: str) -> None:
        if name not in self._files:
            self._files.append(name)

    def _write(self, name: str, text: str, *, ours: bool = True) -> None:
        part = self.folder / f".{name}.{os.getpid()}.part"
        part.write_text(text, encoding="utf-8")
        part.replace(self.folder / name)
        if ours:
            self._note(name)


def _last(kind: str) -> str:
    return {"report.json": "report", "error.svg": "error-plot.svg"}.get(kind, kind)


def _slug(text: str) -> str:
    return _NOT_IN_A_NAME.sub("-", text.replace(", ", "_")).strip("-.")[:80]


def _key(value: object) -> str:
    return json.dumps(value, sort_keys=True)


def _cell_text(texts: dict[tuple[str, str], str], label: str, value: object) -> str:
    """Return a parameter for the table: numbers and names in full, the rest by their label."""
    if value is None or isinstance(value, str):
        return value or ""
    if isinstance(value, bool | int | float):
        return json.dumps(value)
    return texts.get((label, _key(value)), _key(value))
