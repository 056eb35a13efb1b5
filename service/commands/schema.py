"""`matiere schema`: the JSON Schema of scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def schema(
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write to this file instead.")
    ] = None,
) -> None:
    """Print the JSON Schema (draft 2020-12) of scene JSON v1, material parameters included.

    Editors that know JSON Schema then complete and check scenes while you type.
    """
    from matiere.scene.schema import schema_text

    if output is None:
        typer.echo(schema_text(), nl=False)
    else:
        output.write_text(schema_text(), encoding="utf-8")
