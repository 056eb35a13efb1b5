"""The reference of materials: every model with its parameters, and a ball to turn them on."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Response

import matiere
from matiere.service.errors import Problem
from matiere.service.page.site import PageRoute, html
from matiere.service.routes import materials as api

router = APIRouter(route_class=PageRoute, include_in_schema=False)

# What a ball of each begins with, where the defaults alone are none or show little.
BEGIN: dict[str, dict[str, Any]] = {
    "conductor": {"metal": "Au", "alpha": 0.2},
    "mirror": {},
    "plastic": {"albedo": [0.7, 0.12, 0.08], "alpha": 0.1},
    "lambert": {"albedo": [0.75, 0.45, 0.3]},
    "layered": {"base": {"type": "conductor", "metal": "Cu", "alpha": 0.35}, "alpha": 0.02},
    "mix": {
        "a": {"type": "conductor", "metal": "Au", "alpha": 0.2},
        "b": {"type": "lambert", "albedo": 0.3},
    },
    "cook_torrance": {"F0": [0.95, 0.64, 0.54], "alpha": 0.2},
    "thin_dielectric": {"transmittance": [0.6, 0.9, 0.75]},
    "microfacet_generator": {"sigma": 0.3},
    "dielectric": {"alpha": 0.0},
}
NO_BALL = ("measured", "null")  # needs files, or cannot be seen
RANGES = {"eta": (1.0, 3.0), "exponent": (1.0, 1000.0), "nu": (1.0, 1000.0), "nv": (1.0, 1000.0)}
UNIT = 1.0  # sliders of other parameters run over their whole range, if it ends there


def _slider(param: dict[str, Any], begin: dict[str, Any]) -> dict[str, Any] | None:
    """Return how a parameter is turned, or None for one that a slider does not suit."""
    name, kind = param["name"], param["kind"]
    value = begin.get(name, param["implied"])
    if kind == "metal" and name in begin:
        return {"name": name, "kind": "choice", "value": value, "choices": list(matiere.metals())}
    if kind == "enum" and param["choices"] and value is not None:
        return {"name": name, "kind": "choice", "value": value, "choices": param["choices"]}
    if kind == "color" and param["max"] == UNIT and value is not None:
        return {"name": name, "kind": "color", "value": value}
    low, high = RANGES.get(name, (param["min"], param["max"]))
    if kind == "scalar" and isinstance(value, int | float) and high in (UNIT, *_ENDS):
        return {"name": name, "kind": "range", "value": value, "min": low, "max": high}
    return None


_ENDS = {high for _, high in RANGES.values()}


@router.get("/materials")
def materials() -> Response:
    """List the models."""
    return html("materials.html", "/materials", materials=api.list_materials()["materials"])


@router.get("/materials/{kind}")
def material(kind: str) -> Response:
    """Show a model: its parameters, and a ball to turn them on."""
    found = [one for one in api.list_materials()["materials"] if one["type"] == kind]
    if not found:
        raise Problem("not_found", f"There is no material {kind[:60]!r}; /materials lists them.")
    begin = {"type": kind, **BEGIN.get(kind, {})}
    turned = [_slider(param, begin) for param in found[0]["params"]]
    sliders = [one for one in turned if one] if kind not in NO_BALL else []
    return html(
        "material.html", "/materials", material=found[0], begin=begin, sliders=sliders,
        ball=kind not in NO_BALL,
    )  # fmt: skip
