"""The summary of a demo run: a table, the error against time, an HTML page and JSON."""

from __future__ import annotations

import html
import json
import os
import re
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from demo_sweep import MATERIALS, ROUGHNESS, Study

from matiere.service.client import JobStatus

ROWS = len(ROUGHNESS)
COLORS = ("#b8860b", "#b5532a", "#6b7280", "#c0262d", "#12868c", "#2f8f46")
STYLE = """body{font:15px/1.5 system-ui,sans-serif;margin:2rem auto;max-width:75rem;padding:0 1rem;
background:#1b1c1f;color:#e4e4e0}img{max-width:100%}a{color:#8ec5ff}table{border-collapse:collapse}
td,th{padding:.25rem .7rem;text-align:right;border-bottom:1px solid #383a40}td:first-child,
th:first-child{text-align:left}.note{color:#a9abb0}img.plot{background:#fff;border-radius:4px}"""


@dataclass(frozen=True)
class Cell:
    """One finished cell: its job, the stem of its file names, its files and its report."""

    job: JobStatus
    stem: str
    files: Mapping[str, Path]
    report: Mapping[str, Any]

    @property
    def log(self) -> list[dict[str, Any]]:
        """Return the looks at the error while rendering."""
        return [row for row in self.report.get("log", []) if row.get("relmse")]


def slug(text: str) -> str:
    """Return a text as part of a file name."""
    return re.sub(r"[^a-z0-9.]+", "-", text.lower()).strip("-.") or "cell"


def write(study: Study, cells: Sequence[Cell], out: Path, seconds: float) -> list[Path]:
    """Write plot, JSON and HTML; return the paths to print."""
    plot = plot_error(study, cells, out / "error-against-time.svg")
    data = out / "report.json"
    data.write_text(json.dumps(summary(study, cells, seconds), indent=1) + "\n", encoding="utf-8")
    page = out / "report.html"
    page.write_text(to_html(study, cells, out, seconds), encoding="utf-8")
    sheet = out / "contact-sheet.png"
    return [path for path in (sheet, plot, page, data, out / "cells") if path.exists()]


def summary(study: Study, cells: Sequence[Cell], seconds: float) -> dict[str, Any]:
    """Return the JSON summary: what was asked, what came out, how long it took."""
    return {
        "title": study.title,
        "scene": study.base,
        "wall_seconds": round(seconds, 3),
        "render_seconds": round(sum(cell.job.seconds for cell in cells), 3),
        "cells": [
            {
                "cell": cell.job.cell,
                "label": cell.job.label,
                "state": cell.job.state,
                "from_store": cell.job.cached,
                "spp": cell.job.spp,
                "seconds": cell.job.seconds,
                "relmse": cell.job.relmse,
                "relmse_interval": cell.job.relmse_interval,
                "stop_reason": cell.job.stop_reason,
                "files": {kind: path.name for kind, path in cell.files.items()},
                "error": cell.job.error,
            }
            for cell in cells
        ],
    }


def plot_error(study: Study, cells: Sequence[Cell], path: Path) -> Path:
    """Plot the estimated error of every cell against render seconds, one colour a material."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 5.5), layout="constrained")
    axes = figure.add_subplot()
    for cell in cells:
        column = (cell.job.cell or 0) % len(MATERIALS)
        row = (cell.job.cell or 0) // len(MATERIALS)
        rows = [(look[seconds_key(look)], look) for look in cell.log]
        if not rows:
            continue
        x = [seconds for seconds, _ in rows]
        axes.plot(
            x,
            [look["relmse"] for _, look in rows],
            color=COLORS[column],
            alpha=0.4 + 0.2 * row,
            linewidth=1.2,
            marker=".",
            markersize=3,
            label=MATERIALS[column][0] if row == ROWS - 1 else None,
        )
    guide(axes, cells)
    axes.set(xscale="log", yscale="log", title=f"{study.title}: error against render time")
    axes.set_xlabel("render time of the cell [s]")
    axes.set_ylabel("estimated relMSE of the image")
    axes.grid(True, which="both", linewidth=0.3, alpha=0.6)
    axes.legend(title="pale to strong: smooth to rough", fontsize=8, title_fontsize=8)
    figure.savefig(path, metadata={"Date": None})
    return path


def seconds_key(look: Mapping[str, Any]) -> str:
    """Return the name of a log row's time."""
    return "seconds" if "seconds" in look else "wall_s"


def guide(axes: Any, cells: Sequence[Cell]) -> None:
    """Draw the slope that independent samples give: error falls as 1 / time."""
    looks = [look for cell in cells for look in cell.log]
    if len(looks) < 2:
        return
    low = min(look[seconds_key(look)] for look in looks)
    high = max(look[seconds_key(look)] for look in looks)
    top = statistics.median(cell.log[0]["relmse"] for cell in cells if cell.log)
    if low > 0:
        axes.plot([low, high], [top, top * low / high], "k--", linewidth=0.8, label="1 / time")


def to_html(study: Study, cells: Sequence[Cell], out: Path, seconds: float) -> str:
    """Return a page that shows everything with relative links."""
    rows = "\n".join(table_row(cell, out) for cell in cells)
    rendered = sum(cell.job.seconds for cell in cells)
    cached = sum(cell.job.cached for cell in cells)
    note = f"{len(cells)} cells in {seconds:.1f} s, {rendered:.1f} s of rendering" + (
        f", {cached} from the store" if cached else ""
    )
    return f"""<!doctype html><html lang="en"><meta charset="utf-8">
<title>{html.escape(study.title)}</title><style>{STYLE}</style>
<h1>{html.escape(study.title)}</h1><p class="note">{note}</p>
<img src="contact-sheet.png" alt="contact sheet">
<h2>Error against time</h2>
<p>relMSE is the relative mean squared error of the whole image as the renderer estimates it from
its own replicates; the interval holds the true one 95 times of 100.</p>
<img class="plot" src="error-against-time.svg" alt="error against time">
<h2>Cells</h2>
<table><tr><th>cell<th>relMSE<th>95 % interval<th>spp<th>seconds<th>ended by<th>files</tr>
{rows}
</table></html>
"""


def table_row(cell: Cell, out: Path) -> str:
    """Return one line of the table."""
    job = cell.job
    links = " ".join(
        f'<a href="{html.escape(os.path.relpath(path, out))}">{kind}</a>'
        for kind, path in cell.files.items()
    )
    interval = job.relmse_interval
    values = (
        html.escape(job.label),
        "unknown" if job.relmse is None else f"{job.relmse:.2e}",
        "unknown" if interval is None else f"{interval[0]:.2e} to {interval[1]:.2e}",
        str(job.spp),
        f"{job.seconds:.2f}",
        html.escape(job.stop_reason or job.state),
    )
    return "<tr>" + "".join(f"<td>{value}" for value in values) + f"<td>{links}</tr>"
