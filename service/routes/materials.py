"""What a scene may say: the material models with their parameters, and the JSON Schema."""

from __future__ import annotations

from functools import cache
from typing import Any

from fastapi import APIRouter

import matiere

router = APIRouter(prefix="/v1", tags=["reference"])


@cache
def _materials() -> list[dict[str, Any]]:
    return list(matiere.materials())


@cache
def _schema() -> dict[str, Any]:
    return dict(matiere.schema())


@router.get("/materials")
def list_materials() -> dict[str, Any]:
    """List the material models: parameters, ranges, defaults, units, sources."""
    return {"materials": _materials()}


@router.get("/schema")
def get_schema() -> dict[str, Any]:
    """Return the JSON Schema of a scene, version 1."""
    return _schema()
