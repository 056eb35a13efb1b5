"""`matiere replay`: one sample of a film again, in words."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer


def replay(
    scene: Annotated[Path, typer.Argument(help="Scene (JSON).", show_default=False)],
    pixel: Annotated[
        str | None, typer.Option(help="Pixel X,Y of the whole film, from the upper left.")
    ] = None,
    replicate: Annotated[int, typer.Option(min=0, help="Replicate of the sample.")] = 0,
    sample: Annotated[int, typer.Option(min=0, help="Sample inside the replicate.")] = 0,
    worst: Annotated[
        int | None,
        typer.Option(min=1, help="The K brightest samples of --film or --report instead."),
    ] = None,
    film: Annotated[Path | None, typer.Option(help="Film (matiere render --film).")] = None,
    report: Annotated[Path | None, typer.Option(help="Report (matiere render --report).")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Seed (default: the scene's).")] = None,
    max_depth: Annotated[
        int | None, typer.Option(min=0, help="Depth limit, if the render had one of its own.")
    ] = None,
    asset_root: Annotated[
        Path | None, typer.Option(help="Folder of the scene's files (default: its own).")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, not words.")] = False,
) -> None:
    """Trace single samples of a scene again and print what they met.

    Example: matiere replay scene.json --worst 3 --film out.film
    """
    import matiere as mt

    loaded = mt.load(scene, asset_root=asset_root)
    if max_depth is not None:
        loaded = loaded.with_render(max_depth=max_depth)
    if worst is not None:
        asked = _worst(film, report, worst)
    else:
        asked = [{"pixel": _pixel(pixel), "replicate": replicate, "sample": sample, "seed": seed}]
    keys = ("pixel", "replicate", "sample", "seed")
    paths = [mt.replay(loaded, **{key: row[key] for key in keys}) for row in asked]
    if as_json:
        typer.echo(json.dumps([dict(path.path) for path in paths], indent=1))
    else:
        typer.echo("\n".join(path.text for path in paths), nl=False)


def _pixel(text: str | None) -> tuple[int, int]:
    words = (text or "").split(",")
    try:
        x, y = (int(word) for word in words)
    except ValueError:
        raise typer.BadParameter(
            "give --pixel X,Y, or --worst K with --film or --report", param_hint="--pixel"
        ) from None
    return x, y


def _worst(film: Path | None, report: Path | None, count: int) -> list[dict[str, Any]]:
    """Return the outliers that a film or a report names."""
    import matiere as mt

    if (film is None) == (report is None):
        raise typer.BadParameter("--worst needs --film or --report", param_hint="--worst")
    if film is not None:
        rows: list[dict[str, Any]] = mt.load_film(film).report["outliers"]
    else:
        assert report is not None
        rows = json.loads(report.read_text(encoding="utf-8")).get("outliers", [])
    if not rows:
        raise typer.BadParameter(
            f"{film or report} names no outliers: it is black or from an older matiere",
            param_hint="--worst",
        )
    return rows[:count]
