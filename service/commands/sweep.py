"""`matiere sweep`: render every cell of a sweep file into a folder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def sweep(
    sweep_file: Annotated[Path, typer.Argument(help="Sweep file (JSON); see docs/sweep.md.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Folder for the results; made if absent.")
    ],
    url: Annotated[
        str | None, typer.Option(help="Use this service (default: the data directory's, if any).")
    ] = None,
    data: Annotated[Path | None, typer.Option(help="Data directory.")] = None,
    children: Annotated[
        int | None,
        typer.Option(help="Render processes, when no service runs (default: one per usable core)."),
    ] = None,
    fetch: Annotated[
        str,
        typer.Option(
            help="Files of cells to bring: all, images (PNG), reports (JSON), none;"
            " auto: all of up to 1,000 cells."
        ),
    ] = "auto",
    parquet: Annotated[bool, typer.Option("--parquet", help="Write table.parquet too.")] = False,
    check: Annotated[
        bool, typer.Option("--check", help="Test the materials that vary: column stability.")
    ] = False,
) -> None:
    """Render all cells of a sweep: images, contact sheet, table, error against time, report.

    A service that holds the data directory does the work; when none runs, this command does it
    itself. Interrupted, the same command goes on where it stopped.
    """
    from matiere.service.sweep_run import FETCHED, run_sweep

    if fetch not in ("auto", *FETCHED):
        raise typer.BadParameter(f"one of auto, {', '.join(FETCHED)}", param_hint="--fetch")
    failed = run_sweep(
        sweep_file,
        output,
        url=url,
        data=data,
        children=children,
        fetch=fetch,
        parquet=parquet,
        check=check,
    )
    if failed:
        raise typer.Exit(1)
