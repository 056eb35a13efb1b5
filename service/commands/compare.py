"""`matiere compare`: how two films, or two nights of a sweep, differ beyond noise."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def compare(
    a: Annotated[
        str,
        typer.Argument(
            help="Film (`matiere render --film`), folder of a night, or id of a sweep.",
            show_default=False,
        ),
    ],
    b: Annotated[str, typer.Argument(help="What to compare with it.", show_default=False)],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Folder for the report: of films difference.png, difference.exr and report.json, "
            "of nights report.html, report.json, cells.csv and differences/.",
        ),
    ] = None,
    significance: Annotated[
        float, typer.Option(help="Nights: chance of any false alarm (or share, with bh and by).")
    ] = 0.05,
    method: Annotated[
        str, typer.Option(help="Nights: holm (any false alarm), bh or by (share of false alarms).")
    ] = "holm",
    url: Annotated[
        str | None, typer.Option(help="Sweeps: the service (default: the data directory's).")
    ] = None,
    data: Annotated[Path | None, typer.Option(help="Sweeps: the data directory.")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
) -> None:
    """Compare two films pixel by pixel, or two nights cell by cell, with the error of the change.

    Render both with the same seed and --spp: their common noise cancels. Nights: exit code 0 when
    nothing changed beyond noise, 1 when cells changed, 3 when none did but some failed, are missing
    or cannot be compared; 2 is wrong use.
    Example: matiere compare gold.film worn.film -o difference/
    """
    if Path(a).is_file() and Path(b).is_file():
        _films(Path(a), Path(b), output, quiet)
        return
    from matiere.jobs.night_options import Options
    from matiere.service import night_run
    from matiere.service.night_text import lines

    options = Options(significance=significance, method=method)
    report = night_run.compare(a, b, options, url=url, data=data, output=output)
    if not quiet:
        for line in lines(report):
            typer.echo(line)
        if output is not None:
            typer.echo(f"wrote {output / night_run.PAGE}")
    raise typer.Exit(report["exit_code"])


def _films(a: Path, b: Path, output: Path | None, quiet: bool) -> None:
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
