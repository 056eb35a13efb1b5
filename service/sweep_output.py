"""The folder a sweep writes: a report, contact sheets, each cell's files, a table, a plot.

index.html          the report: opens in a browser without a server
contact-sheet.png   all cells, labelled; contact-sheet-002.png ... of more than 400
table.csv           one row per cell: parameters, state, samples, error, seconds, files
table.parquet       the same, if asked for
error-vs-time.svg   error against render time of all cells
cells/0003_gold_0.1.{png,exr,json,svg}
.matiere-sweep.json which sweep this folder belongs to, and which cells are here already
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matiere.jobs.sheet import PAGE_CELLS, pages
from matiere.service.client import Client, FileKind, JobStatus, SweepStatus
from matiere.service.sweep_page import Page, html_of
from matiere.service.sweep_table import Row, csv_text, rows_of, write_parquet

STATE_FILE = ".matiere-sweep.json"
STATE_VERSION = 1
PLOT = "error-vs-time.svg"
SHEET = "contact-sheet.png"
CELL_FILES: dict[str, FileKind] = {
    ".png": "image.png",
    ".exr": "image.exr",
    ".json": "report.json",
    ".svg": "error.svg",
}
DIFFERENCE = ".difference.png"  # from the baseline; only when asked for
KEPT = ("log", "image", "kernel", "seeds", "adaptive")  # of a report
PERIOD_S = 1.0  # between two writings of the state file
_OURS = re.compile(r"(cells/)?[A-Za-z0-9+_-][A-Za-z0-9.+_-]*")  # what we may remove again
_PAGE = re.compile(r"contact-sheet-\d+\.png")
_NOT_IN_A_NAME = re.compile(r"[^A-Za-z0-9_.+-]+")


class OutputFolder:
    """Fetches the cells of one sweep into a folder, each once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.sweep_id: str | None = None
        self.digest: str | None = None
        self._fetched: dict[str, str] = {}  # cell index -> job id
        self._files: dict[str, None] = {}  # written by us, relative to the folder, in order
        self._saved = 0.0
        self._read_state()

    def _read_state(self) -> None:
        try:
            state = json.loads((self.folder / STATE_FILE).read_text(encoding="utf-8"))
            if state["version"] != STATE_VERSION:
                return
            self.sweep_id, self.digest = state["sweep"], state["digest"]
            self._fetched = dict(state["fetched"])
            self._files = {name: None for name in state["files"] if _OURS.fullmatch(name)}
        except (OSError, ValueError, KeyError, TypeError):
            return

    def begin(self, sweep_id: str, digest: str) -> None:
        """Bind the folder to a sweep; files of another sweep written here before are removed."""
        if digest != self.digest:
            for name in self._files:
                (self.folder / name).unlink(missing_ok=True)
            self._fetched, self._files = {}, {}
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
            "files": list(self._files),
        }
        self._write(STATE_FILE, json.dumps(state, indent=1) + "\n", ours=False)

    def has(self, job: JobStatus, endings: Sequence[str] = tuple(CELL_FILES)) -> bool:
        """Tell whether the files of a cell are here."""
        return self._fetched.get(str(job.cell)) == job.id and all(
            (self.folder / name).exists() for name in self.names(job, endings)
        )

    def names(self, job: JobStatus, endings: Sequence[str] = tuple(CELL_FILES)) -> list[str]:
        """Return the file names of a cell, relative to the folder."""
        stem = f"{job.cell:04}_{_slug(job.label)}".rstrip("_")
        return [f"cells/{stem}{ending}" for ending in endings]

    def fetch(
        self, client: Client, job: JobStatus, endings: Sequence[str] = tuple(CELL_FILES)
    ) -> None:
        """Write the files of a finished cell that are not here yet."""
        links = "".join(job.links.values())
        same = self._fetched.get(str(job.cell)) == job.id
        for name, ending in zip(self.names(job, endings), endings, strict=True):
            kind = CELL_FILES[ending]
            if f"/{_last(kind)}" in links and not (same and (self.folder / name).exists()):
                client.fetch(job.id, kind, self.folder / name)
                self._note(name)
        if not same:  # files of an older job of this cell are none of it
            for name in set(self.names(job, (*CELL_FILES, DIFFERENCE))) - set(
                self.names(job, endings)
            ):
                (self.folder / name).unlink(missing_ok=True)
                self._files.pop(name, None)
        self._fetched[str(job.cell)] = job.id
        if time.monotonic() - self._saved > PERIOD_S:
            self.save_state()
            self._saved = time.monotonic()

    def fetch_difference(self, client: Client, job: JobStatus) -> None:
        """Write how a cell differs from the baseline, if that is not here yet."""
        (name,) = self.names(job, (DIFFERENCE,))
        if self._fetched.get(str(job.cell)) != job.id:
            self.fetch(client, job, ())
        if not (self.folder / name).exists():
            client.fetch_difference(self.sweep_id or "", job.cell or 0, self.folder / name)
            self._note(name)

    def here(self, job: JobStatus) -> dict[str, str]:
        """Return the cell's files that are here: ending -> name relative to the folder."""
        if self._fetched.get(str(job.cell)) != job.id:
            return {}
        endings = (*CELL_FILES, DIFFERENCE)
        named = zip(endings, self.names(job, endings), strict=True)
        return {ending: name for ending, name in named if (self.folder / name).exists()}

    def finish(
        self,
        client: Client,
        sweep: SweepStatus,
        jobs: list[JobStatus],
        *,
        parquet: bool = False,
        stability: Mapping[int, str] | None = None,
    ) -> list[Path]:
        """Write report, sheets, tables and plot; return the paths worth printing."""
        files = {job.cell: self.here(job) for job in jobs if job.cell is not None}
        reports = {cell: r for cell, mine in files.items() if (r := self._report(mine))}
        images = {cell: mine[".png"] for cell, mine in files.items() if ".png" in mine}
        rows = rows_of(sweep, jobs, reports, images, stability or {})
        tables = self._write_tables(rows, parquet)
        sheets = self._write_sheets(client, sweep, jobs, images)
        plot = self._write_plot(jobs, reports)
        page = Page(
            title=sweep.label or f"Sweep of {sweep.cells} cells",
            cells=sweep.cells,
            baseline=sweep.baseline,
            sheets=sheets,
            plot=plot,
            tables=tables,
            budget=sweep.budget,
            files={cell: mine for cell, mine in files.items() if mine},
        )
        self._write("index.html", html_of(page, rows))
        self.save_state()
        first = [*sheets[:1], *tables, *([plot] if plot else [])]
        more = [self.folder / "cells"] if images else []
        return [self.folder / "index.html", *(self.folder / name for name in first), *more]

    def _report(self, files: Mapping[str, str]) -> dict[str, Any] | None:
        """Return what the outputs need of a cell's report, if that is here and whole."""
        if ".json" not in files:
            return None
        with contextlib.suppress(OSError, ValueError):
            report = json.loads((self.folder / files[".json"]).read_text(encoding="utf-8"))
            return {key: report[key] for key in KEPT if key in report}
        return None

    def _write_tables(self, rows: Sequence[Row], parquet: bool) -> list[str]:
        self._write("table.csv", csv_text(rows))
        if not parquet:
            return ["table.csv"]
        part = self.folder / f".table.parquet.{os.getpid()}.part"
        write_parquet(part, rows)
        part.replace(self.folder / "table.parquet")
        self._note("table.parquet")
        return ["table.csv", "table.parquet"]

    def _write_sheets(
        self,
        client: Client,
        sweep: SweepStatus,
        jobs: Sequence[JobStatus],
        images: Mapping[int, str],
    ) -> list[str]:
        """Write the contact sheet: the service's, or of a larger sweep pages of what is here."""
        if not any(job.rendered for job in jobs):
            return []
        if sweep.cells <= PAGE_CELLS and sweep.ended:
            client.fetch_contact_sheet(sweep.id, self.folder / SHEET)
            self._note(SHEET)
            return [SHEET]
        shown = [j for j in jobs if j.cell in images or (images and not j.rendered)]
        if not any(j.cell in images for j in shown):
            return []
        from matiere.jobs.sheet import draw

        split, columns = pages(len(shown), sweep.columns)
        names = []
        for number, cells in enumerate(split, 1):
            name = SHEET if number == 1 else f"contact-sheet-{number:03}.png"
            which = f"page {number} of {len(split)}"
            request = {
                "title": sweep.label or f"Sweep of {sweep.cells} cells",
                "subtitle": f"{which}: {len(shown):,} of {sweep.cells:,} cells",
                "columns": columns,
                "mode": sweep.mode,
                "axes": sweep.axes,
                "first": cells.start,
                "cells_of_sweep": len(shown),
            }
            sheet = draw([_cell_of(shown[i], self.folder, images) for i in cells], request)
            self._write(name, sheet)
            names.append(name)
        for old in [n for n in self._files if _PAGE.fullmatch(n) and n not in names]:
            (self.folder / old).unlink(missing_ok=True)
            del self._files[old]
        return names

    def _write_plot(
        self, jobs: Sequence[JobStatus], reports: Mapping[int, Mapping[str, Any]]
    ) -> str | None:
        """Draw error against render time; a cell without its report is the point where it ended."""
        from matiere.plot import error_plot

        curves = []
        for job in jobs:
            if job.rendered:
                report = reports.get(-1 if job.cell is None else job.cell, {})
                curves.append((job.label or str(job.cell), report.get("log") or _end_of(job)))
        with contextlib.suppress(ValueError):  # no cell knows its error: nothing to draw
            self._write(PLOT, error_plot(curves, "error against render time"))
            return PLOT
        return None

    def _note(self, name: str) -> None:
        self._files[name] = None

    def _write(self, name: str, content: str | bytes, *, ours: bool = True) -> None:
        part = self.folder / f".{name}.{os.getpid()}.part"
        part.write_bytes(content.encode() if isinstance(content, str) else content)
        part.replace(self.folder / name)
        if ours:
            self._note(name)


def _last(kind: str) -> str:
    return {"report.json": "report", "error.svg": "error-plot.svg"}.get(kind, kind)


def _slug(text: str) -> str:
    return _NOT_IN_A_NAME.sub("-", text.replace(", ", "_")).strip("-.")[:80]


def _end_of(job: JobStatus) -> list[dict[str, float | None]]:
    low, high = job.relmse_interval or (None, None)
    return [{"wall_s": job.seconds, "relmse": job.relmse, "lower": low, "upper": high}]


def _cell_of(job: JobStatus, folder: Path, images: Mapping[int, str]) -> dict[str, Any]:
    image = images.get(-1 if job.cell is None else job.cell)
    return {
        "image": str(folder / image) if image else None,
        "label": job.label,
        "state": job.state,
        "spp": job.spp,
        "seconds": job.seconds,
        "relmse": job.relmse,
        "interval": job.relmse_interval,
    }
