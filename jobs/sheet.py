"""The contact sheet of a sweep: captions, headers, and pages where one sheet cannot show all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matiere.jobs.job import RENDERED

INTERVAL = "95 %"
PAGE_CELLS = 400  # more are no longer seen at a glance
MOST_COLUMNS = 25
PAGE_COLUMNS = 20  # where the sweep suggests none, or too many


def pages(cells: int, columns: int) -> tuple[list[range], int]:
    """Return the cells of every page, in whole rows, and the columns of a page."""
    columns = columns if columns <= MOST_COLUMNS else PAGE_COLUMNS
    most = PAGE_CELLS // columns * columns
    return [range(i, min(i + most, cells)) for i in range(0, cells, most)], columns


def draw(cells: Sequence[Mapping[str, Any]], request: Mapping[str, Any]) -> bytes:
    """Return a contact sheet as PNG bytes.

    A cell has `image` (a path or None), `label`, `state`, `spp`, `seconds`, `relmse`, `interval`.
    `request` has `title`, `columns`, `mode` and `axes` of the sweep, of which `cells` are those
    from number `first` (0) on.
    """
    from matiere import contact_sheet

    columns, rows = _heads(len(cells), request)
    shown = [{"image": c["image"], "label": c["label"], "sublabel": caption(c)} for c in cells]
    return contact_sheet.make(
        shown,
        request["columns"],
        request["title"] or f"Sweep of {len(cells)} cells",
        legend=f"relMSE: estimated relative mean squared error with its {INTERVAL} interval",
        subtitle=request.get("subtitle", ""),
        column_headers=columns,
        row_headers=rows,
    )


def caption(cell: Mapping[str, Any]) -> str:
    """Return how a cell ended, in two lines."""
    if cell["state"] not in RENDERED or not cell["spp"]:
        return str(cell["state"])
    error = "relMSE unknown"
    if cell["relmse"] is not None:
        error = f"relMSE {cell['relmse']:.2g}"
        if cell["interval"]:
            error += f" ({cell['interval'][0]:.2g} to {cell['interval'][1]:.2g})"
    seconds = cell["seconds"]
    mark = "unfinished: " if cell["state"] == "unfinished" else ""
    return f"{mark}{error}\n{cell['spp']} spp, {seconds:.{1 if seconds < 10 else 0}f} s"


def _heads(cells: int, request: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    """Return headers of columns and rows of a grid of two axes, of which whole rows are shown."""
    axes, columns, first = request["axes"], request["columns"], request.get("first", 0)
    if request["mode"] != "grid" or len(axes) != 2 or columns != len(axes[1]["values"]):
        return [], []
    rows, across = axes
    if request.get("cells_of_sweep", cells) != columns * len(rows["values"]):
        return [], []  # conditions left cells out
    of_page = rows["labels"][first // columns : (first + cells) // columns]
    return (
        [f"{across['label']} {text}" for text in across["labels"]],
        [f"{rows['label']} {text}" for text in of_page],
    )
