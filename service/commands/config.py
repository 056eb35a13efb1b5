"""`matiere config`: every setting, its value, and where the value came from."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated

import typer


def config(
    config: Annotated[Path | None, typer.Option(help="Configuration file (TOML).")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Print every setting of the service and where its value came from.

    Flags of a command come first, then MATIERE_<NAME>, then the files named here, then defaults.
    """
    from matiere.service.settings import ENVIRONMENT_PREFIX, Settings, resolve

    resolved = resolve(config=config)
    values = resolved.settings.model_dump(mode="json")
    if values["database_url"]:  # a password is not for the screen
        values["database_url"] = re.sub(r"(://[^:/@]*:)[^@]*@", r"\1***@", values["database_url"])
    if as_json:
        both = {k: {"value": v, "origin": resolved.origins[k]} for k, v in values.items()}
        typer.echo(json.dumps(both, indent=1))
        return
    rows = [(name, _shown(value), resolved.origins[name]) for name, value in values.items()]
    widths = [max(len(row[i]) for row in rows) for i in (0, 1)]
    for name, value, origin in rows:
        typer.echo(f"{name:<{widths[0]}}  {value:<{widths[1]}}  {origin}")
    typer.echo("")
    read = ", ".join(map(str, resolved.files)) or "none"
    typer.echo(f"configuration files read: {read}")
    for name in resolved.unknown:
        typer.echo(f"note: {name} is not a setting of the service and is not used here")
    example = next(iter(Settings.model_fields))
    typer.echo(f"set a value with a flag, with {ENVIRONMENT_PREFIX}{example.upper()}, or in a file")


def _shown(value: object) -> str:
    if value is None:
        return "(automatic)"
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "(none)"
    return str(value)
