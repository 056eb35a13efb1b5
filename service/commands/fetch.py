"""`matiere fetch`: bring files of a job or of some cells of a sweep from the store."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def fetch(
    what: Annotated[
        str, typer.Argument(help="Folder that `matiere sweep` wrote, or the id of a sweep or job.")
    ],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Folder for the files (default: that of the sweep)."),
    ] = None,
    where: Annotated[
        list[str] | None,
        typer.Option(
            help="Only cells for which this holds: axis labels, cell, spp, seconds, relmse;"
            " as in docs/sweep.md. Can be given more than once."
        ),
    ] = None,
    cells: Annotated[
        str | None, typer.Option(help="Only these cells: 7, 10-19, or both with commas.")
    ] = None,
    kind: Annotated[
        list[str] | None,
        typer.Option(
            help="png, exr, json, svg, or difference (from the baseline of a sweep);"
            " can be given more than once (default: the first four)."
        ),
    ] = None,
    parquet: Annotated[bool, typer.Option("--parquet", help="Write table.parquet too.")] = False,
    url: Annotated[
        str | None, typer.Option(help="The service (default: the one of the data directory).")
    ] = None,
    data: Annotated[Path | None, typer.Option(help="Data directory.")] = None,
) -> None:
    """Bring files of a job, or of chosen cells of a sweep; images not made yet are made now.

    Example: matiere fetch out --where "relmse > 0.01 and metal == 'Au'" --kind png
    """
    from matiere.service.fetch_run import run_fetch

    failed = run_fetch(
        what,
        output,
        where=where or [],
        cells=cells,
        kinds=kind or [],
        parquet=parquet,
        url=url,
        data=data,
    )
    if failed:
        raise typer.Exit(1)
