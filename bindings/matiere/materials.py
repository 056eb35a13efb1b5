"""The material models of the core and the metals that have names."""

from __future__ import annotations

import json
from copy import deepcopy
from functools import lru_cache
from importlib.resources import files
from typing import Any


@lru_cache(maxsize=1)
def _rows() -> tuple[dict[str, Any], ...]:
    from matiere import _core

    return tuple(_core.materials())


def materials() -> list[dict[str, Any]]:
    """List every material model with its parameter table.

    Each entry is a dict: `type`; `doc`; `source` (author, year, equations); `features`; `params`, a
    list of rows; and the rules that tie parameters together: `exclusive` (at most one of these
    names), `one_of` (at least one), `together` (all or none), `requires` (the first only with the
    second). A row has `name`; `kind` (scalar, color, bool, enum, metal, material, file, list);
    `default` (filled in when absent); `implied` (what absence means where several names say the
    same thing); `required`; `min`, `max`, `min_exclusive` (null: unlimited; of a list: how many
    objects); `reason` of the lower bound; `unit`; `doc`; `texture` (may be one); `constant_only`;
    `choices` (of an enum); `items` (of a list: the rows of its objects). `GET /v1/materials` serves
    the same list.
    """
    return deepcopy(list(_rows()))


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
