"""`matiere check`: the stability report of one material."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

COLORS = {"pass": typer.colors.GREEN, "warn": typer.colors.YELLOW, "fail": typer.colors.RED}


def check(
    material: Annotated[
        str,
        typer.Argument(
            help="Material (JSON file or inline JSON), or a scene (JSON file) with --material.",
            show_default=False,
        ),
    ],
    name: Annotated[
        str | None, typer.Option("--material", help="Name of the material in a scene.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report as JSON.")] = False,
    plot: Annotated[
        Path | None, typer.Option(help="Write albedo and polar plots (SVG, PNG) to this folder.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")] = 1,
) -> None:
    """Test a material at its exact parameters: energy, sampling, reciprocity, numbers.

    Exit code 0: pass or warn, 1: fail, 2: bad input. Takes about a second.
    Example: matiere check '{"type": "dielectric", "alpha": 0.1}' --plot plots
    """
    import matiere as mt
    from matiere.service.console import worded

    inline = material.lstrip().startswith("{")
    with worded(Path("the material" if inline else material)):
        description, prefix = find_material(material, name)
        with mt.errors.pointed(prefix):
            root = "." if inline else Path(material).parent
            report = mt.check(description, seed=seed, asset_root=root)
    files = report.save_plots(plot) if plot is not None else []
    if as_json:
        typer.echo(json.dumps(report.as_dict(), indent=1))
    else:
        verdict, rest = report.verdict, str(report)[len(report.verdict) :]
        typer.echo(typer.style(verdict, fg=COLORS[verdict], bold=True) + rest)
        for file in files:
            typer.echo(f"wrote {file}")
    if report.verdict == "fail":
        raise typer.Exit(1)


def find_material(source: str, name: str | None) -> tuple[Mapping[str, Any], str]:
    """Return the material object and its JSON pointer in the document."""
    from matiere.errors import Fault, SceneValidationError, pointer
    from matiere.scene import document

    inline = source.lstrip().startswith("{")
    value = document.parse(source) if inline else document.read(source)
    if not isinstance(value, Mapping):
        raise SceneValidationError([Fault("", "wrong_type", "a material is a JSON object: {...}")])
    known = value.get("materials")
    if not isinstance(known, Mapping):
        if name is not None:
            why = f"this is no scene, so it has no material {name!r}; leave out --material"
            raise SceneValidationError([Fault("", "missing_key", why)])
        return value, ""
    names = ", ".join(map(repr, known)) or "none"
    if name is None and len(known) == 1:
        name = next(iter(known))
    if name is None or name not in known:
        why = f"has no material {name!r}" if name is not None else "is a scene: add --material NAME"
        why = f"{why}; its materials are {names}"
        raise SceneValidationError([Fault("/materials", "missing_key", why)])
    return known[name], pointer("materials", name)
