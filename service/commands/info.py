"""`matiere info`: what this installation is made of."""

from __future__ import annotations

import json
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated, Any

import typer

PACKAGES = ("numpy", "openimageio", "opencolorio", "trimesh", "pydantic")
SERVICE_PACKAGES = ("fastapi", "uvicorn", "sqlalchemy", "pysqlite3")


def info(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Print versions, Embree, instruction set, threads and material models."""
    facts = gather()
    if as_json:
        typer.echo(json.dumps(facts, indent=1))
        return
    width = max(map(len, facts))
    for name, value in facts.items():
        typer.echo(f"{name:<{width}}  {_shown(value)}")


def gather() -> dict[str, Any]:
    """Return the facts as a dict that JSON can hold."""
    import platform

    from matiere import _core
    from matiere.materials import info as core_info
    from matiere.materials import materials

    return {
        **core_info(),
        "threads": _core.available_threads(),
        "replicates": _core.DEFAULT_REPLICATES,
        "materials": [row["type"] for row in materials()],
        "python": platform.python_version(),
        **{name: _version(name) for name in PACKAGES},
        "service": {name: _version(name) for name in SERVICE_PACKAGES},
    }


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} {v or '(not installed)'}" for k, v in value.items())
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return "(not installed)" if value is None else str(value)
