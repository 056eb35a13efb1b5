"""`matiere compare`: how two saved films differ, and what of that is more than noise."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def compare(
    a: Annotated[Path, typer.Argument(help="Film (`matiere render --film`).", show_default=False)],
    b: Annotated[Path, typer.Argument(help="Film to compare with it.", show_default=False)],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Folder for difference.png, difference.exr and report.json."
        ),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
) -> None:
    """Compare two films of the same size pixel by pixel, with the error of the difference.

    Render both with the same seed and --spp: their common noise cancels.
    Example: matiere compare gold.film worn.film -o difference/
    """
    import matiere as mt

    found = mt.compare(mt.load_film(a), mt.load_film(b))
    files = found.save(output) if output is not None else []
    if quiet:
        return
    for note in found.report["notes"]:
        typer.echo(f"note: {note}", err=True)
    typer.echo(found.report["statement"])
    for path in files:
        typer.echo(f"wrote {path}")
