"""`matiere night`: write the night of a sweep into a folder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def night(
    sweep: Annotated[str, typer.Argument(help="Id of a finished sweep.", show_default=False)],
    folder: Annotated[Path, typer.Argument(help="Folder to write.", show_default=False)],
    name: Annotated[str, typer.Option(help="Name in reports (default: the sweep's).")] = "",
    url: Annotated[
        str | None, typer.Option(help="The service (default: the data directory's).")
    ] = None,
    data: Annotated[Path | None, typer.Option(help="Data directory.")] = None,
) -> None:
    """Export a night: what `matiere compare` needs of a sweep, a few kilobytes a cell.

    It holds the signature of every cell, so it can be compared when films and images are gone.
    Example: matiere night 01a20959-811a-7e8f-9521-5745c324a1c4 nights/2026-11-23
    """
    from matiere.service import night_run

    with night_run.client_for(url, data) as client:
        made = night_run.export(client, sweep, folder, name)
    typer.echo(f"wrote {made}")
