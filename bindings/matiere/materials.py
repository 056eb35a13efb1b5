"""The material models of the core and the metals that have names."""

from __future__ import annotations

import json
from functools import lru_cache
from importlib.resources import files
from typing import Any


@lru_cache(maxsize=1)
def _rows() -> tuple[dict[str, Any], ...]:
    from matiere import _core

    return tuple(_core.materials())


def materials() -> list[dict[str, Any]]:
    """List every material model with its parameter table.

    Each entry has `type`, `doc`, `source` (author, year, equations), `params` (rows with `name`,
    `kind`, `default`, `min`, `max`, `unit`, `doc`, ...) and the rules that tie parameters together.
    """
    return [dict(row) for row in _rows()]


@lru_cache(maxsize=1)
def _metals() -> dict[str, Any]:
    text = (files("matiere") / "data" / "metals.json").read_text(encoding="utf-8")
    table: dict[str, Any] = json.loads(text)["metals"]
    return table


def metals() -> dict[str, dict[str, Any]]:
    """Return the metals that `"metal"` may name: symbol -> `eta` and `k` (RGB), `source`, ..."""
    return {name: dict(entry) for name, entry in _metals().items()}


def metal(name: str) -> dict[str, Any]:
    """Return `eta`, `k` (RGB, linear Rec.709) and the source of one metal; KeyError if unknown."""
    return dict(_metals()[name])


def info() -> dict[str, Any]:
    """Return versions and facts of this build: matiere, Embree, instruction set, threads, ..."""
    from matiere import __version__, _core

    return {"matiere": __version__, **_core.info()}
